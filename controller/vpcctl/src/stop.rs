//! `vpcctl stop`: by the stop file, past everything that could keep it waiting. Where that does not
//! get through, it asks the daemon; nothing is called stopped that did not say so.

use std::io::ErrorKind;
use std::path::Path;
use std::time::{Duration, Instant};

use ipc::StopError;
use messages::{Action, TwistState};
use program::Exit;

use crate::failure::Failure;
use crate::presence::{self, Presence};
use crate::request;

/// Pause between two looks for the file.
const PAUSE: Duration = Duration::from_millis(10);
/// How long the daemon is asked for, after the file, at least.
const ASKING: Duration = Duration::from_secs(1);

/// Stops the daemon of this domain, and waits until it says so: a line, and the exit code.
///
/// # Errors
/// No daemon, or none that answers. Names the way that is left.
pub fn stop(directory: &Path, timeout: Duration) -> Result<(String, Exit), Failure> {
    let end = Instant::now() + timeout;
    let left = || end.saturating_duration_since(Instant::now());
    let error = loop {
        match ipc::stop(directory, left()) {
            Ok(after) => return Ok((stopped(after), Exit::Ok)),
            // The first daemon of this domain may be starting.
            Err(StopError::File { source, .. })
                if source.kind() == ErrorKind::NotFound
                    && directory.is_dir()
                    && !left().is_zero() =>
            {
                std::thread::sleep(PAUSE);
            }
            Err(error) => break error,
        }
    };
    match (Presence::of(directory), &error) {
        (Presence::Process(process), _) => by_request(directory, process, &error, left()),
        // We may write the file, and not look for its daemon.
        (Presence::Foreign(_), StopError::NotObeyed { .. }) => {
            Err(Failure::new(Exit::NoAnswer, error))
        }
        (_, StopError::NotObeyed { .. }) => Err(Failure::new(Exit::NoDaemon, error)),
        (Presence::Foreign(_), _) => Err(presence::absent(directory)),
        _ => {
            let failure = presence::absent(directory);
            let others = elsewhere();
            match others.is_empty() {
                true => Err(failure),
                false => Err(Failure::new(failure.exit, format!("{failure}{others}"))),
            }
        }
    }
}

/// What is said of a stop that was obeyed after this time.
pub fn stopped(after: Duration) -> String {
    format!("stop: done after {} ms; disarmed\n", after.as_millis())
}

/// Asks the daemon itself, which the file did not reach for this reason.
fn by_request(
    directory: &Path,
    process: u32,
    error: &StopError,
    left: Duration,
) -> Result<(String, Exit), Failure> {
    let asked = request::send(directory, &request::plain(Action::Stop), left.max(ASKING));
    let trouble = match asked {
        Ok(reply) if reply.state() == Some(TwistState::Disarmed) => {
            let line = format!(
                "stop: done, by a request; disarmed, says process {process}. The stop file did not do: {error}\n"
            );
            return Ok((line, Exit::Ok));
        }
        Ok(reply) => match reply.state() {
            Some(state) => format!("it says: {state}"),
            None => "its answer cannot be read".to_owned(),
        },
        Err(failure) => failure.to_string(),
    };
    let message = format!(
        "process {process} is NOT known to have stopped: {error}; asked by a request: {trouble}; end it: kill -TERM {process} (zero twist, controlled stop)"
    );
    Err(Failure::new(Exit::NoAnswer, message))
}

/// Where this user's daemons are at work.
fn elsewhere() -> String {
    let mut text = String::new();
    for (process, domain) in presence::at_work() {
        text += &match domain {
            None => format!("; {}", unreachable(process)),
            Some(domain) => format!(
                "; process {process} is at work in {0}: vpcctl --domain {0} stop, or vpcctl stop --all",
                domain.display()
            ),
        };
    }
    text
}

/// A daemon whose domain was removed.
fn unreachable(process: u32) -> String {
    format!("process {process} is at work in a domain that was removed: kill -TERM {process}")
}

/// Stops each of this user's daemons: a line for each, and the worst exit code.
pub fn stop_all(timeout: Duration) -> (String, Exit) {
    let (mut text, mut worst) = (String::new(), Exit::Ok);
    let daemons = presence::at_work();
    if daemons.is_empty() {
        return (
            "no vpcd of this user is at work\n".to_owned(),
            Exit::NoDaemon,
        );
    }
    for (process, domain) in daemons {
        let exit = match domain {
            None => {
                text += &(unreachable(process) + "\n");
                Exit::NoAnswer
            }
            Some(domain) => {
                let (line, exit) = stop(&domain, timeout)
                    .unwrap_or_else(|failure| (format!("{failure}\n"), failure.exit));
                text += &format!("{}: {line}", domain.display());
                exit
            }
        };
        if exit as u8 > worst as u8 {
            worst = exit;
        }
    }
    (text, worst)
}
