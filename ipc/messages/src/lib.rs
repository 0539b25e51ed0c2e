//! The messages of the contract between camera, robot, controller and observers: plain `repr(C)`
//! data. This crate knows no transport, no clock and no files; programs that open ports use the
//! crate `ipc`. A program that only reads data needs this crate alone.
//!
//! Each service carries one message:
//!
//! | Service | Message | Publisher | Subscribers |
//! |---|---|---|---|
//! | `vpc/features` | [`Features`] | camera | controller, observers |
//! | `vpc/twist` | [`TwistCommand`] | controller | camera's robot, observers |
//! | `vpc/robot` | [`RobotState`] | robot | controller, observers |
//! | `vpc/desired` | [`DesiredTwist`] | a policy, joystick or planner | controller, observers |
//! | `vpc/cycles` | [`CycleRecord`] | controller | observers |
//! | `vpc/snapshots` | [`Snapshot`] | controller | recorders |
//! | `vpc/requests` | [`Request`] | operators | controller |
//! | `vpc/replies` | [`Reply`] | controller | operators |
//! | `vpc/image` | bytes under an [`ImageHeader`] | camera | programs that find features, views |
//!
//! The fields of a message are listed once, in its file; [`Wire::FIELDS`] has them at run time, and
//! the C header, the Python module, the tables of `CONTRACT.md` and the schemas of recordings are
//! made from it.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod codes;
mod cycle;
mod desired;
mod features;
mod field;
mod image;
mod message;
mod operator;
mod order;
mod robot;
mod service;
mod snapshot;
mod twist;

pub use codes::{Name, Table};
pub use cycle::{
    ArmBound, Bound, ClockMode, CycleFlags, CycleRecord, ForesightCode, Hold, InputCode,
    JointFault, JointFaultCode, MAX_NEIGHBOURS, PATH_PLACES, PhaseCode, RealTime, RecallCode,
    SolverStatus, StrategyCode,
};
pub use desired::{DesiredTwist, MOST_WANTED_NS};
pub use features::{Features, MAX_POINTS};
pub use field::{Field, FieldType, Kind, Meaning, Stamp, Struct, Values, ValuesMut, Wire};
pub use image::{Encoding, ImageHeader, MOST_IMAGE_BYTES};
pub use message::{Invalid, Message, Payload, Qos};
pub use operator::{Action, Outcome, Reply, Request};
pub use order::{Order, Received};
pub use robot::{RobotFaults, RobotMode, RobotState};
pub use service::{SERVICES, Service};
pub use snapshot::Snapshot;
pub use twist::{FUTURE_NS, MOST_OBEYED_NS, TwistCommand, TwistState};
