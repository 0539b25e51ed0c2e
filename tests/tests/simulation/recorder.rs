//! What a run leaves behind: the records of its cycles with the messages, as `vpcd` would publish
//! them, and the replay of them.

use controller::replay::replay;
use decision::{ControlStep, Input, Inputs, snapshot};
use messages::{CycleRecord, DesiredTwist, Features, Reply, RobotState, Snapshot};
use recording::Recording;
use scene::Scene;

use crate::plan::Plan;
use crate::property::Seen;

/// The records of a run, process by process; nothing where it is not recorded.
pub struct Recorder<'s> {
    is_on: bool,
    processes: Vec<(&'s Scene, Process)>,
}

/// What one process leaves.
#[derive(Default)]
struct Process {
    features: Vec<Features>,
    robot: Vec<RobotState>,
    desired: Vec<DesiredTwist>,
    cycles: Vec<CycleRecord>,
    replies: Vec<Reply>,
    snapshots: Vec<Snapshot>,
}

impl<'s> Recorder<'s> {
    /// An empty one.
    pub fn new(is_on: bool) -> Self {
        Self {
            is_on,
            processes: Vec::new(),
        }
    }

    /// Before a process's first cycle: its state.
    pub fn begin(&mut self, scene: &'s Scene, control: &ControlStep, now_ns: u64) {
        if self.is_on {
            self.processes.push((scene, Process::default()));
            self.state(1, control, now_ns);
        }
    }

    /// A cycle, which has ended.
    pub fn cycle(
        &mut self,
        record: &CycleRecord,
        inputs: &Inputs,
        seen: &Seen,
        control: &ControlStep,
    ) {
        let Some((_, process)) = self.processes.last_mut() else {
            return;
        };
        if let Input::Message(features) = inputs.features {
            process.features.push(features);
        }
        if let Input::Message(robot) = inputs.robot {
            process.robot.push(robot);
        }
        if let Input::Message(desired) = inputs.desired {
            process.desired.push(desired);
        }
        let replies = seen.answers.iter().map(|(_, reply)| *reply);
        process.replies.extend(replies);
        process.cycles.push(*record);
        if record.cycle.is_multiple_of(snapshot::EVERY) {
            self.state(record.cycle + 1, control, inputs.now_ns);
        }
    }

    fn state(&mut self, cycle: u64, control: &ControlStep, now_ns: u64) {
        let mut snapshot = snapshot::encode(cycle, &control.state()).unwrap();
        snapshot.stamp.data_ns = now_ns;
        if let Some((_, process)) = self.processes.last_mut() {
            process.snapshots.push(snapshot);
        }
    }

    /// Repeats all that was recorded: what differs.
    pub fn replay(self, plan: &Plan) -> Result<u64, String> {
        let mut all = 0;
        for (scene, process) in self.processes {
            let cycles = process.cycles.len() as u64;
            let recording = Recording {
                features: process.features,
                twist: Vec::new(),
                robot: process.robot,
                desired: process.desired,
                cycles: process.cycles,
                requests: Vec::new(),
                replies: process.replies,
                snapshots: process.snapshots,
                attachments: Default::default(),
                metadata: Default::default(),
                cut: None,
            };
            let memory = Some(plan.stock.memory());
            let rules = plan.rules(scene);
            let mut control = ControlStep::new(scene, plan.settings, memory, rules).unwrap();
            let report = replay(&mut control, &recording, None);
            let report = report.map_err(|error| error.to_string())?;
            if report.cycles != cycles {
                return Err(format!("{} of {cycles} cycles: {report:?}", report.cycles));
            }
            all += cycles;
        }
        Ok(all)
    }
}
