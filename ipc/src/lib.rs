//! The shared-memory contract between camera, robot, controller and observers.
//!
//! Each service carries one plain `repr(C)` message over iceoryx2 publish/subscribe:
//!
//! | Service | Message | Publisher | Subscribers |
//! |---|---|---|---|
//! | `vpc/features` | [`Features`] | camera | controller, observers |
//! | `vpc/twist` | [`TwistCommand`] | controller | camera's robot, observers |
//! | `vpc/robot` | [`RobotState`] | robot | controller, observers |
//! | `vpc/cycles` | [`CycleRecord`] | controller | observers |
//! | `vpc/snapshots` | [`Snapshot`] | controller | recorders |
//! | `vpc/requests` | [`Request`] | operators | controller |
//! | `vpc/replies` | [`Reply`] | controller | operators |
//! | `vpc/image` | bytes under an [`ImageHeader`] | camera | programs that find features, views |
//!
//! Layouts, quality of service and the lockstep protocol: `CONTRACT.md` beside this crate. Tour and
//! decisions: `README.md`. The fields of a message are listed once, in its file; [`Wire::FIELDS`]
//! has them at run time, and the C header, the Python module, the tables of `CONTRACT.md` and the
//! schemas of recordings are made from it.
//!
//! A process joins a [`Domain`], a directory that separates experiments on one machine, and opens
//! the ports of its role: [`CameraPorts`], [`RobotPorts`], [`ControllerPorts`], [`RecorderPort`],
//! [`OperatorPorts`] or [`Observer`]. Images go by [`ImagePublisher`] and [`ImageSubscriber`] and
//! are never copied; [`ImagePorts`] is a camera that sends nothing else. Peers may be absent, late, killed and restarted in any order.
//! Complete programs: `examples/camera.rs`, `examples/observer.rs`.
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
//! let twist = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
//! let twist = ipc::TwistCommand::answer(&features, twist, ipc::TwistState::Moving)
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
mod codes;
mod cycle;
mod domain;
mod error;
mod features;
mod field;
mod guard;
mod image;
mod message;
mod operator;
mod port;
mod robot;
mod role;
mod service;
mod snapshot;
mod stop;
mod twist;

pub use clock::{now_ns, suspended_ns};
pub use codes::{Name, Table};
pub use cycle::{
    ClockMode, CycleFlags, CycleRecord, ForesightCode, Hold, InputCode, MAX_NEIGHBOURS,
    PATH_PLACES, PhaseCode, RealTime, RecallCode, SolverStatus, StrategyCode,
};
pub use domain::{Domain, default_directory, shared_memory_prefix};
pub use error::{
    AskError, JoinError, JoinReason, LoanError, OpenError, PublishError, ReceiveError,
};
pub use features::Features;
pub use field::{Field, FieldType, Kind, Meaning, Stamp, Struct, Values, ValuesMut, Wire};
pub use guard::WRITABLE_BY_OTHERS;
pub use image::{
    Encoding, Image, ImageHeader, ImagePublisher, ImageSubscriber, LoanedImage, MOST_IMAGE_BYTES,
};
pub use message::{Invalid, Message, Payload, Qos};
pub use operator::{Action, Outcome, Reply, Request};
pub use port::{Order, Publisher, Received, Sent, Subscriber};
pub use robot::{RobotFaults, RobotMode, RobotState};
pub use role::{
    CameraPorts, ControllerPorts, ImagePorts, Observer, OperatorPorts, RecorderPort, RobotPorts,
};
pub use service::{MAX_NODES, SERVICES, Service};
pub use snapshot::Snapshot;
pub use stop::{Asked, STOP_FILE, StopError, StopFile, stop};
pub use twist::{FUTURE_NS, MOST_OBEYED_NS, TwistCommand, TwistState};

/// Most points that one message carries.
pub const MAX_POINTS: usize = 8;

/// Where the daemon leaves the scene that it runs on, for viewers: a path below the domain's
/// directory. The masks that the scene names lie beside it.
pub const SCENE_FILE: &str = "scene/scene.toml";

/// Where the daemon leaves its configuration, every default filled in, for recorders: a path below
/// the domain's directory.
pub const CONFIG_FILE: &str = "config/vpcd.toml";
