//! The state of the controller, from which a replay can begin.

use crate::field::Stamp;
use crate::message::{Qos, message};

/// Most bytes of a state.
const STATE: usize = 57_344;

message! {
    /// All that a cycle leaves to the next one, at the beginning and every second or so. Only for a
    /// replay by the same version of vpcd: `state` is private to it.
    Snapshot {
        /// Head.
        stamp: Stamp,
        /// The cycle that follows.
        cycle: u64,
        /// Bytes in `state`.
        length: u32 [range(0, STATE)],
        /// Version of the encoding of `state`.
        version: u32,
        /// The state, encoded by the controller; zero past `length`.
        state: [u8; STATE],
    }
    // A history of one: a recorder that starts late gets a snapshot at once.
    "vpc/snapshots" from "controller": Qos { history: 1, buffer: 16, subscribers: 4, publishers: 1 }
}

impl Snapshot {
    /// Most bytes in `state`.
    pub const MAX_LENGTH: usize = STATE;

    /// A snapshot before `cycle`; `None` if `state` has more than [`Snapshot::MAX_LENGTH`] bytes.
    pub fn new(cycle: u64, version: u32, state: &[u8]) -> Option<Self> {
        let mut snapshot = Self {
            cycle,
            version,
            length: u32::try_from(state.len()).ok()?,
            ..Self::default()
        };
        snapshot
            .state
            .get_mut(..state.len())?
            .copy_from_slice(state);
        Some(snapshot)
    }

    /// The encoded state.
    pub fn bytes(&self) -> &[u8] {
        let length = (self.length as usize).min(STATE);
        &self.state[..length]
    }
}
