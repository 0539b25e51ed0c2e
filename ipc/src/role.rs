//! The ports of each role.

use std::time::Duration;

use crate::domain::Domain;
use crate::port::{OpenError, Publisher, ReceiveError, Received, Sent, Subscriber};
use crate::{CycleRecord, Features, Message, RobotState, TwistCommand};

/// The camera and the robot that carries it: publishes features and state, executes twists.
#[derive(Debug)]
pub struct CameraPorts {
    /// Out: what the camera saw.
    pub features: Publisher<Features>,
    /// Out: where it is.
    pub robot: Publisher<RobotState>,
    /// In: commands; the last few are kept, so that the answer of the last cycle of a run is not lost to the zero
    /// twist that ends it. Read the newest with [`Subscriber::latest`].
    pub twist: Subscriber<TwistCommand>,
}

/// Commands that a camera keeps.
const COMMANDS: usize = 4;
/// Rounds of polling that only yield, before polling sleeps.
const YIELDS: u32 = 200;
/// Sleep between two polls.
const POLL: Duration = Duration::from_micros(20);

impl CameraPorts {
    /// Opens the ports.
    ///
    /// # Errors
    /// [`OpenError::Taken`] where another camera is at work.
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            // The subscriber first: no answer to the first features may be missed.
            twist: domain.subscriber(COMMANDS)?,
            features: domain.publisher()?,
            robot: domain.publisher()?,
        })
    }

    /// Lockstep: waits for the answer to the features message `sent`, at most `patience`; `None` when it did not
    /// come. Answers to other messages are passed over. A controller that comes late gets the message by history.
    ///
    /// # Errors
    /// As [`Subscriber::latest`].
    pub fn wait_for_answer(
        &mut self,
        sent: &Sent,
        patience: Duration,
    ) -> Result<Option<Received<TwistCommand>>, ReceiveError> {
        let patience = u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX);
        let end = crate::now_ns().saturating_add(patience);
        let mut polls = 0;
        loop {
            for _ in 0..COMMANDS {
                match self.twist.oldest()? {
                    Some(twist) if twist.answers(sent.sequence, sent.published_ns) => {
                        return Ok(Some(twist));
                    }
                    Some(_) => (),
                    None => break,
                }
            }
            if crate::now_ns() >= end {
                return Ok(None);
            }
            if polls < YIELDS {
                polls += 1;
                std::thread::yield_now();
            } else {
                // A failure to connect shows with the next message; until then, patience decides.
                let _ = self.features.refresh();
                std::thread::sleep(POLL);
            }
        }
    }
}

/// The controller: answers features with twists.
#[derive(Debug)]
pub struct ControllerPorts {
    /// In: the latest features.
    pub features: Subscriber<Features>,
    /// Out: the command.
    pub twist: Publisher<TwistCommand>,
}

impl ControllerPorts {
    /// Opens the ports.
    ///
    /// # Errors
    /// [`OpenError::Taken`] where another controller is at work.
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            // The publisher first: a second controller is refused before it takes anything.
            twist: domain.publisher()?,
            features: domain.subscriber(1)?,
        })
    }
}

/// The controller's ordinary thread: publishes telemetry.
#[derive(Debug)]
pub struct RecorderPort {
    /// Out: a record of each cycle.
    pub cycles: Publisher<CycleRecord>,
}

impl RecorderPort {
    /// Opens the port.
    ///
    /// # Errors
    /// [`OpenError::Taken`] where another controller is at work.
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            cycles: domain.publisher()?,
        })
    }
}

/// Somebody who watches; each port keeps as many messages as the service allows. Read them with
/// [`Subscriber::oldest`] (all of them) or [`Subscriber::latest`].
#[derive(Debug)]
pub struct Observer {
    /// What the camera saw.
    pub features: Subscriber<Features>,
    /// What the controller commanded.
    pub twist: Subscriber<TwistCommand>,
    /// Where the robot is.
    pub robot: Subscriber<RobotState>,
    /// What the controller's cycles did.
    pub cycles: Subscriber<CycleRecord>,
}

impl Observer {
    /// Opens the ports.
    ///
    /// # Errors
    /// [`OpenError::Full`] where a service has all the subscribers that it takes.
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            features: domain.subscriber(Features::QOS.buffer)?,
            twist: domain.subscriber(TwistCommand::QOS.buffer)?,
            robot: domain.subscriber(RobotState::QOS.buffer)?,
            cycles: domain.subscriber(CycleRecord::QOS.buffer)?,
        })
    }
}
