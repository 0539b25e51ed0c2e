//! The decision of a cycle: order and age, law, supervisor. A function of its inputs and of what
//! earlier cycles left, with no clock and no port: the loop calls it live, a replay calls it again,
//! and both get the same bits.

use messages::{
    Action, CycleFlags, CycleRecord, Features, Outcome, Reply, Request, Stamp, StrategyCode,
    TwistState,
};
use serde::{Deserialize, Serialize};

use crate::contract;
use crate::decision::{Decision, HoldReason, hold_code};
use crate::gate::{Gate, Verdict};
use crate::input::{Input, Inputs};
use crate::law;
use crate::loaded::LoadedController;
use crate::robot::RobotWatch;
use crate::supervisor::{Rules, Situation, Supervisor};

/// What a cycle is to send.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Head of the features message that it answers; all zero if there is none.
    pub stamp: Stamp,
    /// Twist, state and reason of the hold.
    pub decision: Decision,
}

/// All that a cycle leaves to the next. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct State {
    pub gate: Gate,
    pub robot: RobotWatch,
    pub law: vpc::State,
    pub supervisor: Supervisor,
    /// The last command of the law, for cycles without new features.
    pub standing: Answer,
}

/// Decides cycle by cycle: gate, law and supervisor, with what a cycle leaves to the next.
pub struct ControlStep {
    gate: Gate,
    robot: RobotWatch,
    loaded: LoadedController,
    supervisor: Supervisor,
    standing: Answer,
}

impl ControlStep {
    /// Before the first cycle. Features are stale after `stale_ns` of silence, never in lockstep
    /// (`None`).
    pub fn new(loaded: LoadedController, stale_ns: Option<u64>, rules: Rules) -> Self {
        Self {
            gate: Gate::new(stale_ns),
            robot: RobotWatch::new(&rules),
            loaded,
            supervisor: Supervisor::new(rules),
            standing: Answer {
                stamp: Stamp::default(),
                decision: Decision::hold(HoldReason::NoFeatures),
            },
        }
    }

    /// What the cycles so far leave to the next. A copy; never allocates.
    pub fn state(&self) -> State {
        // Field by field: who adds one must say here whether the next cycle depends on it.
        let Self {
            gate,
            robot,
            loaded,
            supervisor,
            standing,
        } = self;
        State {
            gate: *gate,
            robot: *robot,
            law: loaded.controller.state(),
            supervisor: *supervisor,
            standing: *standing,
        }
    }

    /// Continues from a state of this control step, or of another one with the same scene, memory
    /// and settings.
    pub fn restore(&mut self, state: &State) {
        self.gate = state.gate;
        self.robot = state.robot;
        self.loaded.controller.restore(&state.law);
        self.supervisor = state.supervisor;
        self.standing = state.standing;
    }

