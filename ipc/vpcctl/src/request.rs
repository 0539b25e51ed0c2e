//! Requests: arm, disarm, stop, strategy, flight.

use std::hash::{BuildHasher, RandomState};
use std::io::ErrorKind;
use std::path::Path;
use std::time::{Duration, Instant};

use ipc::{
    Action, Domain, OpenError, OperatorPorts, Outcome, Reply, Request, StopError, StrategyCode,
};

use crate::exit::{Exit, Failure};
use crate::presence::{self, Presence};
use crate::view::word;

/// Pause between two attempts to get an operator's place.
const PAUSE: Duration = Duration::from_millis(10);
/// A number that no other operator uses: the standard library's hashers are seeded with the
/// operating system's random numbers.
fn fresh_id() -> u64 {
    RandomState::new().hash_one(ipc::now_ns())
}

/// A request for an action without parameters.
pub fn plain(action: Action) -> Request {
    Request::new(fresh_id(), action)
}

/// A request for another strategy; `neighbours` is for knn, else 0.
pub fn strategy(strategy: StrategyCode, neighbours: u32) -> Request {
    Request::strategy(fresh_id(), strategy, neighbours)
}

/// Asks the daemon of this domain, and waits for its answer: a line, and the exit code. `stop` goes
/// by the stop file, past everything that could keep it waiting.
///
/// # Errors
/// No daemon, no answer; the domain or its ports cannot be used.
pub fn ask(
    directory: &Path,
    request: &Request,
    timeout: Duration,
) -> Result<(String, Exit), Failure> {
    match request.action() {
        Some(Action::Stop) => stop(directory, timeout),
        _ => Ok(outcome(&send(directory, request, timeout)?)),
    }
}

fn stop(directory: &Path, timeout: Duration) -> Result<(String, Exit), Failure> {
    let end = Instant::now() + timeout;
    loop {
        let left = end.saturating_duration_since(Instant::now());
        return match ipc::stop(directory, left) {
            Ok(after) => Ok((stopped(after), Exit::Ok)),
            Err(StopError::File { source, .. }) if source.kind() == ErrorKind::NotFound => {
                // The first daemon of this domain may be starting.
                if directory.is_dir() && !left.is_zero() {
                    std::thread::sleep(PAUSE);
                    continue;
                }
                Err(match Presence::of(directory).process() {
                    Some(process) => stop_file_lost(directory, process),
                    None => Failure::no_daemon(directory),
                })
            }
            Err(error @ StopError::NotObeyed { .. }) => {
                Err(match Presence::of(directory).process() {
                    Some(_) => no_answer(directory, timeout),
                    None => Failure::new(Exit::NoDaemon, error),
                })
            }
            Err(error) => Err(Failure::new(Exit::Unavailable, error)),
        };
    }
}

/// A daemon whose stop file was removed moves nothing.
fn stop_file_lost(directory: &Path, process: u32) -> Failure {
    let file = directory.join(ipc::STOP_FILE);
    let message = format!(
        "{}: missing, so process {process} has stopped, and moves nothing until it is started again",
        file.display()
    );
    Failure::new(Exit::Unavailable, message)
}

/// What is said of a stop that was obeyed after this time.
pub fn stopped(after: Duration) -> String {
    format!("stop: done after {} ms; disarmed\n", after.as_millis())
}

fn send(directory: &Path, request: &Request, timeout: Duration) -> Result<Reply, Failure> {
    let end = Instant::now() + timeout;
    let domain = presence::join(directory)?;
    let mut operator = open(&domain, end)?;
    let left = end.saturating_duration_since(Instant::now());
    let reply = operator.ask(request, left)?;
    reply.ok_or_else(|| no_answer(directory, timeout))
}

fn no_answer(directory: &Path, timeout: Duration) -> Failure {
    let Some(process) = Presence::of(directory).process() else {
        return Failure::no_daemon(directory);
    };
    let (domain, seconds) = (directory.display(), timeout.as_secs_f64());
    let message = format!(
        "domain {domain}: process {process} did not answer within {seconds} s; see `vpcctl doctor`, or end it with `kill -TERM` (zero twist, controlled stop)"
    );
    Failure::new(Exit::NoAnswer, message)
}

/// Takes an operator's place; other operators give theirs back within moments.
fn open(domain: &Domain, end: Instant) -> Result<OperatorPorts, OpenError> {
    loop {
        match OperatorPorts::open(domain) {
            Err(OpenError::Taken { .. } | OpenError::Full { .. }) if Instant::now() < end => {
                std::thread::sleep(PAUSE);
            }
            result => return result,
        }
    }
}

/// The outcome of a request in one line, and its exit code.
fn outcome(reply: &Reply) -> (String, Exit) {
    let action = match Action::from_code(reply.action) {
        // By the command's name.
        Some(Action::Record) => "flight".to_owned(),
        action => word(action),
    };
    let (outcome, state) = (word(reply.outcome()), word(reply.state()));
    let cause = match reply.hold() {
        Some(hold) if hold != ipc::Hold::None => format!(" ({hold})"),
        _ => String::new(),
    };
    let strategy = strategy_name(reply.strategy, reply.neighbours);
    let line = format!("{action}: {outcome}; {state}{cause}, strategy {strategy}\n");
    match reply.outcome() {
        Some(Outcome::Done) => (line, Exit::Ok),
        _ => (line, Exit::Refused),
    }
}

/// Name of a strategy, with the neighbours of knn as `vpcd --strategy` takes them.
pub fn strategy_name(code: u32, neighbours: u32) -> String {
    match StrategyCode::from_code(code) {
        Some(StrategyCode::Knn) if neighbours > 1 => format!("knn{neighbours}"),
        Some(strategy) => strategy.to_string(),
        None => format!("unknown ({code})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::{Hold, Stamp, TwistState};

    fn reply(outcome: Outcome) -> Reply {
        Reply {
            stamp: Stamp::default(),
            id: 1,
            cycle: 0,
            action: Action::Arm.code(),
            outcome: outcome.code(),
            state: TwistState::Disarmed.code(),
            hold: Hold::NotArmed.code(),
            strategy: StrategyCode::Knn.code(),
            neighbours: 5,
        }
    }

    #[test]
    fn a_refusal_says_why_and_has_its_exit_code() {
        let (line, exit) = outcome(&reply(Outcome::NoFeatures));
        assert_eq!(
            line,
            "arm: refused: no good features are coming; disarmed (not armed), strategy knn5\n"
        );
        assert_eq!(exit, Exit::Refused);
        assert_eq!(outcome(&reply(Outcome::Done)).1, Exit::Ok);
    }

    #[test]
    fn ids_differ() {
        let ids: std::collections::HashSet<u64> = (0..100).map(|_| fresh_id()).collect();
        assert_eq!(ids.len(), 100);
    }
}
