//! The robot's side: a robot with its bridge, the task around the servoing, and a referee of its
//! own.

pub mod arm;
pub mod bridge;
pub mod calibration;
pub mod control_unit;
pub mod described;
pub mod description;
pub mod inspector;
pub mod sequence;
pub mod truth;
