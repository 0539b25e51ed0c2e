//! The promises of `tests/PROMISES.md`, a file for each: whole processes over shared memory, and
//! faults injected into them.
//!
//! No verdict depends on how fast the machine is: what the decision does in time is shown by
//! `cargo test --test simulation`, what needs the wall clock is measured by `cargo xtask measure`.
//! `VPC_LONG=1` runs the tests at full length; without it they are short, and print that.

mod bounded;
mod camera;
mod clock;
mod configuration;
mod consent;
mod deadlines;
mod delay;
mod fixture;
mod follow;
mod foresight;
mod goals;
mod hostile;
mod inputs;
mod limits;
#[path = "../measure/load.rs"]
mod load;
#[allow(dead_code, reason = "`measure` uses the rest")]
#[path = "../measure/machine.rs"]
mod machine;
mod memory;
#[allow(dead_code, reason = "`measure` uses the rest")]
#[path = "../measure/paced.rs"]
mod paced;
#[allow(dead_code, reason = "`measure` uses the rest")]
#[path = "../measure/reference.rs"]
mod reference;
mod replay;
mod shutdown;
