//! Where messages go: a file, or the clients of a live view.

use crate::clock::WallClock;
use crate::error::WriteError;
use crate::message::{Encoding, Recorded};

/// Takes messages by topics. What it receives of a message is the same in a recording and live.
pub trait Sink {
    /// The clock that stamps are translated by.
    fn clock(&self) -> WallClock;

    /// Takes a message of any topic, at a time in ns since 1970; the first one opens its channel.
    /// `encoding` and `data` are called only where they are needed.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    fn put(
        &mut self,
        topic: &'static str,
        encoding: impl FnOnce() -> Encoding,
        sequence: u64,
        wall_ns: u64,
        data: impl FnOnce() -> Vec<u8>,
    ) -> Result<(), WriteError>;

    /// Takes a message on the topic of its type.
    ///
    /// # Errors
    /// [`WriteError`].
    fn write<T: Recorded>(&mut self, message: &T) -> Result<(), WriteError> {
        let stamp = message.stamp();
        let wall_ns = self.clock().wall_of(stamp.published_ns);
        let data = || message.to_json().into_bytes();
        self.put(T::TOPIC, T::encoding, stamp.sequence, wall_ns, data)
    }
}
