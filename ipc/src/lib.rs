//! The transport of the contract between camera, robot, controller and observers: ports over
//! iceoryx2 publish/subscribe. What they carry are the messages of the crate `messages`.
//!
//! Quality of service and the lockstep protocol: `CONTRACT.md` beside this crate. Tour and
//! decisions: `README.md`.
//!
//! A process joins a [`Domain`], a directory that separates experiments on one machine, and opens
//! the ports of its role: [`CameraPorts`], [`RobotPorts`], [`ControllerPorts`], [`RecorderPort`],
//! [`OperatorPorts`] or [`Observer`]. Images go by [`ImagePublisher`] and [`ImageSubscriber`] and
//! are never copied; [`ImagePorts`] is a camera that sends nothing else. Peers may be absent, late,
//! killed and restarted in any order.
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
//! let sent = camera.features.publish(&messages::Features::new(&points, ipc::now_ns()))?;
//!
//! let features = controller.features.latest()?.ok_or("nothing received")?;
//! assert_eq!(features.stamp.sequence, sent.sequence);
//! let twist = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
//! let twist = messages::TwistCommand::answer(&features, twist, messages::TwistState::Moving)
//!     .valid_until(ipc::now_ns() + 100_000_000);
//! controller.twist.publish(&twist)?;
//!
//! let answer = camera.twist.latest()?.ok_or("nothing received")?;
//! assert!(answer.answers(sent.sequence, sent.published_ns) && answer.is_valid_at(ipc::now_ns()));
//! # Ok(())
//! # }
//! ```
#![deny(unsafe_code)]

mod clock;
mod domain;
mod error;
mod guard;
mod image;
mod port;
mod role;
mod service;
mod stop;

pub use clock::{now_ns, suspended_ns};
pub use domain::{Domain, default_directory, shared_memory_prefix};
pub use error::{
    AskError, JoinError, JoinReason, LoanError, OpenError, PublishError, ReceiveError,
};
pub use guard::WRITABLE_BY_OTHERS;
pub use image::{Image, ImagePublisher, ImageSubscriber, LoanedImage};
pub use port::{Publisher, Sent, Subscriber};
pub use role::{
    CameraPorts, ControllerPorts, ImagePorts, Observer, OperatorPorts, RecorderPort, RobotPorts,
};
pub use service::MAX_NODES;
pub use stop::{Asked, STOP_FILE, StopError, StopFile, stop};

/// Where the daemon leaves the scene that it runs on, for viewers: a path below the domain's
/// directory. The masks that the scene names lie beside it.
pub const SCENE_FILE: &str = "scene/scene.toml";

/// Where the daemon leaves its configuration, every default filled in, for recorders: a path below
/// the domain's directory.
pub const CONFIG_FILE: &str = "config/vpcd.toml";
