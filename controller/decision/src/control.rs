//! The decision of a cycle: order and age, law, supervisor. A function of its inputs and of what
//! earlier cycles left, with no clock and no port: the loop calls it live, a replay calls it again,
//! and both get the same bits.

use alloc::vec;
use alloc::vec::Vec;

use memory_blob::Memory;
use messages::{
    Action, CycleFlags, CycleRecord, Features, Hold, MOST_WANTED_NS, Outcome, Reply, Request,
    Stamp, StrategyCode, TwistState,
};
use scene::Scene;
use serde::{Deserialize, Serialize};
use vpc::{Law, MotionMemory, Refusal, Settings, SettingsError, Step, Strategy};

use crate::contract;
use crate::decision::Decision;
use crate::gate::{Gate, Link, Verdict};
use crate::input::{Input, Inputs};
use crate::joints::JointWatch;
use crate::law::{self, Bounds};
use crate::robot::RobotWatch;
use crate::rules::{Rules, ns};
use crate::supervisor::{Situation, Supervisor};

/// What a cycle is to send.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Head of the features message that it answers; all zero if there is none.
    pub stamp: Stamp,
    /// Twist, state and hold.
    pub decision: Decision,
}

/// All that a cycle leaves to the next. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct State {
    pub gate: Gate,
    pub robot: RobotWatch,
    pub joints: JointWatch,
    pub law: vpc::State,
    pub supervisor: Supervisor,
    /// The last command of the law, for cycles without new features.
    pub standing: Answer,
    /// Cycles in a row that the law answered by prediction.
    pub predicted: u32,
    /// What another program wants.
    pub wish: Option<Wish>,
    /// How late robot or image was when it was last held for that, s.
    pub lag_s: Option<f64>,
}

/// A twist that another program wants. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Wish {
    pub twist: [f64; 6],
    /// Until when it counts, CLOCK_MONOTONIC, ns.
    pub until_ns: u64,
}

/// Decides cycle by cycle: gate, law and supervisor, with what a cycle leaves to the next. The
/// memory of motion is borrowed.
pub struct ControlStep<'m> {
    gate: Gate,
    robot: RobotWatch,
    joints: JointWatch,
    law: Law<Vec<f64>>,
    memory: Option<Memory<'m>>,
    bounds: Bounds,
    supervisor: Supervisor,
    standing: Answer,
    predicted: u32,
    wish: Option<Wish>,
    lag_s: Option<f64>,
}

impl<'m> ControlStep<'m> {
    /// Before the first cycle.
    ///
    /// # Errors
    /// [`SettingsError`] if scene and settings give no task.
    pub fn new(
        scene: &Scene,
        settings: Settings,
        memory: Option<Memory<'m>>,
        rules: Rules,
    ) -> Result<Self, SettingsError> {
        let mut law = Law::new(scene, settings, |len| vec![0.0; len])?;
        if let Some(valid_ns) = rules.valid_ns {
            law.go_live(valid_ns);
        }
        // Looked at once a period: what would be too old at the next release is too old now.
        let period_ns = ns(scene.sampling_time());
        let stale_ns = rules.valid_ns.map(|valid| valid.saturating_sub(period_ns));
        Ok(Self {
            gate: Gate::new(stale_ns),
            robot: RobotWatch::new(&rules),
            joints: JointWatch::new(&rules),
            law,
            memory,
            bounds: Bounds::of(scene),
            supervisor: Supervisor::new(rules),
            standing: Answer {
                stamp: Stamp::default(),
                decision: Decision::hold(Hold::NoFeatures),
            },
            predicted: 0,
            wish: None,
            lag_s: None,
        })
    }

    /// Before the first cycle: begins disarmed, whatever the rules say.
    pub fn begin_disarmed(&mut self, hold: Hold) {
        self.supervisor.begin_disarmed(hold);
    }

