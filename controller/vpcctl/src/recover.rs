//! `recover`: asks the robot's bridge to clear the robot's errors. A bridge never does so by
//! itself. What counts is what the robot then tells.

use std::path::Path;
use std::time::Duration;

use ipc::{OpenError, Publisher, Subscriber};
use messages::{Action, Request, RobotMode, RobotState};
use program::Exit;

use crate::clock::{Clock, ns};
use crate::failure::Failure;
use crate::presence;
use crate::request::plain;

/// A robot tells its state within this time.
const HEARD: Duration = Duration::from_secs(1);
/// Between two looks.
const PAUSE: Duration = Duration::from_millis(10);

/// Asks, and waits for a robot that is no longer at fault: a line, and the exit code.
///
/// # Errors
/// There is no domain, no robot tells its state, or the ports cannot be used.
pub fn recover(
    directory: &Path,
    timeout: Duration,
    clock: &mut dyn Clock,
) -> Result<(String, Exit), Failure> {
    let end_ns = clock.now_ns().saturating_add(ns(timeout));
    let domain = presence::join(directory)?;
    let mut states: Subscriber<RobotState> = domain.subscriber(1)?;
    let mut requests: Publisher<Request> = loop {
        match domain.publisher() {
            Err(OpenError::Taken { .. } | OpenError::Full { .. }) if clock.now_ns() < end_ns => {
                clock.pause(PAUSE);
            }
            result => break result?,
        }
    };
    let mut newest = None;
    let heard_ns = clock.now_ns() + ns(timeout.min(HEARD));
    while newest.is_none() && clock.now_ns() < heard_ns {
        newest = states.latest()?;
        clock.pause(PAUSE);
    }
    let Some(state) = newest else {
        let message = format!(
            "domain {}: nothing on vpc/robot within {} s; is a bridge at work?",
            directory.display(),
            timeout.min(HEARD).as_secs_f64()
        );
        return Err(Failure::new(Exit::NoAnswer, message));
    };
    if let Some(mode) = state.mode().filter(|mode| *mode != RobotMode::Fault) {
        return Ok((
            format!("recover: nothing to clear; the robot is {mode}\n"),
            Exit::Ok,
        ));
    }
    requests.publish(&plain(Action::Recover))?;
    while clock.now_ns() < end_ns {
        // A bridge that joined just now hears it, too.
        requests.refresh()?;
        if let Some(state) = states.latest()?
            && let Some(mode) = state.mode().filter(|mode| *mode != RobotMode::Fault)
        {
            let line = format!("recover: done; the robot is {mode}; arm when it may move\n");
            return Ok((line, Exit::Ok));
        }
        clock.pause(PAUSE);
    }
    let line = format!(
        "recover: the robot is still at fault after {} s; its bridge's log says why\n",
        timeout.as_secs_f64()
    );
    Ok((line, Exit::Refused))
}
