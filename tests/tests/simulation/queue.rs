//! The clock of a run and what is to happen on it, in the order of time.

use std::collections::BTreeMap;

use messages::Features;

use crate::daemon::Cycle;

/// What happens at an instant.
pub enum Event {
    /// The camera exposes an image.
    Frame,
    /// Its driver publishes it.
    Publish(Box<Features>),
    /// The robot's control period.
    Tick,
    /// The robot tells its state.
    State,
    /// A daemon wakes up; only the one of this number.
    Wake(u64),
    /// Its command goes out.
    Send(u64, Box<Cycle>),
    /// It has thought, and sleeps.
    Sleep(u64, Box<Cycle>),
    /// A new daemon starts.
    Start,
    /// An operator acts.
    Act(usize),
    /// The other program wants a twist.
    Want,
    /// The fault begins.
    Strike,
    /// A fault that lasts for some time is over.
    Recover,
    /// The trial goes on.
    Turn,
}

/// The events to come.
#[derive(Default)]
pub struct Queue {
    events: BTreeMap<(u64, u64), Event>,
    count: u64,
}

impl Queue {
    /// Lets something happen at this instant, after what was asked for it before.
    pub fn at(&mut self, at_ns: u64, event: Event) {
        self.count += 1;
        self.events.insert((at_ns, self.count), event);
    }

    /// The next event and its instant, ns.
    pub fn next(&mut self) -> Option<(u64, Event)> {
        let ((at_ns, _), event) = self.events.pop_first()?;
        Some((at_ns, event))
    }
}