    /// What the cycles so far leave to the next. A copy; never allocates.
    pub fn state(&self) -> State {
        // Field by field: with each new one, decide here whether the next cycle depends on it.
        let Self {
            gate,
            robot,
            joints,
            law,
            memory: _,
            bounds: _,
            supervisor,
            standing,
            predicted,
            wish,
            lag_s,
        } = self;
        State {
            gate: *gate,
            robot: *robot,
            joints: *joints,
            law: law.state(),
            supervisor: *supervisor,
            standing: *standing,
            predicted: *predicted,
            wish: *wish,
            lag_s: *lag_s,
        }
    }

    /// Continues from a state of this control step, or of another one with the same scene, memory
    /// and settings.
    pub fn restore(&mut self, state: &State) {
        self.gate = state.gate;
        self.robot = state.robot;
        self.joints = state.joints;
        self.law.restore(&state.law);
        self.supervisor = state.supervisor;
        self.standing = state.standing;
        self.predicted = state.predicted;
        self.wish = state.wish;
        self.lag_s = state.lag_s;
    }

    /// The law.
    pub fn law(&self) -> &Law<Vec<f64>> {
        &self.law
    }

    /// The rules of the supervisor.
    pub fn rules(&self) -> Rules {
        self.supervisor.rules()
    }

    /// Before the first cycle: begins disarmed, under the veto of this name that stood before; 0:
    /// none stood.
    pub fn begin_again(&mut self, veto: u32) {
        self.supervisor.begin_again(veto);
    }

    /// Before the first cycle: the names of vetoes follow from this secret seed.
    pub fn name_vetoes(&mut self, seed: u64) {
        self.supervisor.name_vetoes(seed);
    }

    /// The name of the last operator's stop or disarm since it was last armed; 0: none.
    pub fn veto(&self) -> u32 {
        self.supervisor.veto().map_or(0, |veto| veto.name)
    }

    /// Whether an operator has armed it.
    pub fn has_consent(&self) -> bool {
        self.supervisor.has_consent()
    }

    /// Whether the last twist was zero.
    pub fn is_at_rest(&self) -> bool {
        self.supervisor.is_at_rest()
    }

    /// Takes an operator's request, which counts from `cycle`, the next one, on. The stamp of the
    /// answer lacks what its publication fills in.
    pub fn request(&mut self, request: &Request, cycle: u64) -> Reply {
        let outcome = match (request.action(), request.strategy_code()) {
            (Some(Action::Strategy), Some(code)) => self.change(code, request.neighbours),
            (None, _) | (Some(Action::Strategy), None) => Outcome::Unknown,
            // Whatever else it says: a stop is a stop.
            (Some(action), _) => self.supervisor.request(action, request.veto),
        };
        if (request.action(), outcome) == (Some(Action::Arm), Outcome::Done) {
            self.law.be_patient();
        }
        self.reply(request, cycle, outcome)
    }

    /// The answer to a request with this outcome.
    pub fn reply(&self, request: &Request, cycle: u64, outcome: Outcome) -> Reply {
        let (state, hold) = self.supervisor.state();
        let (strategy, neighbours) = self.strategy();
        Reply {
            stamp: Stamp {
                data_ns: request.stamp.published_ns,
                ..Stamp::default()
            },
            id: request.id,
            cycle,
            action: request.action().unwrap_or(Action::Status).code(),
            outcome: outcome.code(),
            state: state.code(),
            hold: Hold::number(hold),
            strategy: strategy.code(),
            neighbours,
            veto: self.veto(),
            named: request.veto,
            veto_ns: self.supervisor.veto().map_or(0, |veto| veto.since_ns),
        }
    }

