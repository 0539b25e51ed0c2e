//! Requests: arm, disarm, stop, strategy, flight.

use std::hash::{BuildHasher, RandomState};
use std::path::Path;
use std::time::{Duration, Instant};

use ipc::{Domain, OpenError, OperatorPorts};
use messages::{Action, Outcome, Reply, Request, StrategyCode};
use program::Exit;

use crate::failure::Failure;
use crate::presence::{self, Presence};
use crate::view::word;

/// Pause between two attempts to get an operator's place.
const PAUSE: Duration = Duration::from_millis(10);
/// After what time a disarm without an answer is asked for again.
const AGAIN: Duration = Duration::from_millis(200);
/// Until when a request that leads to motion is answered with a refusal, and a little more.
const LATE: Duration = Duration::from_nanos(Request::LATE_NS * 3 / 2);
/// A number that no other operator uses: the standard library's hashers are seeded with the
/// operating system's random numbers.
fn fresh_id() -> u64 {
    RandomState::new().hash_one(ipc::now_ns())
}

/// A request for an action without parameters.
pub fn plain(action: Action) -> Request {
    Request::new(fresh_id(), action)
}

/// A request to arm in spite of this veto; 0: of none.
pub fn arm(veto: u32) -> Request {
    Request::arm(fresh_id(), veto)
}

/// The veto that an operator who asked at `asked_ns` (CLOCK_MONOTONIC) arms in spite of: the one
/// that is `named`, else a disarm that came before. A stop, and what came later, was perhaps not
/// seen: 0.
///
/// # Errors
/// As [`send`].
pub fn known(
    directory: &Path,
    named: Option<u32>,
    asked_ns: u64,
    timeout: Duration,
) -> Result<u32, Failure> {
    if let Some(named) = named {
        return Ok(named);
    }
    let reply = send(directory, &plain(Action::Status), timeout)?;
    let is_known = Action::of_veto(reply.veto) == Some(Action::Disarm) && reply.veto_ns <= asked_ns;
    Ok(if is_known { reply.veto } else { 0 })
}

/// A request for another strategy; `neighbours` is for knn, else 0.
pub fn strategy(strategy: StrategyCode, neighbours: u32) -> Request {
    Request::strategy(fresh_id(), strategy, neighbours)
}

/// Asks the daemon of this domain, and waits for its answer: a line, and the exit code.
///
/// # Errors
/// No daemon, no answer; the domain or its ports cannot be used.
pub fn ask(
    directory: &Path,
    request: &Request,
    timeout: Duration,
) -> Result<(String, Exit), Failure> {
    Ok(outcome(&send(directory, request, timeout)?))
}

/// Sends a request, and waits for the answer.
///
/// # Errors
/// No daemon, no answer; the domain or its ports cannot be used.
pub fn send(directory: &Path, request: &Request, timeout: Duration) -> Result<Reply, Failure> {
    let end = Instant::now() + timeout;
    let domain = presence::join(directory)?;
    let mut operator = open(&domain, end)?;
    let mut left = end.saturating_duration_since(Instant::now());
    if let Some(Action::Arm | Action::Strategy) = request.action() {
        // After giving up, no request remains that could still move the camera.
        left = left.max(LATE);
    }
    // A daemon that begins again meanwhile has not seen it, and a disarm may be asked for twice.
    let each = match request.action() {
        Some(Action::Disarm) => AGAIN,
        _ => left,
    };
    loop {
        if let Some(reply) = operator.ask(request, left.min(each))? {
            return Ok(reply);
        }
        left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(no_answer(directory, timeout));
        }
    }
}

fn no_answer(directory: &Path, timeout: Duration) -> Failure {
    let Some(process) = Presence::of(directory).process() else {
        return presence::absent(directory);
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
pub fn outcome(reply: &Reply) -> (String, Exit) {
    let action = match Action::from_code(reply.action) {
        // By the command's name.
        Some(Action::Record) => "flight".to_owned(),
        action => word(action),
    };
    let (outcome, state) = (word(reply.outcome()), word(reply.state()));
    let cause = (reply.hold()).map_or(String::new(), |hold| format!(" ({hold})"));
    let strategy = strategy_name(reply.strategy, reply.neighbours);
    let mut line = format!("{action}: {outcome}; {state}{cause}, strategy {strategy}\n");
    if reply.outcome() == Some(Outcome::Vetoed) {
        let veto = reply.veto;
        line += &format!("look first; to arm all the same: vpcctl arm --veto {veto}\n");
    }
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
    use messages::{Hold, Stamp, TwistState};

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
            veto: 17,
            named: 0,
            veto_ns: 0,
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
        let (line, exit) = outcome(&reply(Outcome::Vetoed));
        assert!(line.ends_with("\nlook first; to arm all the same: vpcctl arm --veto 17\n"));
        assert_eq!(exit, Exit::Refused);
    }

    #[test]
    fn ids_differ() {
        let ids: std::collections::HashSet<u64> = (0..100).map(|_| fresh_id()).collect();
        assert_eq!(ids.len(), 100);
    }
}
