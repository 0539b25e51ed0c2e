//! The promises of `tests/PROMISES.md`, a file for each: whole processes over shared memory, and
//! faults injected into them. One executable, because each that links iceoryx2 takes a minute to
//! build.
//!
//! The tests run one at a time (`fixture::turn`), because they measure times and would disturb each
//! other. A trial that was late is repeated if the machine stood still at that time
//! (`stall::fairly`). `VPC_LONG=1` runs the
//! tests at full length; without it they are short enough for CI, and print that.

mod bounded;
mod bridge;
mod camera;
mod clients;
mod clock;
mod configuration;
mod consent;
mod damage;
mod deadlines;
mod delay;
mod failures;
mod families;
mod faultless;
mod fixture;
mod follow;
mod foresight;
mod goals;
mod guardian;
mod hands;
mod hang;
mod hostile;
mod inputs;
mod load;
mod logging;
mod machine;
mod memory;
mod onlookers;
mod orphans;
mod own_robot;
mod paced;
mod peers;
mod phase;
mod recipe;
mod refit;
mod replay;
mod shutdown;
mod silence;
mod soak;
mod stall;
mod startup;
mod steps;
mod stop;
mod stopping;
mod watch;