    /// One decision. All that is decided goes into `record` as well, with what was received; times
    /// and counts are the loop's. Never allocates.
    pub fn decide(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        self.record_inputs(inputs, record);
        let law = &self.law;
        let commanded = |from_ns, to_ns| law.commanded_between(from_ns, to_ns);
        let robot = self.robot.look(&inputs.robot, inputs.now_ns, commanded);
        self.lag_s = self.robot.lag_s().or(self.lag_s);
        if self.robot.is_idle() {
            self.law.expect_no_motion();
        }
        self.see_joints(inputs);
        let robot = robot.or_else(|| self.joints.hold());
        record.desired = self.want(inputs);
        let proposed = self.propose(inputs, record);
        (record.predicted, record.drift) = (self.predicted, *self.law.drift());
        let situation = Situation {
            decision: proposed.decision,
            good_ns: self.gate.good_ns(),
            solver_failed: contract::solver_failed(record),
            missed: inputs.missed,
            robot,
            suspended: inputs.suspended,
            shutdown: inputs.shutdown,
        };
        let decision = self.supervisor.supervise(&situation, inputs.now_ns);
        if decision.twist != proposed.decision.twist {
            // The law's next prediction would be of a motion that does not happen.
            self.gate.mark_gap();
        }
        let is_new_place = matches!(proposed.decision.hold, Some(Hold::Mixed | Hold::Elsewhere));
        if decision.state == TwistState::Disarmed && is_new_place {
            // Nothing moves before an operator has armed: the object may be anywhere.
            self.law.lose_sight();
        }
        // The twist as sent, also if the law did not choose it. The instant is that of the law's
        // plan, so that a replay needs no other clock.
        let effective_ns = self.effective_ns(&proposed.stamp, inputs.now_ns);
        self.law.sent(&decision.twist, effective_ns);
        self.law.sent_elbow(decision.elbow);
        self.robot.sent(&decision.twist, inputs.now_ns);
        self.joints.sent(&decision.twist);
        record.features_sequence = proposed.stamp.sequence;
        (record.twist, record.elbow) = (decision.twist, decision.elbow);
        record.state = decision.state.code();
        record.hold = Hold::number(decision.hold);
        contract::record_joint_fault(self.joints.fault(decision.hold), record);
        record.lag_s = self.lag_s.unwrap_or(f64::NAN);
        Answer {
            stamp: proposed.stamp,
            decision,
        }
    }

    /// Thinks ahead in the slack of a cycle, after its command was sent. Never allocates; its work
    /// is bounded.
    pub fn think(&mut self) {
        self.law.think(motion(&self.memory));
    }

    /// Decides on the features that are expected at `now_ns`, and forgets it: code and data of the
    /// next decision are then in the caches. Returns what would be sent; changes nothing. Never
    /// allocates.
    pub fn rehearse(&mut self, now_ns: u64) -> Option<Answer> {
        let features = self.expected(now_ns)?;
        let inputs = Inputs {
            now_ns,
            features: Input::Message(features),
            robot: Input::Nothing,
            desired: Input::Nothing,
            missed: 0,
            suspended: false,
            shutdown: false,
        };
        let state = self.state();
        let answer = self.decide(&inputs, &mut CycleRecord::default());
        self.restore(&state);
        Some(answer)
    }

    /// The newest features that are expected at `now_ns`: whole periods after the last ones, with
    /// the points where the law expects them; `None` where nothing is expected.
    fn expected(&self, now_ns: u64) -> Option<Features> {
        let law = &self.law;
        let period_ns = (law.task().period * 1e9) as u64;
        let mut stamp = self.standing.stamp;
        let periods = now_ns.checked_sub(stamp.published_ns)? / period_ns;
        let since_ns = periods.max(1) * period_ns;
        stamp.sequence = stamp.sequence.checked_add(1)?;
        stamp.published_ns = stamp.published_ns.checked_add(since_ns)?;
        if stamp.data_ns != 0 {
            stamp.data_ns = stamp.data_ns.checked_add(since_ns)?;
        }
        let points = law.expected(contract::exposed_ns(&stamp))?;
        Some(Features {
            stamp,
            ..Features::new(&points, stamp.data_ns)
        })
    }

    /// When a command that is decided at `now_ns` takes effect: at once; or in lockstep, where the
    /// camera's stamps are the clock, when the features that it answers were delivered.
    pub fn effective_ns(&self, answered: &Stamp, now_ns: u64) -> u64 {
        match self.gate.is_live() {
            true => now_ns,
            false => answered.published_ns,
        }
    }

