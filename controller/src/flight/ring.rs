//! The last minutes, in memory.

use std::collections::VecDeque;

use super::record::{FlightRecord, KEY_EVERY, Key};

/// The latest records and their keys; the oldest fall out.
#[derive(Debug)]
pub struct Ring {
    capacity: usize,
    records: VecDeque<FlightRecord>,
    keys: VecDeque<Key>,
}

impl Ring {
    /// Bytes that a cycle takes, with its part of the keys.
    pub const BYTES_PER_CYCLE: usize =
        size_of::<FlightRecord>() + size_of::<Key>().div_ceil(KEY_EVERY as usize);

    /// A ring for so many cycles, at least one.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self {
            capacity,
            records: VecDeque::with_capacity(capacity),
            keys: VecDeque::new(),
        }
    }

    /// Takes in a record.
    pub fn push(&mut self, record: FlightRecord) {
        if self.records.len() == self.capacity {
            self.records.pop_front();
        }
        self.records.push_back(record);
        let oldest = self.records.front().map_or(0, FlightRecord::cycle);
        while self.keys.front().is_some_and(|key| key.cycle < oldest) {
            self.keys.pop_front();
        }
    }

    /// Takes in a key.
    pub fn push_key(&mut self, key: Key) {
        self.keys.push_back(key);
    }

    /// Cycles in it.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// What a replay can use, from the oldest key on: keys and records.
    pub fn copy(&self) -> (Vec<Key>, Vec<FlightRecord>) {
        let newest = self.records.back().map_or(0, FlightRecord::cycle);
        let keys: Vec<Key> = self
            .keys
            .iter()
            .filter(|key| key.cycle <= newest)
            .copied()
            .collect();
        let first = keys.first().map_or(u64::MAX, |key| key.cycle);
        let from = self
            .records
            .partition_point(|record| record.cycle() < first);
        (keys, self.records.range(from..).copied().collect())
    }
}
