//! The ports of each role.

use std::time::Duration;

use crate::domain::Domain;
use crate::error::{AskError, OpenError, ReceiveError};
use crate::port::{Publisher, Received, Sent, Subscriber};
use crate::{CycleRecord, Features, Message, Reply, Request, RobotState, Snapshot, TwistCommand};

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
    /// In: where the robot is and how it does.
    pub robot: Subscriber<RobotState>,
    /// In: what operators ask for; take them one by one with [`Subscriber::oldest`].
    pub requests: Subscriber<Request>,
    /// Out: the answers to them.
    pub replies: Publisher<Reply>,
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
            replies: domain.publisher()?,
            features: domain.subscriber(1)?,
            robot: domain.subscriber(1)?,
            requests: domain.subscriber(Request::QOS.buffer)?,
        })
    }
}

/// The controller's ordinary thread: publishes telemetry, and reads along what operators ask.
#[derive(Debug)]
pub struct RecorderPort {
    /// Out: a record of each cycle.
    pub cycles: Publisher<CycleRecord>,
    /// Out: the controller's state, now and then.
    pub snapshots: Publisher<Snapshot>,
    /// In: what operators ask for.
    pub requests: Subscriber<Request>,
    /// In: what they are answered.
    pub replies: Subscriber<Reply>,
}

impl RecorderPort {
    /// Opens the port.
    ///
    /// # Errors
    /// [`OpenError::Taken`] where another controller is at work.
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            cycles: domain.publisher()?,
            snapshots: domain.publisher()?,
            requests: domain.subscriber(Request::QOS.buffer)?,
            replies: domain.subscriber(Reply::QOS.buffer)?,
        })
    }
}

/// A process that only watches. Each port keeps as many messages as the service allows; read them with
/// [`Subscriber::oldest`] (all of them) or [`Subscriber::latest`]. Recorders also subscribe [`Request`], [`Reply`] and
/// [`Snapshot`] with [`Domain::subscriber`].
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

/// Somebody who commands the controller: asks, and waits for the answer.
#[derive(Debug)]
pub struct OperatorPorts {
    /// Out: requests.
    pub requests: Publisher<Request>,
    /// In: the answers to them, and to those of other operators.
    pub replies: Subscriber<Reply>,
}

impl OperatorPorts {
    /// Opens the ports.
    ///
    /// # Errors
    /// [`OpenError::Taken`] where as many operators as the service allows are at work.
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        Ok(Self {
            replies: domain.subscriber(Reply::QOS.buffer)?,
            requests: domain.publisher()?,
        })
    }

    /// Sends a request and waits for its answer, at most `patience`; `None` when none came: no controller is at work,
    /// or it hangs. The request's id must be one that no other operator uses: a random number.
    ///
    /// # Errors
    /// [`AskError`] where it cannot be sent, or the answer is not of the contract.
    pub fn ask(
        &mut self,
        request: &Request,
        patience: Duration,
    ) -> Result<Option<Reply>, AskError> {
        self.requests.publish(request)?;
        let patience = u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX);
        let end = crate::now_ns().saturating_add(patience);
        while crate::now_ns() < end {
            while let Some(reply) = self.replies.oldest()? {
                if reply.id == request.id {
                    return Ok(Some(reply.message));
                }
            }
            // A controller that came since then has not seen the request, and will not: there is no history.
            self.requests.refresh()?;
            std::thread::sleep(ANSWER_POLL);
        }
        Ok(None)
    }
}

/// Sleep between two looks for an answer.
const ANSWER_POLL: Duration = Duration::from_millis(1);
