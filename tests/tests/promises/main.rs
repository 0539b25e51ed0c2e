//! The promises of `tests/PROMISES.md`, a file for each: whole processes over shared memory, and
//! faults injected into them. One executable, because each that links iceoryx2 takes a minute to
//! build.
//!
//! The tests run one at a time (`fixture::turn`), because they measure times and would disturb each
//! other. A trial that was late is repeated if the machine stood still at that time
//! (`stall::fairly`). `VPC_LONG=1` runs the
//! tests at full length; without it they are short enough for CI, and print that.

mod bounded;
mod camera;
mod clock;
mod configuration;
mod consent;
mod deadlines;
mod delay;
mod failures;
mod fixture;
mod follow;
mod foresight;
mod goals;
mod guardian;
mod hostile;
mod inputs;
#[path = "../measure/load.rs"]
mod load;
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
mod silence;
mod stall;
mod steps;
mod watch;
