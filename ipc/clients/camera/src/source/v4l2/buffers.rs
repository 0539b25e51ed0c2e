//! The buffers of a driver, real or of a test.

use std::time::Duration;

use rustix::io::Errno;

use super::abi::ERROR;

/// Buffers that the driver fills in turn.
pub(super) const BUFFERS: u32 = 4;

/// A full buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Buffer {
    pub index: u32,
    pub sequence: u32,
    pub flags: u32,
    pub used: usize,
    pub stamp_ns: u64,
}

impl Buffer {
    pub fn is_damaged(&self) -> bool {
        self.flags & ERROR != 0
    }
}

/// Buffers that a driver fills.
pub(super) trait Buffers {
    /// Waits until a buffer is full; false after `timeout`.
    fn wait(&mut self, timeout: Duration) -> Result<bool, Errno>;
    /// Takes the oldest full buffer; `None` if there is none.
    fn take(&mut self) -> Result<Option<Buffer>, Errno>;
    /// Gives a buffer back.
    fn give(&mut self, index: u32) -> Result<(), Errno>;
    fn bytes(&self, index: u32) -> &[u8];
    fn now_ns(&self) -> u64;
}