    /// The law with its scene and memory.
    pub fn loaded(&self) -> &LoadedController {
        &self.loaded
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
            (Some(action), _) => self.supervisor.request(action, request.stops),
        };
        if (request.action(), outcome) == (Some(Action::Arm), Outcome::Done) {
            self.loaded.controller.be_patient();
        }
        self.reply(request, cycle, outcome)
    }

    /// The answer to a request with this outcome.
    pub fn reply(&self, request: &Request, cycle: u64, outcome: Outcome) -> Reply {
        let (state, reason) = self.supervisor.state();
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
            hold: hold_code(reason),
            strategy: strategy.code(),
            neighbours,
            stops: self.supervisor.stops(),
            seen: request.stops,
        }
    }

    /// One decision. All that is decided goes into `record` as well, with what was received; times
    /// and counts are the loop's. Never allocates.
    pub fn decide(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        self.record_inputs(inputs, record);
        let robot = self.robot.look(&inputs.robot, inputs.now_ns);
        if self.robot.is_idle() {
            self.loaded.controller.expect_no_motion();
        }
        let proposed = self.propose(inputs, record);
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
        let is_new_place = matches!(
            proposed.decision.hold,
            Some(HoldReason::Mixed | HoldReason::Elsewhere)
        );
        if decision.state == TwistState::Disarmed && is_new_place {
            // Nothing moves before an operator has armed: the object may be anywhere.
            self.loaded.controller.lose_sight();
        }
        // The twist as sent, also if the law did not choose it. The instant is that of the law's
        // plan, so that a replay needs no other clock.
        let effective_ns = self.effective_ns(&proposed.stamp, inputs.now_ns);
        self.loaded.controller.sent(&decision.twist, effective_ns);
        self.robot.sent(&decision.twist, inputs.now_ns);
        record.features_sequence = proposed.stamp.sequence;
        record.twist = decision.twist;
        record.state = decision.state.code();
        record.hold = decision.hold_code();
        Answer {
            stamp: proposed.stamp,
            decision,
        }
    }

    /// Thinks ahead in the slack of a cycle, after its command was sent. Never allocates; its work
    /// is bounded.
    pub fn think(&mut self) {
        self.loaded.think();
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
        let controller = &self.loaded.controller;
        let period_ns = (controller.task().period * 1e9) as u64;
        let mut stamp = self.standing.stamp;
        let periods = now_ns.checked_sub(stamp.published_ns)? / period_ns;
        let since_ns = periods.max(1) * period_ns;
        stamp.sequence = stamp.sequence.checked_add(1)?;
        stamp.published_ns = stamp.published_ns.checked_add(since_ns)?;
        if stamp.data_ns != 0 {
            stamp.data_ns = stamp.data_ns.checked_add(since_ns)?;
        }
        let points = controller.expected(contract::exposed_ns(&stamp))?;
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

    /// The last decision could not be sent: which command the camera obeys is unknown.
    pub fn unsent(&mut self) {
        self.loaded.controller.forget_sent();
    }

    /// What gate and law would send.
    fn propose(&mut self, inputs: &Inputs, record: &mut CycleRecord) -> Answer {
        match self.gate.judge(&inputs.features, inputs.now_ns) {
            Verdict::Step { features, link } => {
                (record.count, record.points) = (features.count, features.points);
                let effective_ns = self.effective_ns(&features.stamp, inputs.now_ns);
                let has_arrived = self.standing.decision.state == TwistState::Arrived;
                let decision = law::decide(
                    &mut self.loaded,
                    &features,
                    effective_ns,
                    link,
                    has_arrived,
                    record,
                );
                match decision.hold {
                    None | Some(HoldReason::NoWay) => self.gate.approve(),
                    Some(reason) => _ = self.gate.hold(reason),
                }
                self.standing = Answer {
                    stamp: features.stamp,
                    decision,
                };
                self.standing
            }
            Verdict::Repeat => self.standing,
            Verdict::Hold(reason, stamp) => Answer {
                stamp,
                decision: Decision::hold(reason),
            },
        }
    }

    /// What was received, and under which settings it is decided.
    fn record_inputs(&self, inputs: &Inputs, record: &mut CycleRecord) {
        let (strategy, neighbours) = self.strategy();
        record.np = self.loaded.controller.settings().np as u32;
        (record.strategy, record.neighbours) = (strategy.code(), neighbours);
        if strategy == StrategyCode::Foresight {
            let controller = &self.loaded.controller;
            contract::record_foresight(controller.foreseen(), controller.task().ts, record);
        }
        let (code, seen) = inputs.features.wire();
        (record.features_input, record.features_seen) = (code.code(), seen);
        let (code, seen) = inputs.robot.wire();
        (record.robot_input, record.robot_seen) = (code.code(), seen);
        record.missed = inputs.missed;
        record.stops = self.supervisor.stops();
        for (flag, is_set) in [
            (CycleFlags::SHUTDOWN, inputs.shutdown),
            (CycleFlags::SUSPENDED, inputs.suspended),
        ] {
            record.flags |= if is_set { flag.0 } else { 0 };
        }
    }

    fn strategy(&self) -> (StrategyCode, u32) {
        contract::strategy_code(self.loaded.controller.settings().strategy)
    }

    fn change(&mut self, code: StrategyCode, neighbours: u32) -> Outcome {
        match contract::strategy(code, neighbours) {
            None => Outcome::Neighbours,
            Some(strategy) if self.loaded.set_strategy(strategy) => Outcome::Done,
            Some(_) => Outcome::NoMemory,
        }
    }
}

#[cfg(test)]
mod tests {
    use messages::{Features, RobotState};
    use rand::{Rng, RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use scene::SceneFiles;

    use super::*;
    use crate::input::Input;

    const MS: u64 = 1_000_000;
    const PERIOD: u64 = 33 * MS;
    const LIMITS: [f64; 6] = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
    /// Features far from the goal: the law always wants to move.
    const FAR: [[f64; 2]; 4] = [
        [250.0, 250.0],
        [420.0, 260.0],
        [410.0, 430.0],
        [240.0, 420.0],
    ];

    fn nasty_instant(now_ns: u64, random: &mut impl Rng) -> u64 {
        match random.random_range(0..6) {
            0 => random.random(),
            1 => [0, 1, 1 << 63, u64::MAX - 1, u64::MAX][random.random_range(0..5)],
            _ => now_ns.saturating_add(PERIOD) - random.random_range(0..20 * PERIOD),
        }
    }

    fn nasty_stamp(now_ns: u64, random: &mut impl Rng) -> Stamp {
        Stamp {
            sequence: nasty_instant(now_ns, random),
            published_ns: nasty_instant(now_ns, random),
            data_ns: nasty_instant(now_ns, random),
        }
    }

    /// A number that makes a message any of: the first, the next, one after a gap, a repeated one,
    /// a restarted one.
    fn any_number(random: &mut impl Rng) -> u64 {
        [1, 7, 8, 9, random.random()][random.random_range(0..5)]
    }

    /// What a camera sends: good features mostly, so that the law has a say; anything else now and
    /// then.
    fn features(now_ns: u64, number: u64, random: &mut impl Rng) -> Input<Features> {
        let points = FAR.map(|point| point.map(|x| x + random.random_range(-0.1..0.1)));
        let mut message = Features::new(&points, now_ns - 20 * MS);
        (message.stamp.sequence, message.stamp.published_ns) = (number, now_ns - MS);
        match random.random_range(0..40) {
            0 => message.stamp = nasty_stamp(now_ns, random),
            1 => message.stamp.sequence = any_number(random),
            2 => message.points = message.points.map(|x| x * random.random_range(-1e9..1e9)),
            3 => message.points[random.random_range(0..8)] = f64::NAN,
            4 => message.count = random.random(),
            5 => message.visible = random.random(),
            6 => return Input::Nothing,
            7 => return Input::Refused(nasty_stamp(now_ns, random)),
            8 => return Input::Failed,
            _ => (),
        }
        Input::Message(message)
    }

    fn robot(now_ns: u64, random: &mut impl Rng) -> Input<RobotState> {
        let mut message = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns);
        message.stamp.published_ns = now_ns;
        match random.random_range(0..40) {
            0 => message.stamp = nasty_stamp(now_ns, random),
            1 => message.mode = random.random(),
            2 => message.faults = random.random(),
            3..20 => return Input::Nothing,
            _ => (),
        }
        Input::Message(message)
    }

