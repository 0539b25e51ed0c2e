//! OpenCV, recordings of real arms, and an emulated one in real time judge the calibrations.

mod boards;
#[path = "../calib/drawn.rs"]
mod drawn;
mod emulator;
mod opencv;
mod real;
#[path = "../calib/station.rs"]
mod station;
#[path = "../calib/synthetic.rs"]
mod synthetic;
