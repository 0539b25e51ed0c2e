//! Watches the daemon, and asks it if there is nothing to watch.

use std::path::Path;
use std::time::{Duration, Instant};

use ipc::{Domain, OpenError, OperatorPorts};
use messages::{Action, Reply};

use super::Status;
use crate::failure::Failure;
use crate::presence::{self, Presence};
use crate::request;
use crate::watcher::Watcher;

/// How long to wait for the daemon's answer, which takes it a period.
const PATIENCE: Duration = Duration::from_millis(300);
/// Pause between two looks at the ports.
const PAUSE: Duration = Duration::from_millis(5);

/// Whether the daemon is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asking {
    /// Only where no cycles come: each new operator costs the daemon's loop a connection.
    IfSilent,
    /// In any case.
    Always,
}

/// Watches the domain for this time, and asks the daemon for its state where that is needed.
///
/// # Errors
/// No daemon, record or answer was found; the domain cannot be joined.
pub fn look(directory: &Path, watch: Duration, asking: Asking) -> Result<Status, Failure> {
    let end = Instant::now() + watch;
    let mut watcher = Watcher::open(directory)?;
    let mut status = Status::new(&watcher);
    watch_until(
        end.min(Instant::now() + PATIENCE),
        &mut watcher,
        &mut status,
    )?;
    if asking == Asking::Always || status.view.latest().is_none() {
        status.reply = ask(&watcher.domain, PATIENCE.min(watch))?;
        status.answered = Some(status.reply.is_some());
    }
    watch_until(end, &mut watcher, &mut status)?;
    // The daemon may have started or ended since.
    status.process = Presence::of(directory).process();
    let is_silent = status.reply.is_none() && status.view.latest().is_none();
    match status.process.is_none() && is_silent {
        true => Err(presence::absent(directory)),
        false => Ok(status),
    }
}

/// Keeps the status up to date until this instant.
///
/// # Errors
/// As [`Status::update`].
pub fn watch_until(
    end: Instant,
    watcher: &mut Watcher,
    status: &mut Status,
) -> Result<(), Failure> {
    loop {
        status.update(watcher)?;
        if Instant::now() >= end {
            return Ok(());
        }
        std::thread::sleep(PAUSE);
    }
}

/// The daemon's answer; `None` if none came, or all operators' slots are taken.
fn ask(domain: &Domain, patience: Duration) -> Result<Option<Reply>, Failure> {
    match OperatorPorts::open(domain) {
        Ok(mut operator) => Ok(operator.ask(&request::plain(Action::Status), patience)?),
        Err(OpenError::Taken { .. } | OpenError::Full { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