    /// In real time, at rest and not armed.
    fn control() -> ControlStep {
        let text = scene::PAPER_SIM.to_owned();
        let files = SceneFiles::parse(text, "sim", &|_| unreachable!("no masks")).unwrap();
        let mut loaded =
            LoadedController::of(files, "sim", None, vpc::Settings::default()).unwrap();
        loaded.controller.go_live(3 * PERIOD);
        let rules = Rules {
            limits: LIMITS,
            change: [f64::INFINITY; 6],
            brake_ns: 150 * MS,
            ramp_ns: 150 * MS,
            lost_ns: Some(300 * MS),
            needs_robot: false,
            begins: None,
            after_arrival: Default::default(),
        };
        ControlStep::new(loaded, Some(2 * PERIOD), rules)
    }

    #[test]
    fn in_real_time_no_input_whatsoever_panics_or_passes_the_limits() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut control = control();
        let mut now_ns = 1 << 40;
        let (mut moving, mut still) = (0, 0);
        for cycle in 0..30_000 {
            now_ns += match random.random_range(0..200) {
                0 => random.random_range(0..3000 * MS),
                1 => 0,
                _ => PERIOD,
            };
            // No clock should.
            now_ns -= if random.random_bool(0.005) { 2 * MS } else { 0 };
            if random.random_bool(0.3) {
                let action = if random.random_bool(0.9) {
                    Action::Arm.code()
                } else {
                    random.random_range(0..7)
                };
                let mut request = Request::new(cycle, Action::Status);
                (request.action, request.neighbours) = (action, random.random());
                // Who arms has seen the last stop, or not.
                let stops = [control.supervisor.stops(), random.random()];
                request.stops = stops[usize::from(random.random_bool(0.5))];
                control.request(&request, cycle);
            }
            let inputs = Inputs {
                now_ns,
                features: features(now_ns, cycle + 1, &mut random),
                robot: robot(now_ns, &mut random),
                missed: match random.random_range(0..20) {
                    0 => random.random(),
                    _ => 0,
                },
                suspended: random.random_bool(0.002),
                shutdown: false,
            };
            let Answer { decision, .. } = control.decide(&inputs, &mut CycleRecord::default());
            let mut shares = decision.twist.iter().zip(LIMITS);
            // A NaN is not within.
            let is_within = shares.all(|(v, limit)| v.abs() <= limit * (1.0 + 1e-9));
            assert!(is_within, "{decision:?} after {inputs:?}");
            match decision.twist == [0.0; 6] {
                true => still += 1,
                false => moving += 1,
            }
        }
        // There was work, and there were faults.
        assert!(moving > 3000 && still > 3000, "{moving} and {still}");
    }

    #[test]
    fn a_rehearsal_runs_the_law_and_changes_nothing() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let (mut plain, mut rehearsing) = (control(), control());
        let mut by_the_law = 0;
        for cycle in 0..3000 {
            let now_ns = (1 << 40) + cycle * PERIOD;
            if random.random_bool(0.3) {
                for control in [&mut plain, &mut rehearsing] {
                    control.request(&Request::new(cycle, Action::Arm), cycle);
                }
            }
            let instant = match random.random_range(0..10) {
                0 => nasty_instant(now_ns, &mut random),
                _ => now_ns,
            };
            let rehearsed = rehearsing.rehearse(instant);
            by_the_law += u32::from(rehearsed.is_some_and(|answer| answer.decision.hold.is_none()));
            let inputs = Inputs {
                now_ns,
                features: features(now_ns, cycle + 1, &mut random),
                robot: robot(now_ns, &mut random),
                missed: 0,
                suspended: false,
                shutdown: false,
            };
            let told = [&mut plain, &mut rehearsing].map(|control| {
                let mut record = CycleRecord::default();
                control.decide(&inputs, &mut record);
                control.think();
                // As text: a NaN is no other than itself.
                format!("{record:?} {:?}", control.state())
            });
            assert!(told[0] == told[1], "cycle {cycle}: {inputs:?}");
        }
        assert!(by_the_law > 100, "{by_the_law}");
    }
}
