//! The clock of a run and what is to happen on it, in the order of time.

use std::collections::BTreeMap;

use decision::Input;
use messages::{DesiredTwist, Features, Reply, Request, RobotState, TwistCommand};

use crate::plan::Blow;

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
    /// A daemon starts.
    Start,
    /// An operator acts.
    Act(usize),
    /// A program that arms by itself acts.
    Visit,
    /// The other program wants a twist.
    Want,
    /// The fault begins.
    Strike,
    /// A fault that lasts for some time is over.
    Recover,
    /// The trial goes on.
    Turn,
    /// An event of the plan begins, and is over.
    Blow(Blow),
    Over(Blow),

    // Messages arrive.
    Features(Box<Input<Features>>),
    Robot(Box<RobotState>),
    Desired(Box<DesiredTwist>),
    Twist(Box<TwistCommand>),
    Request(usize, Box<Request>),
    Reply(usize, Box<Reply>),
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

    /// The next event, and its instant, ns, unless that is later than this.
    pub fn next(&mut self, until_ns: u64) -> Option<(u64, Event)> {
        let first = self.events.first_entry()?;
        let (at_ns, _) = *first.key();
        (at_ns <= until_ns).then(|| (at_ns, first.remove()))
    }
}
