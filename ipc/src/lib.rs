//! The shared-memory contract between camera, robot, controller and everything that watches them.
//!
//! Four services carry plain `repr(C)` messages over iceoryx2 publish/subscribe (layouts, quality of service and the
//! lockstep protocol: `CONTRACT.md` beside this crate; tour and decisions: `README.md`):
//!
//! | Service | Message | Publisher | Subscribers |
//! |---|---|---|---|
//! | `vpc/features` | [`Features`] | the camera, one | the controller, observers |
//! | `vpc/twist` | [`TwistCommand`] | the controller, one | the camera's robot, observers |
//! | `vpc/robot` | [`RobotState`] | the robot, one | observers |
//! | `vpc/cycles` | [`CycleRecord`] | the controller, one | observers |
//!
//! A process joins a [`Domain`] (a directory of its own, so that two experiments on one machine do not meet) and
//! opens the ports of its role: [`CameraPorts`], [`ControllerPorts`], [`RecorderPort`] or [`Observer`]. Peers may be
//! absent, late, killed and restarted in any order.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let directory = tempfile::tempdir()?;
//! # let directory = directory.path().join("domain");
//! // The camera: one process.
//! let camera_side = ipc::Domain::join(&directory)?;
//! let mut camera = ipc::CameraPorts::open(&camera_side)?;
//! // The controller: another one.
//! let controller_side = ipc::Domain::join(&directory)?;
//! let mut controller = ipc::ControllerPorts::open(&controller_side)?;
//!
//! // Sequence number and time of publication are filled in by the port.
//! let points = [[700.0, 500.0], [900.0, 500.0], [900.0, 700.0], [700.0, 700.0]];
//! let sent = camera.features.publish(&ipc::Features::new(&points, ipc::now_ns()))?;
//!
//! let features = controller.features.latest()?.ok_or("nothing received")?;
//! assert_eq!(features.stamp.sequence, sent.sequence);
//! let twist = ipc::TwistCommand::answer(&features, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], ipc::TwistState::Moving)
//!     .valid_for_ns(100_000_000);
//! controller.twist.publish(&twist)?;
//!
//! let answer = camera.twist.latest()?.ok_or("nothing received")?;
//! assert!(answer.answers(sent.sequence, sent.published_ns) && answer.is_valid_at(ipc::now_ns()));
//! # Ok(())
//! # }
//! ```
#![deny(unsafe_code)]

mod clock;
mod cycle;
mod domain;
mod features;
mod ghost;
mod guard;
mod message;
mod operator;
mod port;
mod robot;
mod role;
mod twist;

pub use clock::now_ns;
pub use cycle::{
    ClockMode, CycleRecord, Hold, PhaseCode, RealTime, RecallCode, SolverStatus, StrategyCode,
};
pub use domain::{Domain, JoinError, default_directory, shared_memory_prefix};
pub use features::Features;
pub use guard::WRITABLE_BY_OTHERS;
pub use message::{Invalid, Message, Qos, Stamp};
pub use operator::{Action, Outcome, Reply, Request};
pub use port::{
    OpenError, Order, PublishError, Publisher, ReceiveError, Received, Sent, Subscriber,
};
pub use robot::{RobotFaults, RobotMode, RobotState};
pub use role::{AskError, CameraPorts, ControllerPorts, Observer, OperatorPorts, RecorderPort};
pub use twist::{TwistCommand, TwistState};

/// Most points that one message carries.
pub const MAX_POINTS: usize = 8;

/// Where the daemon leaves the scene that it runs on, for viewers: a path below the domain's directory. The masks that
/// the scene names lie beside it.
pub const SCENE_FILE: &str = "scene/scene.toml";
