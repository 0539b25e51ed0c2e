//! The decision of a cycle of `vpcd`: whether what was received may reach the control law, one step
//! of it, and whether its twist may go out. A pure function of its inputs and of what earlier
//! cycles left: the daemon calls it live, a replay calls it again, and both get the same bits.
//!
//! Without `std` there is no clock, no file, no thread and no environment here: the compiler keeps
//! the function pure. The time is an argument. [`ControlStep::decide`] calls, in this order, the
//! watches of the robot ([`robot`], [`joints`]), the [`gate`], the law ([`law`], [`contract`]) and
//! the [`supervisor`]. Each module uses only those above it:
//!
//! - [`rules`]: limits and times, from scene and settings
//! - [`input`]: what a cycle received
//! - [`decision`]: what is to be sent, or why not
//! - [`contract`]: codes of messages and types of the law
//! - [`gate`]: order and age of the features
//! - [`robot`]: a robot that is at fault, silent, or not following
//! - [`joints`]: joints that are out of range, or do not move as their robot says
//! - [`law`]: the last check of the law's twist
//! - [`veto`]: an operator's stop or disarm, which the next arming names
//! - [`supervisor`]: armed, braking, disarmed
//! - [`control`]: the whole decision
//! - [`snapshot`]: its state as bytes
//!
//! [`presence`] has the rules by which a daemon knows of the one before it.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

extern crate alloc;

pub mod contract;
pub mod control;
pub mod decision;
pub mod gate;
pub mod input;
pub mod joints;
pub mod law;
pub mod presence;
pub mod robot;
pub mod rules;
pub mod snapshot;
pub mod supervisor;
pub mod veto;

pub use control::{Answer, ControlStep};
pub use decision::Decision;
pub use input::{Input, Inputs};
pub use rules::{AfterArrival, Rules, Safety};
