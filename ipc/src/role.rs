//! The ports of each role.

use std::time::Duration;

use messages::{
    CycleRecord, DesiredTwist, Features, Received, Reply, Request, RobotState, Snapshot,
    TwistCommand,
};

use crate::clock::now_ns;
use crate::domain::Domain;
use crate::error::{AskError, OpenError, ReceiveError};
use crate::image::ImagePublisher;
use crate::port::{Publisher, Sent, Subscriber};

/// Commands that a camera keeps.
const COMMANDS: usize = 4;
/// Rounds of polling that only yield, before polling sleeps.
const YIELDS: u32 = 200;
/// Sleep between two polls for a lockstep answer.
const POLL: Duration = Duration::from_micros(20);
/// Sleep between two polls for an answer to an operator.
const ANSWER_POLL: Duration = Duration::from_millis(1);

/// Declares the ports of a role in the order in which they are opened: `out` are publishers, `in`
/// are subscribers with the largest buffer that the service allows, or with this many messages.
macro_rules! ports {
    ($(#[$doc:meta])+ $role:ident {
        $($(#[$port_doc:meta])+ $direction:ident $port:ident: $message:ty $(, $buffer:expr)?;)+
    }) => {
        $(#[$doc])+
        #[derive(Debug)]
        pub struct $role {
            $($(#[$port_doc])+ pub $port: ports!(@type $direction $message),)+
        }

        impl $role {
            /// Opens the ports.
            ///
            /// # Errors
            /// [`OpenError::Taken`] or [`OpenError::Full`] if others have all slots of a service.
            pub fn open(domain: &Domain) -> Result<Self, OpenError> {
                Ok(Self { $($port: ports!(@open $direction domain $(, $buffer)?)?,)+ })
            }
        }
    };
    (@type out $message:ty) => { Publisher<$message> };
    (@type in $message:ty) => { Subscriber<$message> };
    (@open out $domain:ident) => { $domain.publisher() };
    (@open in $domain:ident) => { $domain.subscriber(usize::MAX) };
    (@open in $domain:ident, $buffer:expr) => { $domain.subscriber($buffer) };
}

ports! {
    /// The camera: publishes features; in lockstep it also waits for their answers.
    CameraPorts {
        /// Commands. A few are kept, so that the zero twist at the end of a run does not overwrite
        /// the answer of its last cycle. Read the newest with [`Subscriber::latest`]. Opened first,
        /// so that no answer is missed.
        in twist: TwistCommand, COMMANDS;
        /// What the camera sees.
        out features: Features;
    }
}

ports! {
    /// The robot that carries the camera: executes twists, publishes its state.
    RobotPorts {
        /// The latest command; what it lets the robot do, and until when, says
        /// [`TwistCommand::in_force`].
        in twist: TwistCommand, 1;
        /// Where it is.
        out robot: RobotState;
    }
}

ports! {
    /// The controller: answers features with twists.
    ControllerPorts {
        /// The command. Opened first, so that a second controller is refused before it takes
        /// anything.
        out twist: TwistCommand;
        /// Answers to operators.
        out replies: Reply;
        /// The latest features.
        in features: Features, 1;
        /// The latest state of the robot.
        in robot: RobotState, 1;
        /// The latest wanted twist.
        in desired: DesiredTwist, 1;
        /// What operators ask for; take them one by one with [`Subscriber::oldest`].
        in requests: Request;
    }
}

ports! {
    /// The controller's ordinary thread: publishes telemetry, and logs what operators ask.
    RecorderPort {
        /// A record of each cycle.
        out cycles: CycleRecord;
        /// The controller's state, now and then.
        out snapshots: Snapshot;
        /// What operators ask for.
        in requests: Request;
    }
}

ports! {
    /// A process that only watches. Read all messages with [`Subscriber::oldest`], or the newest
    /// with [`Subscriber::latest`]. Recorders also subscribe to [`Request`], [`Reply`] and
    /// [`Snapshot`] by [`Domain::subscriber`].
    Observer {
        /// What the camera sees.
        in features: Features;
        /// What the controller commands.
        in twist: TwistCommand;
        /// Where the robot is.
        in robot: RobotState;
        /// What the controller's cycles do.
        in cycles: CycleRecord;
    }
}

ports! {
    /// An operator: asks the controller, and waits for its answer.
    OperatorPorts {
        /// The answers, also those to other operators.
        in replies: Reply;
        /// Requests.
        out requests: Request;
    }
}

impl CameraPorts {
    /// Lockstep: waits for the answer to the features message `sent`, at most `patience`; `None` if
    /// it does not come. Answers to other messages are ignored. A controller that comes late gets
    /// the message by history.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn wait_for_answer(
        &mut self,
        sent: &Sent,
        patience: Duration,
    ) -> Result<Option<Received<TwistCommand>>, ReceiveError> {
        // A failure to connect shows with the next message; until then, patience decides.
        answer(&mut self.twist, sent, patience, || {
            let _ = self.features.refresh();
        })
    }
}

/// A camera that sends images, in which another process finds the features; in lockstep it also
/// waits for the answers to these.
#[derive(Debug)]
pub struct ImagePorts {
    /// Commands, as in [`CameraPorts`].
    pub twist: Subscriber<TwistCommand>,
    /// What the camera sees.
    pub images: ImagePublisher,
}

impl ImagePorts {
    /// Opens the ports, for images of at most `most` bytes.
    ///
    /// # Errors
    /// As [`Domain::image_publisher`], or [`OpenError::Full`] if others have all slots of twists.
    pub fn open(domain: &Domain, most: usize) -> Result<Self, OpenError> {
        Ok(Self {
            twist: domain.subscriber(COMMANDS)?,
            images: domain.image_publisher(most)?,
        })
    }

    /// Lockstep: waits for the answer to the features that were found in the image `sent` and have
    /// its numbers, as [`CameraPorts::wait_for_answer`] does.
    ///
    /// # Errors
    /// [`ReceiveError`].
    pub fn wait_for_answer(
        &mut self,
        sent: &Sent,
        patience: Duration,
    ) -> Result<Option<Received<TwistCommand>>, ReceiveError> {
        answer(&mut self.twist, sent, patience, || {
            let _ = self.images.refresh();
        })
    }
}

/// Waits for the command that answers `sent`. Calls `refresh` while it waits, so that a
/// subscriber that comes late gets the message by history.
fn answer(
    twist: &mut Subscriber<TwistCommand>,
    sent: &Sent,
    patience: Duration,
    mut refresh: impl FnMut(),
) -> Result<Option<Received<TwistCommand>>, ReceiveError> {
    let patience = u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX);
    let end = now_ns().saturating_add(patience);
    let mut polls = 0;
    loop {
        for _ in 0..COMMANDS {
            match twist.oldest()? {
                Some(twist) if twist.answers(sent.sequence, sent.published_ns) => {
                    return Ok(Some(twist));
                }
                Some(_) => (),
                None => break,
            }
        }
        if now_ns() >= end {
            // Where others use the processors, the yields alone may have taken all the time.
            refresh();
            return Ok(None);
        }
        if polls < YIELDS {
            polls += 1;
            std::thread::yield_now();
        } else {
            refresh();
            std::thread::sleep(POLL);
        }
    }
}

impl OperatorPorts {
    /// Sends a request and waits for its answer, at most `patience`; `None` if none comes: no
    /// controller is at work, or it hangs. The request's id must be a random number, which no other
    /// operator uses.
    ///
    /// # Errors
    /// [`AskError`] if it cannot be sent, or the answer breaks the contract.
    pub fn ask(
        &mut self,
        request: &Request,
        patience: Duration,
    ) -> Result<Option<Reply>, AskError> {
        self.requests.publish(request)?;
        let patience = u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX);
        let end = now_ns().saturating_add(patience);
        while now_ns() < end {
            while let Some(reply) = self.replies.oldest()? {
                if reply.id == request.id {
                    return Ok(Some(reply.message));
                }
            }
            // A controller that came since then has not seen the request, and will not: there is no
            // history.
            self.requests.refresh()?;
            std::thread::sleep(ANSWER_POLL);
        }
        Ok(None)
    }
}
