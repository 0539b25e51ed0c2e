//! What the README promises, a file for each promise: whole processes over shared memory, and
//! faults injected into them. One executable, because each that links iceoryx2 takes a minute to
//! build.
//!
//! The tests take turns (`fixture::turn`): they tell times, and two of them at once would measure
//! each other. What a machine that stands still spoils is tried again (`stall::fairly`).
//! `VPC_LONG=1` runs them at full length; without it they are as long as CI can bear, and say so.

mod bounded;
mod camera;
mod clients;
mod clock;
mod configuration;
mod deadlines;
mod delay;
mod failures;
mod faultless;
mod fixture;
mod hang;
mod hostile;
mod logging;
mod machine;
mod memory;
mod onlookers;
mod orphans;
mod own_robot;
mod peers;
mod phase;
mod refit;
mod replay;
mod shutdown;
mod silence;
mod stall;
mod startup;
mod strategies;
