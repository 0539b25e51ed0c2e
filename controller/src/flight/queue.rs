//! From the loop to the ordinary thread: wait-free queues, and a flag that requests a flight
//! record.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use messages::{CycleRecord, DesiredTwist, Features, Reply, RobotState};
use rtrb::RingBuffer;

use decision::control::State;
use decision::{ControlStep, Input, Inputs, snapshot};

/// Cycles that the queue holds: many pauses' worth of lockstep cycles.
pub const CAPACITY: usize = 8192;
/// Snapshots that go with as many cycles, and some to spare for those after losses.
const SNAPSHOTS: usize = 2 * CAPACITY / snapshot::EVERY as usize;
/// Replies: a flood of requests, taken as fast as the loop takes them, for a while.
const REPLIES: usize = 1024;

/// Set to request that the flight record is written, by an operator's request or a signal.
#[derive(Clone, Debug, Default)]
pub struct DumpRequest(Arc<AtomicBool>);

impl DumpRequest {
    /// A request that SIGUSR1 makes as well.
    ///
    /// # Errors
    /// If the operating system refuses the handler.
    pub fn by_signal() -> std::io::Result<Self> {
        let request = Self::default();
        program::set_on(signal_hook::consts::SIGUSR1, &request.0)?;
        Ok(request)
    }

    /// Requests it. Wait-free. Release: the thread that takes the request sees what was recorded
    /// before.
    pub fn make(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether it was asked for since the last call.
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Acquire)
    }
}

/// What the loop leaves of a cycle: its record, and the messages that it received.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct FlightCycle {
    pub record: CycleRecord,
    pub features: Option<Features>,
    pub robot: Option<RobotState>,
    pub desired: Option<DesiredTwist>,
}

impl FlightCycle {
    /// A cycle with these inputs.
    pub fn new(record: &CycleRecord, inputs: &Inputs) -> Self {
        fn message<T: Copy>(input: &Input<T>) -> Option<T> {
            match input {
                Input::Message(message) => Some(*message),
                _ => None,
            }
        }
        Self {
            record: *record,
            features: message(&inputs.features),
            robot: message(&inputs.robot),
            desired: message(&inputs.desired),
        }
    }
}

/// The state before a cycle.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct StateBefore {
    pub cycle: u64,
    /// When it was taken, CLOCK_MONOTONIC, ns.
    pub taken_ns: u64,
    pub state: State,
}

/// The loop's end.
pub struct Producer {
    cycles: rtrb::Producer<FlightCycle>,
    states: rtrb::Producer<StateBefore>,
    replies: rtrb::Producer<Reply>,
    /// Cycles until the next snapshot is due.
    until_snapshot: u64,
    lost: u64,
}

/// The ordinary thread's end. What belongs to a cycle was pushed before it: take the cycles first,
/// and none of it is missing.
#[allow(missing_docs)]
pub struct Consumer {
    pub cycles: rtrb::Consumer<FlightCycle>,
    pub states: rtrb::Consumer<StateBefore>,
    pub replies: rtrb::Consumer<Reply>,
}

/// Both ends.
pub fn queue() -> (Producer, Consumer) {
    let (cycles, cycles_out) = RingBuffer::new(CAPACITY);
    let (states, states_out) = RingBuffer::new(SNAPSHOTS);
    let (replies, replies_out) = RingBuffer::new(REPLIES);
    let producer = Producer {
        cycles,
        states,
        replies,
        until_snapshot: 0,
        lost: 0,
    };
    let consumer = Consumer {
        cycles: cycles_out,
        states: states_out,
        replies: replies_out,
    };
    (producer, consumer)
}

impl Producer {
    /// Leaves the state before the first cycle, at `now_ns`.
    pub fn begin(&mut self, control: &ControlStep, now_ns: u64) {
        self.snapshot(1, now_ns, control);
    }

    /// Leaves an answer to an operator. One that is lost costs the replay the cycles up to the next
    /// snapshot.
    pub fn reply(&mut self, reply: &Reply) {
        if self.replies.push(*reply).is_err() {
            self.until_snapshot = 0;
        }
    }

    /// Leaves a cycle, or counts it as lost if the queue is full, and now and then what it leaves
    /// to the next one. Wait-free; never allocates.
    pub fn cycle(&mut self, record: &CycleRecord, inputs: &Inputs, control: &ControlStep) {
        self.until_snapshot = self.until_snapshot.saturating_sub(1);
        let cycle = FlightCycle::new(record, inputs);
        if self.cycles.push(cycle).is_err() {
            self.lost += 1;
            // No replay gets across the gap without a snapshot.
            self.until_snapshot = 0;
        }
        self.snapshot(record.cycle + 1, inputs.now_ns, control);
    }

    /// Cycles lost so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Whether the ordinary thread is gone. Wait-free.
    pub fn is_abandoned(&self) -> bool {
        self.cycles.is_abandoned()
    }

    fn snapshot(&mut self, cycle: u64, taken_ns: u64, control: &ControlStep) {
        if self.until_snapshot > 0 {
            return;
        }
        let before = StateBefore {
            cycle,
            taken_ns,
            state: control.state(),
        };
        // If the queue is full, the next cycle tries again.
        if self.states.push(before).is_ok() {
            self.until_snapshot = snapshot::EVERY;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loop_knows_whether_anybody_listens() {
        let (producer, consumer) = queue();
        assert!(!producer.is_abandoned());
        drop(consumer);
        assert!(producer.is_abandoned());
    }
}