    /// The last decision was sent at `at_ns`, no earlier.
    pub fn sent_at(&mut self, at_ns: u64) {
        if self.gate.is_live() {
            self.law.sent_late(at_ns);
        }
    }

    /// The last decision could not be sent: which command the camera obeys is unknown.
    pub fn unsent(&mut self) {
        self.law.forget_sent();
    }

    /// The camera obeys this command from `at_ns` on, not the one of the last decision.
    pub fn obeyed(&mut self, twist: &[f64; 6], at_ns: u64) {
        if twist != self.law.standing() {
            // The law's prediction is of a motion that does not happen.
            self.gate.mark_gap();
        }
        self.law.sent_late(at_ns);
        self.law.sent(twist, at_ns);
    }

    /// Shows the law the joints that the robot tells, where they can be its own.
    fn see_joints(&mut self, inputs: &Inputs) {
        if let (Some(arm), Input::Message(state)) = (&self.law.task().arm, &inputs.robot) {
            let at_ns = self.joints.look(arm, state, inputs.now_ns);
            let joints = at_ns.and_then(|_| state.q.get(..state.joints as usize));
            self.law
                .see_joints(joints.unwrap_or_default(), at_ns.unwrap_or_default());
        }
    }

    /// What gate and law would send.
    fn propose(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        match self.gate.judge(&inputs.features, inputs.now_ns) {
            Verdict::Step { features, link } => {
                (record.count, record.points) = (features.count, features.points);
                record.visible = features.visible;
                self.predicted = 0;
                let effective_ns = self.effective_ns(&features.stamp, inputs.now_ns);
                let has_arrived = self.standing.decision.state == TwistState::Arrived;
                let decision = self.run_law(&features, effective_ns, link, has_arrived, record);
                match decision.hold {
                    None | Some(Hold::NoWay | Hold::Unwanted) => self.gate.approve(),
                    Some(hold) => _ = self.gate.hold(hold),
                }
                self.standing = Answer {
                    stamp: features.stamp,
                    decision,
                };
                self.standing
            }
            Verdict::Repeat => {
                if let Some(decision) = self.coast(inputs.now_ns, record) {
                    self.standing.decision = decision;
                    self.predicted = self.predicted.saturating_add(1);
                }
                self.standing
            }
            Verdict::Hold(hold, stamp) => {
                self.predicted = 0;
                Answer {
                    stamp,
                    decision: Decision::hold(hold),
                }
            }
        }
    }

    /// What to command on these features by a command that takes effect at `effective_ns`, on the
    /// clock of their exposure; the numbers of the step go into `record`. `had_arrived` is whether
    /// the last decision was [`TwistState::Arrived`].
    fn run_law(
        &mut self,
        features: &Features,
        effective_ns: u64,
        link: Link,
        had_arrived: bool,
        record: &mut CycleRecord,
    ) -> Decision {
        match link {
            Link::Next => (),
            Link::Broken => self.law.skip_mismatch(),
            Link::New => self.law.reset(),
        }
        let measurement = contract::measurement(features, effective_ns);
        match self.law.step(&measurement, motion(&self.memory)) {
            Ok(step) => {
                contract::record_step(&step, record);
                contract::record_hidden(&self.law, record);
                self.judge(&step, had_arrived && link != Link::New)
            }
            Err(refusal) => {
                match refusal {
                    Refusal::Lagging { lag_s, .. } => self.lag_s = Some(lag_s),
                    // The camera works, and the robot stands: features are not lost yet.
                    Refusal::Hidden { .. } if !self.law.blind().is_spent => self.gate.approve(),
                    _ => (),
                }
                Decision::hold(contract::hold_of(refusal))
            }
        }
    }

    /// What to command in a cycle of a moving camera without new features; `None`: the last command
    /// again.
    fn coast(&mut self, now_ns: u64, record: &mut CycleRecord) -> Option<Decision> {
        let state = self.standing.decision.state;
        let is_moving = matches!(state, TwistState::Moving | TwistState::Arrived);
        if !(is_moving && self.gate.is_live()) {
            return None;
        }
        let step = self.law.coast(now_ns, motion(&self.memory))?;
        contract::record_step(&step, record);
        let had_arrived = state == TwistState::Arrived;
        Some(self.judge(&step, had_arrived))
    }

