//! The decision of a cycle of `vpcd`: order and age of what was received, the control law, and the
//! supervisor. A pure function of its inputs and of what earlier cycles left: the daemon calls it
//! live, a replay calls it again, and both get the same bits.
#![forbid(unsafe_code)]

pub mod contract;
pub mod control;
pub mod decision;
pub mod gate;
pub mod input;
pub mod law;
pub mod loaded;
pub mod robot;
pub mod snapshot;
pub mod supervisor;
