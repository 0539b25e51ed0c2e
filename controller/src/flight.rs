//! The flight record: the last minutes of the loop in memory, written out on a fault or on request, replayed bit for
//! bit (the file: `controller/FLIGHT.md`).
//!
//! The loop copies a [`FlightRecord`] of each cycle, and now and then a [`Key`], into wait-free queues ([`tap`]); the
//! ordinary thread keeps them in a [`Ring`] and has them written by a thread that may wait for disks ([`recorder`],
//! [`store`]). [`mod@replay`] puts a key back into a pilot and repeats what the records say.

pub mod about;
pub mod command;
pub mod fields;
pub mod file;
pub mod record;
pub mod recorder;
pub mod replay;
pub mod ring;
pub mod store;
pub mod tap;
pub mod words;

pub use about::About;
pub use file::{Flight, FlightError};
pub use record::{FlightRecord, Key};
pub use recorder::Recorder;
pub use replay::{Difference, Report, replay};
pub use ring::Ring;
pub use store::Store;
pub use tap::{Tail, Tap, Wish};
