//! The way out of the loop: two wait-free queues and a flag.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ipc::{Action, CycleRecord, Outcome, Reply, Request};
use rtrb::{Consumer, Producer, RingBuffer};

use super::record::{Asked, FlightRecord, KEY_EVERY, Key};
use super::words::Seal;
use crate::pilot::{Answer, Inputs, Pilot};

/// Cycles that the queue holds: many pauses' worth of lockstep cycles.
pub const QUEUE: usize = 8192;
/// Keys that go with so many cycles, and some to spare for those after losses.
const KEYS: usize = 2 * QUEUE / KEY_EVERY as usize;

/// Set by whoever wants the flight record written: an operator's request, a signal.
#[derive(Clone, Debug, Default)]
pub struct Wish(Arc<AtomicBool>);

impl Wish {
    /// A wish that SIGUSR1 makes, too.
    ///
    /// # Errors
    /// Where the operating system refuses the handler.
    pub fn by_signal() -> std::io::Result<Self> {
        let wish = Self::default();
        signal_hook::flag::register(signal_hook::consts::SIGUSR1, Arc::clone(&wish.0))?;
        Ok(wish)
    }

    /// Asks for it. Wait-free. Release: what was recorded before is seen by whoever finds the wish.
    pub fn make(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether it was asked for since the last call.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Acquire)
    }
}

/// The loop's end.
pub struct Tap {
    records: Producer<FlightRecord>,
    keys: Producer<Key>,
    wish: Wish,
    /// Requests since the last cycle.
    asked: Asked,
    /// Seal of the pilot's state after the last cycle.
    before: u64,
    /// Cycles until the next key is due.
    until_key: u64,
    lost: u64,
}

/// The ordinary thread's end.
pub struct Tail {
    records: Consumer<FlightRecord>,
    keys: Consumer<Key>,
    wish: Wish,
}

/// Both ends. `wish` is what the loop makes by `Tap::wish`.
pub fn tap(wish: Wish) -> (Tap, Tail) {
    let (records, records_out) = RingBuffer::new(QUEUE);
    let (keys, keys_out) = RingBuffer::new(KEYS);
    let tail = Tail {
        records: records_out,
        keys: keys_out,
        wish: wish.clone(),
    };
    let tap = Tap {
        records,
        keys,
        wish,
        asked: Asked::NOTHING,
        before: 0,
        until_key: 0,
        lost: 0,
    };
    (tap, tail)
}

impl Tap {
    /// The beginning: leaves the first key.
    pub fn begin(&mut self, pilot: &Pilot) {
        self.look(1, pilot);
    }

    /// Notes a request that the pilot was given, with its answer; it belongs to the next cycle. One to write the flight
    /// record is fulfilled here, wait-free.
    pub fn ask(&mut self, request: &Request, reply: &mut Reply) {
        if request.action() == Some(Action::Record) && reply.outcome() == Some(Outcome::NoRecord) {
            self.wish.make();
            reply.outcome = Outcome::Done.code();
        }
        if let Some(outcome) = reply.outcome() {
            self.asked.push(request, outcome);
        }
    }

    /// After a cycle, whose answer was `sent` or could not be: leaves its record, or counts it as lost where the queue is full, and looks at what the pilot
    /// leaves to the next one. Wait-free; never allocates.
    pub fn cycle(
        &mut self,
        inputs: Inputs,
        answer: Answer,
        sent: bool,
        told: &CycleRecord,
        pilot: &Pilot,
    ) {
        let asked = core::mem::replace(&mut self.asked, Asked::NOTHING);
        let record = FlightRecord::sealed(self.before, asked, inputs, answer, sent, *told);
        self.until_key = self.until_key.saturating_sub(1);
        let is_kept = self.records.push(record).is_ok();
        if !is_kept {
            self.lost += 1;
        }
        if !is_kept || !asked.is_whole() {
            // No replay gets across the gap without a key.
            self.until_key = 0;
        }
        self.look(told.cycle + 1, pilot);
    }

    /// Records lost so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Whether the ordinary thread is gone. Wait-free.
    pub fn is_unheard(&self) -> bool {
        self.records.is_abandoned()
    }

    fn look(&mut self, next: u64, pilot: &Pilot) {
        let mut state = pilot.state();
        self.before = Seal::of(&mut state);
        // Where the queue is full, the next cycle tries again.
        if self.until_key == 0 && self.keys.push(Key::sealed(next, state)).is_ok() {
            self.until_key = KEY_EVERY;
        }
    }
}

impl Tail {
    /// Whether the loop has let go of its end. Asked before the last [`Tail::pop`], so that nothing is left behind.
    pub fn is_abandoned(&self) -> bool {
        self.records.is_abandoned()
    }

    /// Whether the record was asked for since the last call; asked before [`Tail::pop`], so that it includes what was
    /// recorded before.
    pub fn wished(&self) -> bool {
        self.wish.take()
    }

    /// The next record.
    pub fn pop(&mut self) -> Option<FlightRecord> {
        self.records.pop().ok()
    }

    /// The next key. The key of a cycle was pushed before its record: taken after the records, none is missing.
    pub fn pop_key(&mut self) -> Option<Key> {
        self.keys.pop().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loop_knows_whether_anybody_hears_it() {
        let (tap, tail) = tap(Wish::default());
        assert!(!tap.is_unheard());
        drop(tail);
        assert!(tap.is_unheard());
    }
}
