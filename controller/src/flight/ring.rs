//! The last minutes, in memory.

use std::collections::VecDeque;

use messages::{Reply, Snapshot};

use super::queue::FlightCycle;
use decision::snapshot;

/// Room for replies, whatever the room for cycles.
const LEAST_REPLIES: usize = 1024;

/// The latest cycles with the replies and snapshots that belong to them; the oldest fall out.
#[derive(Clone, Debug, Default)]
pub struct Ring {
    capacity: usize,
    cycles: VecDeque<FlightCycle>,
    replies: VecDeque<Reply>,
    snapshots: VecDeque<Snapshot>,
}

impl Ring {
    /// Bytes that a cycle takes, with its part of the snapshots.
    pub const BYTES_PER_CYCLE: usize =
        size_of::<FlightCycle>() + size_of::<Snapshot>().div_ceil(snapshot::EVERY as usize);

    /// A ring for at least one cycle.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self {
            capacity,
            cycles: VecDeque::with_capacity(capacity),
            ..Self::default()
        }
    }

    /// Takes in a cycle.
    pub fn push(&mut self, cycle: FlightCycle) {
        if self.cycles.len() == self.capacity {
            self.cycles.pop_front();
        }
        self.cycles.push_back(cycle);
        let oldest = self.oldest();
        while self.snapshots.front().is_some_and(|s| s.cycle < oldest) {
            self.snapshots.pop_front();
        }
        while self
            .replies
            .front()
            .is_some_and(|reply| reply.cycle < oldest)
        {
            self.replies.pop_front();
        }
    }

    /// Takes in a reply. Without cycles, a flood of them must not take all memory.
    pub fn push_reply(&mut self, reply: Reply) {
        if self.replies.len() == self.capacity.max(LEAST_REPLIES) {
            self.replies.pop_front();
        }
        self.replies.push_back(reply);
    }

    /// Takes in a snapshot.
    pub fn push_snapshot(&mut self, snapshot: Snapshot) {
        self.snapshots.push_back(snapshot);
    }

    /// Cycles in it.
    pub fn len(&self) -> usize {
        self.cycles.len()
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.cycles.is_empty()
    }

    /// The cycles, the oldest first.
    pub fn cycles(&self) -> impl Iterator<Item = &FlightCycle> {
        self.cycles.iter()
    }

    /// The replies, the oldest first.
    pub fn replies(&self) -> impl Iterator<Item = &Reply> {
        self.replies.iter()
    }

    /// The snapshots, the oldest first.
    pub fn snapshots(&self) -> impl Iterator<Item = &Snapshot> {
        self.snapshots.iter()
    }

    fn oldest(&self) -> u64 {
        self.cycles.front().map_or(0, |cycle| cycle.record.cycle)
    }
}
