//! Watching and asking for the status.

use std::path::Path;
use std::time::{Duration, Instant};

use ipc::{Domain, OperatorPorts, Reply};

use super::Status;
use crate::exit::Failure;
use crate::presence::Presence;
use crate::request;
use crate::watcher::Watcher;

/// Pause between two looks at the ports.
const PAUSE: Duration = Duration::from_millis(5);
/// Patience with the answer to a question for the state; a daemon answers within a period.
const PATIENCE: Duration = Duration::from_millis(300);

/// Whether the daemon is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asking {
    /// Only where no cycles come: each new operator costs the loop of the daemon a connection.
    IfSilent,
    /// In any case.
    Always,
}

/// Watches the domain for a while, and asks the daemon for its state where that is needed.
///
/// # Errors
/// [`Failure::NoDaemon`] where neither a daemon, a record nor an answer is found; what stands against joining.
pub fn look(directory: &Path, watch: Duration, asking: Asking) -> Result<Status, Failure> {
    let nobody = || Failure::NoDaemon {
        domain: directory.display().to_string(),
    };
    let presence = Presence::of(directory);
    if presence == Presence::NoDomain {
        return Err(nobody());
    }
    let end = Instant::now() + watch;
    let domain = Domain::join(directory)?;
    let mut watcher = Watcher::open(&domain)?;
    watcher.poll()?;
    watch_until(&mut watcher, end.min(Instant::now() + PATIENCE))?;
    let is_silent = watcher.view.latest().is_none();
    let answer = match asking == Asking::Always || is_silent {
        true => Some(ask(&domain, watch)?),
        false => None,
    };
    watch_until(&mut watcher, end)?;
    let reply = answer.flatten();
    // The daemon may have started or ended since.
    let process = Presence::of(directory).process();
    if process.is_none() && reply.is_none() && watcher.view.latest().is_none() {
        return Err(nobody());
    }
    let mut status = Status::of(&watcher.view, reply.as_ref(), ipc::now_ns());
    status.domain = domain.directory().display().to_string();
    status.process = process;
    status.answered = answer.map(|reply| reply.is_some());
    status.full = watcher.full;
    Ok(status)
}

fn watch_until(watcher: &mut Watcher, end: Instant) -> Result<(), Failure> {
    loop {
        watcher.poll()?;
        if Instant::now() >= end {
            return Ok(());
        }
        std::thread::sleep(PAUSE);
    }
}

/// The daemon's own word; `None` where it says nothing, or all operators' places are taken.
fn ask(domain: &Domain, watch: Duration) -> Result<Option<Reply>, Failure> {
    match OperatorPorts::open(domain) {
        Ok(mut operator) => {
            let patience = PATIENCE.min(watch);
            Ok(operator.ask(&request::plain(ipc::Action::Status), patience)?)
        }
        Err(ipc::OpenError::Taken { .. } | ipc::OpenError::Full { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