    /// Tells the law what another program wants; zero if that is nothing. Without a message the
    /// last one counts, for as long as it said.
    fn want(&mut self, inputs: &Inputs) -> [f64; 6] {
        match &inputs.desired {
            Input::Message(desired) => {
                self.wish = Some(Wish {
                    twist: desired.twist,
                    until_ns: desired
                        .in_force_until_ns()
                        .min(inputs.now_ns.saturating_add(MOST_WANTED_NS)),
                });
            }
            Input::Nothing => (),
            Input::Refused(_) | Input::Failed => self.wish = None,
        }
        self.wish = self.wish.filter(|wish| inputs.now_ns < wish.until_ns);
        let wanted = self.wish.filter(|_| self.follows()).map(|wish| wish.twist);
        self.law.want(wanted);
        wanted.unwrap_or_default()
    }

    /// Whether another program steers.
    fn follows(&self) -> bool {
        self.law.settings().strategy == Strategy::Follow
    }

    /// What to command after a step of the law. Where another program steers, nothing arrives.
    fn judge(&self, step: &Step, had_arrived: bool) -> Decision {
        let decision = self.bounds.decide(step, self.law.drift(), had_arrived);
        match (self.follows() && decision.hold.is_none(), self.wish) {
            (false, _) => decision,
            (true, None) => Decision::hold(Hold::Unwanted),
            (true, Some(_)) => Decision {
                elbow: step.elbow,
                state: TwistState::Moving,
                ..decision
            },
        }
    }

    /// What was received, and under which settings it is decided.
    fn record_inputs(&self, inputs: &Inputs, record: &mut CycleRecord) {
        let (strategy, neighbours) = self.strategy();
        record.np = self.law.settings().np as u32;
        (record.strategy, record.neighbours) = (strategy.code(), neighbours);
        if strategy == StrategyCode::Foresight {
            let law = &self.law;
            contract::record_foresight(law.foreseen(), law.task().ts, record);
        }
        let (code, seen) = inputs.features.wire();
        (record.features_input, record.features_seen) = (code.code(), seen);
        let (code, seen) = inputs.robot.wire();
        (record.robot_input, record.robot_seen) = (code.code(), seen);
        let (code, seen) = inputs.desired.wire();
        (record.desired_input, record.desired_seen) = (code.code(), seen);
        record.missed = inputs.missed;
        record.veto = self.veto();
        for (flag, is_set) in [
            (CycleFlags::SHUTDOWN, inputs.shutdown),
            (CycleFlags::SUSPENDED, inputs.suspended),
        ] {
            record.flags |= if is_set { flag.0 } else { 0 };
        }
    }

    fn strategy(&self) -> (StrategyCode, u32) {
        contract::strategy_code(self.law.settings().strategy)
    }

    /// Changes the strategy. Who armed a policy's guard did not ask for a goal, nor the other way
    /// round: such a change disarms.
    fn change(&mut self, code: StrategyCode, neighbours: u32) -> Outcome {
        let Some(strategy) = contract::strategy(code, neighbours) else {
            return Outcome::Neighbours;
        };
        let followed = self.follows();
        let has_memory = law::has_memory(self.memory.as_ref(), strategy);
        if !has_memory || self.law.set_strategy(strategy).is_err() {
            return Outcome::NoMemory;
        }
        if followed != self.follows() && self.supervisor.is_armed() {
            self.supervisor.request(Action::Disarm, 0);
        }
        Outcome::Done
    }
}

/// The memory as the law takes it.
fn motion<'a>(memory: &'a Option<Memory<'_>>) -> Option<&'a dyn MotionMemory> {
    memory.as_ref().map(|memory| memory as &dyn MotionMemory)
}

#[cfg(test)]
mod tests;
