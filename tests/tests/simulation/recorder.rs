//! What a run leaves behind: the records of its cycles with the messages, as `vpcd` would publish
//! them, and the replay of them.

use controller::replay::replay;
use decision::{ControlStep, Input, snapshot};
use messages::{CycleRecord, DesiredTwist, Features, Reply, RobotState, Snapshot};
use recording::Recording;

use crate::daemon::{Cycle, Daemon};
use crate::plan::Plan;

/// The records of a run; nothing where it is not recorded.
pub struct Recorder {
    is_on: bool,
    features: Vec<Features>,
    robot: Vec<RobotState>,
    desired: Vec<DesiredTwist>,
    cycles: Vec<CycleRecord>,
    replies: Vec<Reply>,
    snapshots: Vec<Snapshot>,
}

impl Recorder {
    /// An empty one.
    pub fn new(is_on: bool) -> Self {
        Self {
            is_on,
            features: Vec::new(),
            robot: Vec::new(),
            desired: Vec::new(),
            cycles: Vec::new(),
            replies: Vec::new(),
            snapshots: Vec::new(),
        }
    }

    /// Before a daemon's first cycle, and now and then: its state.
    pub fn state(&mut self, daemon: &Daemon, now_ns: u64) {
        if self.is_on && daemon.count().is_multiple_of(snapshot::EVERY) {
            let state = daemon.control().state();
            let mut snapshot = snapshot::encode(daemon.count() + 1, &state).unwrap();
            snapshot.stamp.data_ns = now_ns;
            self.snapshots.push(snapshot);
        }
    }

    /// A cycle, which has ended.
    pub fn cycle(&mut self, cycle: &Cycle) {
        if !self.is_on {
            return;
        }
        let inputs = &cycle.inputs;
        if let Input::Message(features) = inputs.features {
            self.features.push(features);
        }
        if let Input::Message(robot) = inputs.robot {
            self.robot.push(robot);
        }
        if let Input::Message(desired) = inputs.desired {
            self.desired.push(desired);
        }
        let replies = cycle.replies.iter().map(|(_, reply)| *reply);
        self.replies.extend(replies);
        self.cycles.push(cycle.record);
    }

    /// Repeats all that was recorded: what differs.
    pub fn replay(self, plan: &Plan) -> Result<(), String> {
        if !self.is_on {
            return Ok(());
        }
        let cycles = self.cycles.len() as u64;
        let recording = Recording {
            features: self.features,
            twist: Vec::new(),
            robot: self.robot,
            desired: self.desired,
            cycles: self.cycles,
            requests: Vec::new(),
            replies: self.replies,
            snapshots: self.snapshots,
            attachments: Default::default(),
            metadata: Default::default(),
            cut: None,
        };
        let memory = Some(plan.stock.memory());
        let mut control =
            ControlStep::new(plan.scene, plan.settings, memory, plan.rules()).unwrap();
        let report = replay(&mut control, &recording, None).map_err(|error| error.to_string())?;
        match report.cycles == cycles {
            true => Ok(()),
            false => Err(format!("{} of {cycles} cycles: {report:?}", report.cycles)),
        }
    }
}
