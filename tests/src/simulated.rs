//! The daemon's decision step in simulated time: order and age, law, supervisor; the same code as
//! the daemon's loop runs, without its clock and ports.

use decision::control::State;
use decision::{ControlStep, Input, Inputs, Rules, Safety};
use memory_blob::MemoryFile;
use messages::{ClockMode, CycleRecord, Features, RobotState};
use scene::Scene;
use vpc::{Law, Settings, SettingsError};

/// When a run begins: any time but zero, which means that a time is unknown, ns.
const BEGIN_NS: u64 = 1_000_000_000;

/// A daemon that is armed, with the configuration that it has by itself but for the law.
pub struct Simulated<'m> {
    control: ControlStep<'m>,
    /// Its state before the first cycle.
    fresh: Box<State>,
}

impl<'m> Simulated<'m> {
    /// A daemon for this scene, as the law believes it to be.
    ///
    /// # Errors
    /// If scene and settings give no task.
    pub fn new(
        scene: &Scene,
        memory: Option<&'m MemoryFile>,
        settings: Settings,
        clock: ClockMode,
    ) -> Result<Self, SettingsError> {
        // Nothing carries this camera, and as in the paper its run begins in motion.
        let safety = Safety {
            armed: true,
            needs_robot: false,
            ..Safety::default()
        };
        let mut rules = Rules::new(scene, &settings, &safety, clock);
        rules.ramp_ns = 0;
        let memory = memory.map(MemoryFile::view);
        let control = ControlStep::new(scene, settings, memory, rules)?;
        let fresh = Box::new(control.state());
        Ok(Self { control, fresh })
    }

    /// Begins a run.
    pub fn restart(&mut self) {
        self.control.restore(&self.fresh);
    }

    /// The law.
    pub fn law(&self) -> &Law<Vec<f64>> {
        self.control.law()
    }

    /// What a cycle receives `now_ns` after the begin of the run: a message whose exposure is
    /// counted from there, if one arrives.
    pub fn received(features: Option<Features>, now_ns: u64) -> Inputs {
        Self::heard(features, None, now_ns)
    }

    /// The same with a state of the robot at this instant.
    pub fn heard(features: Option<Features>, robot: Option<RobotState>, now_ns: u64) -> Inputs {
        let now_ns = BEGIN_NS + now_ns;
        let features = features.map_or(Input::Nothing, |mut features| {
            features.stamp.data_ns += BEGIN_NS;
            features.stamp.published_ns = now_ns;
            Input::Message(features)
        });
        Inputs {
            now_ns,
            features,
            robot: robot.map_or(Input::Nothing, |mut state| {
                (state.stamp.data_ns, state.stamp.published_ns) = (now_ns, now_ns);
                Input::Message(state)
            }),
            desired: Input::Nothing,
            missed: 0,
            suspended: false,
            shutdown: false,
        }
    }

    /// One decision, and all that is told of it.
    pub fn decide(&mut self, inputs: &Inputs) -> CycleRecord {
        let mut record = CycleRecord::default();
        self.control.decide(inputs, &mut record);
        record
    }

    /// The camera obeys another command than the last decision's, from `at_ns` after the begin of
    /// the run on.
    pub fn sent(&mut self, twist: &[f64; 6], at_ns: u64) {
        self.control.obeyed(twist, BEGIN_NS + at_ns);
    }

    /// Rehearses the decision at that instant, as the loop does just before a cycle's release.
    pub fn rehearse(&mut self, now_ns: u64) {
        self.control.rehearse(now_ns);
    }

    /// Thinks ahead, after the decision.
    pub fn think(&mut self) {
        self.control.think();
    }
}
