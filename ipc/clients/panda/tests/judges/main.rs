//! Judges of the bridge and of the emulated robot, in real time: the vendor's libraries and clients
//! of other teams, emulators of other teams, strangers on the network, and processes that hang.

mod fci;
mod forged;
mod franka_sim;
mod hangs;
#[path = "../bridge/robot.rs"]
mod robot;
