//! What the loop meets outside of itself: clocks, ports, the stop file, whoever keeps its records.
//! [`Machine`](crate::machine::Machine) is the real one; `cargo test --test simulation` runs the
//! same loop in one of its own, where time is virtual.

use std::error::Error;

use decision::{ControlStep, Input, Inputs};
use messages::{CycleRecord, DesiredTwist, Features, Reply, Request, RobotState, TwistCommand};

use crate::usage::Usage;

/// The loop's surroundings. No call waits, except for the two that say so, and none allocates.
pub trait World {
    /// Why a command was not sent.
    type Unsent: Error;

    /// CLOCK_MONOTONIC, ns.
    fn now_ns(&mut self) -> u64;

    /// How long the machine was suspended since it was started, ns.
    fn suspended_ns(&mut self) -> u64;

    /// The counters of the loop's thread.
    fn usage(&mut self) -> Usage;

    /// Sleeps until an instant of CLOCK_MONOTONIC, ns, and never returns before it.
    fn sleep_until(&mut self, deadline_ns: u64);

    /// Lets another thread run.
    fn yield_now(&mut self);

    /// The newest features since the last call; nothing where the last ones came again.
    fn features(&mut self) -> Input<Features>;

    /// The newest state of the robot since the last call.
    fn robot(&mut self) -> Input<RobotState>;

    /// The newest twist that another program wants since the last call.
    fn desired(&mut self) -> Input<DesiredTwist>;

    /// The oldest request of an operator that waits.
    fn request(&mut self) -> Input<Request>;

    /// Whether the stop file asks for a stop that was not obeyed yet.
    fn is_stop_asked(&mut self) -> bool;

    /// Acknowledges that stop: the zero twist is sent.
    fn obey_stop(&mut self);

    /// Sends a command; sequence number and time of publication are filled in.
    ///
    /// # Errors
    /// It was not sent.
    fn send(&mut self, command: &TwistCommand) -> Result<(), Self::Unsent>;

    /// Sends an answer to an operator. One that cannot be sent is missed by the operator, who asks
    /// again.
    fn reply(&mut self, reply: &Reply);

    /// Asks for the flight record.
    fn dump(&mut self);

    /// Keeps the record of a cycle, with what the cycle received and what it leaves to the next;
    /// fills in how many records were lost.
    fn keep(&mut self, record: &mut CycleRecord, inputs: &Inputs, control: &ControlStep);

    /// Whether nobody keeps records any more.
    fn is_unheard(&self) -> bool;
}
