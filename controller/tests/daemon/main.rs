//! The daemon over real shared memory.

mod allocation;
mod delay;
mod fixture;
mod flight;
mod process;
mod realtime;
mod record;
mod refusal;
