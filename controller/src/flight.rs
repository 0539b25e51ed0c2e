//! The flight record: the last minutes of the loop in memory, written out on a fault or on request
//! as a recording that `vpcd replay` repeats bit for bit (`controller/FLIGHT.md`).
//!
//! The loop copies what each cycle saw and did, and now and then its whole state, into wait-free
//! queues ([`mod@queue`]). The ordinary thread keeps them in a [`Ring`] and has them written by a
//! thread that may wait for disks ([`recorder`], [`mod@file`], [`store`]).

pub mod file;
pub mod queue;
pub mod recorder;
pub mod ring;
pub mod store;

pub use file::About;
pub use queue::{Consumer, DumpRequest, FlightCycle, Producer, queue};
pub use recorder::Recorder;
pub use ring::Ring;
