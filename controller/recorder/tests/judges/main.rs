//! A recording as others read it: the packages of MCAP and Foxglove for Python, and pandas. `cargo
//! xtask judges` runs them.

#[path = "../recorder/fixture.rs"]
mod fixture;
mod python;
mod values;
