//! The daemon over real shared memory. One executable: each that links iceoryx2 costs up to a
//! minute of build.

mod allocation;
mod delay;
mod fixture;
mod flight;
mod process;
mod realtime;
mod record;
mod refusal;
