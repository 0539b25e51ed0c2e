//! Requests: arm, disarm, stop, strategy, flight.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::Path;
use std::time::{Duration, Instant};

use ipc::{Action, Domain, OpenError, OperatorPorts, Outcome, Reply, Request, StrategyCode};

use crate::exit::{Exit, Failure};
use crate::presence::Presence;

/// Pause between two attempts to get an operator's place.
const PAUSE: Duration = Duration::from_millis(10);
/// How long `stop` waits for an answer before it asks again.
const AGAIN: Duration = Duration::from_millis(250);

/// A number that no other operator uses: the standard library seeds its hash tables from the operating system's
/// random numbers.
fn fresh_id() -> u64 {
    let mut hasher = RandomState::new().build_hasher();
    hasher.write_u64(ipc::now_ns());
    hasher.finish()
}

/// A request for an action that needs no more words.
pub fn plain(action: Action) -> Request {
    Request::new(fresh_id(), action)
}

/// A request for another strategy; `neighbours` is for knn.
pub fn strategy(strategy: StrategyCode, neighbours: u32) -> Request {
    Request::strategy(fresh_id(), strategy, neighbours)
}

/// Sends a request to the daemon of this domain, as an operator and nothing else, and waits for its answer.
///
/// `stop` is sent again while no answer comes: a daemon that starts meanwhile is stopped as well, and asking twice
/// changes nothing. Other requests are sent once.
///
/// # Errors
/// [`Failure::NoDaemon`], [`Failure::NoAnswer`], or what stands against joining and sending.
pub fn send(directory: &Path, request: &Request, timeout: Duration) -> Result<Reply, Failure> {
    let end = Instant::now() + timeout;
    let presence = Presence::of(directory);
    let domain = directory.display().to_string();
    // Joining would create the directory.
    if presence == Presence::NoDomain {
        return Err(Failure::NoDaemon { domain });
    }
    let joined = Domain::join(directory)?;
    let mut operator = place(&joined, end)?;
    let patience = match request.action() {
        Some(Action::Stop) => AGAIN,
        _ => timeout,
    };
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if let Some(reply) = operator.ask(request, patience.min(left))? {
            return Ok(reply);
        }
        if Instant::now() < end {
            continue;
        }
        let seconds = timeout.as_secs_f64();
        // Asked again: it may have ended since.
        return Err(match Presence::of(directory).process() {
            Some(process) => Failure::NoAnswer {
                domain,
                process: format!("process {process}"),
                seconds,
            },
            None => Failure::NoDaemon { domain },
        });
    }
}

/// An operator's place; others leave theirs within moments.
fn place(domain: &Domain, end: Instant) -> Result<OperatorPorts, OpenError> {
    loop {
        match OperatorPorts::open(domain) {
            Err(OpenError::Taken { .. } | OpenError::Full { .. }) if Instant::now() < end => {
                std::thread::sleep(PAUSE);
            }
            result => return result,
        }
    }
}

/// What became of a request, in one line, with the exit code that goes with it.
pub fn verdict(reply: &Reply) -> (String, Exit) {
    let word = |text: Option<String>| text.unwrap_or_else(|| "unknown".to_owned());
    let action = word(Action::from_code(reply.action).map(|action| action.to_string()));
    let outcome = word(reply.outcome().map(|outcome| outcome.to_string()));
    let mut line = format!(
        "{action}: {outcome}; {}",
        word(reply.state().map(|s| s.to_string()))
    );
    if let Some(hold) = reply.hold().filter(|&hold| hold != ipc::Hold::None) {
        line += &format!(" ({hold})");
    }
    line += &format!(
        ", strategy {}\n",
        strategy_name(reply.strategy, reply.neighbours)
    );
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
        let (line, exit) = verdict(&reply(Outcome::NoFeatures));
        assert_eq!(
            line,
            "arm: refused: no good features are coming; disarmed (not armed), strategy knn5\n"
        );
        assert_eq!(exit, Exit::Refused);
        assert_eq!(verdict(&reply(Outcome::Done)).1, Exit::Ok);
    }

    #[test]
    fn ids_differ() {
        let ids: std::collections::HashSet<u64> = (0..100).map(|_| fresh_id()).collect();
        assert_eq!(ids.len(), 100);
    }
}
