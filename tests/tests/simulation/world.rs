//! The world of a run: camera, robot, daemon, operators, the stop file, other programs and the
//! network between them, on one clock. Every choice is of one seed, so that the same seed gives the
//! same run.

use std::hash::{DefaultHasher, Hasher};

use controller::shutdown::Stop;
use decision::{ControlStep, Input, Inputs};
use hw_sim::Referee;
use messages::{
    CycleRecord, DesiredTwist, Features, Hold, Message, Reply, Request, RobotState, TwistCommand,
    TwistState,
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use scene::Scene;

use crate::camera::Camera;
use crate::dice;
use crate::fault::Fault;
use crate::figures::Figures;
use crate::joints::Joints;
use crate::network::{Network, Way};
use crate::operator::{Habit, MOST, Operator};
use crate::plan::{Blow, Place, Plan, Stock};
use crate::policy::{self, Policy};
use crate::promise::Promise;
use crate::property::{Facts, Judge, Seen};
use crate::queue::{Event, Queue};
use crate::recorder::Recorder;
use crate::robot::Robot;
use crate::stop_file::Domain;
use crate::trial::Trial;
use crate::visitor::Visitor;

/// When a run begins, CLOCK_MONOTONIC, ns.
pub const BEGIN_NS: u64 = 1_000_000_000_000;
/// Longest run, ns.
const LONGEST_NS: u64 = 60_000_000_000;
/// The robot's control period, ns.
pub const TICK_NS: u64 = 4_000_000;
/// How long after a fault's end its messages may come, ns.
const AFTERWARDS_NS: u64 = 500_000_000;
/// From one state of the robot to the next, ns.
const STATE_NS: u64 = 20_000_000;

/// What one run found.
#[derive(Clone, Debug)]
pub struct Found {
    pub fault: Fault,
    /// Of every command.
    pub hash: u64,
    pub cycles: u64,
    /// Virtual time, ns.
    pub took_ns: u64,
    pub figures: Figures,
    /// The first property that does not hold.
    pub broken: Option<String>,
}

/// What waits for the daemon: the newest message of each port.
pub struct Inbox {
    pub features: Input<Features>,
    pub robot: Input<RobotState>,
    pub desired: Input<DesiredTwist>,
}

/// All that there is.
pub struct World<'s> {
    pub plan: Plan<'s>,
    /// For what belongs to no party.
    pub random: ChaCha8Rng,
    pub now_ns: u64,
    pub queue: Queue,
    pub network: Network,
    pub camera: Camera,
    pub robot: Robot,
    /// The scene of the next daemon.
    pub place: Place,
    pub scene: &'s Scene,
    /// The process that the note of the domain names.
    pub note: Option<u64>,
    /// The veto that stands when a daemon begins again.
    pub again: Option<u32>,
    /// The process of the daemon at work, or of the last one.
    pub id: u64,
    /// Counts the daemons' beginnings and ends.
    pub process: u64,
    pub is_at_work: bool,
    /// Whether a daemon is to start now.
    starts: bool,
    /// Ends the daemon, in order to begin again perhaps.
    pub stop: Stop,
    pub is_again: bool,
    pub inbox: Inbox,
    pub operators: Vec<Operator>,
    pub domain: Option<Domain>,
    pub policy: Policy,
    pub visitor: Option<Visitor>,
    pub referee: Option<Referee>,
    pub judge: Judge,
    pub trial: Trial,
    /// When the camera and the robot are there, ns.
    pub peers_ns: u64,
    /// Until when the daemon's process is stopped, ns.
    pub hung_until_ns: u64,
    /// How long the machine was suspended so far, ns.
    pub suspended_ns: u64,
    /// How far the clock goes back in the next cycle, ns.
    pub back_ns: u64,
    /// Cycles that will be late, and by how much, ns.
    pub late: (u32, u64),
    /// Commands that cannot be sent.
    pub unsent: u32,
    /// The newest command that came to the robot.
    pub newest: Option<TwistCommand>,
    /// The state that the last cycle told.
    pub last_state: TwistState,
    /// The instant of the camera's pose, ns.
    carried_ns: u64,
    /// When the last message of the camera came, and the last whole one, ns.
    eyes_ns: u64,
    whole_ns: u64,
    pub recorder: Recorder<'s>,
    hash: DefaultHasher,
    cycles: u64,
    /// Whether it tells what happens.
    is_told: bool,
}

impl<'s> World<'s> {
    /// The run of this seed.
    pub fn run(stock: &'s Stock, seed: u64) -> Found {
        Self::of(Plan::new(stock, seed), false).finished()
    }

    /// The world before anything happens.
    pub fn of(plan: Plan<'s>, is_told: bool) -> Self {
        let rules = plan.rules(plan.scene);
        let (seed, fault) = (plan.seed, plan.fault);
        let has_file = matches!(
            fault,
            Fault::StopFile | Fault::Reload | Fault::StopAgainstArm | Fault::Storm
        ) || fault.is_of_visit();
        let joints = (plan.place == Place::Arm).then(Joints::default);
        let turns = fault.is_of_joints();
        Self {
            random: dice(seed, 1),
            now_ns: BEGIN_NS,
            queue: Queue::default(),
            network: Network::new(dice(seed, 2)),
            camera: Camera::new(plan.scene, &plan.start, dice(seed, 3)),
            robot: Robot::new(joints),
            place: plan.place,
            scene: plan.scene,
            note: None,
            again: None,
            id: 0,
            process: 0,
            is_at_work: false,
            starts: false,
            stop: Stop::default(),
            is_again: false,
            inbox: Inbox {
                features: Input::Nothing,
                robot: Input::Nothing,
                desired: Input::Nothing,
            },
            operators: (0..MOST)
                .map(|k| Operator::new(k, dice(seed, 10 + k as u64)))
                .collect(),
            domain: has_file.then(Domain::new),
            policy: Policy::new(rules.limits, turns, dice(seed, 4)),
            visitor: None,
            referee: (fault == Fault::Guardian).then(|| Referee::new(plan.scene)),
            judge: Judge::new(rules, plan.period_ns, plan.turns_back()),
            trial: Trial::new(),
            peers_ns: BEGIN_NS,
            hung_until_ns: 0,
            suspended_ns: 0,
            back_ns: 0,
            late: (0, 0),
            unsent: 0,
            newest: None,
            last_state: TwistState::Disarmed,
            carried_ns: BEGIN_NS,
            eyes_ns: BEGIN_NS,
            whole_ns: BEGIN_NS,
            recorder: Recorder::new(plan.is_recorded && !plan.turns_back()),
            hash: DefaultHasher::new(),
            cycles: 0,
            is_told,
            plan,
        }
    }

    /// Everything until the trial is over or a property does not hold.
    pub fn finished(mut self) -> Found {
        self.begin();
        while !self.is_over() {
            self.pass(BEGIN_NS + LONGEST_NS);
            if std::mem::take(&mut self.starts) {
                self.run_process();
            } else if !self.is_over() {
                let stage = self.trial.stage;
                self.judge
                    .fail(Promise::World, || format!("none after a minute: {stage:?}"));
            }
        }
        let recorder = std::mem::replace(&mut self.recorder, Recorder::new(false));
        if self.judge.broken.is_none() {
            let replayed = recorder.replay(&self.plan);
            let cycles = *replayed.as_ref().unwrap_or(&0);
            self.judge.checks[Promise::Replay as usize] += cycles;
            let error = replayed.err();
            self.judge.check(Promise::Replay, error.is_none(), || {
                error.unwrap_or_default()
            });
        }
        let times = self.trial.figures;
        let [zero_ns, limited_ns] = match self.plan.is_limited() {
            true => [0, times.zero_ns],
            false => [times.zero_ns, 0],
        };
        Found {
            fault: self.plan.fault,
            hash: self.hash.finish(),
            cycles: self.cycles,
            took_ns: self.now_ns - BEGIN_NS,
            figures: Figures {
                checks: self.judge.checks,
                steepest: self.judge.steepest,
                stop_ns: self.judge.stop_ns,
                zero_ns,
                limited_ns,
                ..times
            },
            broken: self.judge.broken,
        }
    }

    fn begin(&mut self) {
        self.begin_trial();
        let period_ns = self.plan.period_ns;
        let mut within = |period_ns| self.random.random_range(0..period_ns);
        let (frame, tick, state) = (within(period_ns), within(TICK_NS), within(STATE_NS));
        let start = within(period_ns);
        self.queue.at(self.peers_ns + frame, Event::Frame);
        self.queue.at(self.now_ns + tick, Event::Tick);
        self.queue.at(self.peers_ns + state, Event::State);
        self.queue.at(self.now_ns + start, Event::Start);
        for number in 0..MOST {
            let act_ns = self.now_ns + self.operators[number].pause_ns();
            self.queue.at(act_ns, Event::Act(number));
        }
        for blow in &self.plan.blows {
            let [from_ns, until_ns] = [blow.from_ns, blow.until_ns].map(|ns| BEGIN_NS + ns);
            self.queue.at(from_ns, Event::Blow(*blow));
            self.queue.at(until_ns, Event::Over(*blow));
        }
    }

    /// Whether nothing more is to be shown, or something is shown to be wrong.
    pub fn is_over(&self) -> bool {
        self.trial.is_over() || self.judge.broken.is_some()
    }

    /// Everything until then happens, unless a daemon starts, ends or the run is over before.
    pub fn pass(&mut self, until_ns: u64) {
        let process = self.process;
        while let Some((at_ns, event)) = self.queue.next(until_ns) {
            self.now_ns = self.now_ns.max(at_ns);
            self.happens(event);
            if self.starts || self.process != process || self.is_over() {
                return;
            }
        }
        self.now_ns = self.now_ns.max(until_ns);
    }

    fn happens(&mut self, event: Event) {
        match event {
            Event::Frame => self.frame(),
            Event::Publish(image) => self.publish(*image),
            Event::Tick => self.tick(),
            Event::State => self.state(),
            Event::Start => self.starts = true,
            Event::Act(number) => self.act(number),
            Event::Visit => self.visit(),
            Event::Want => self.want(),
            Event::Strike => self.strike(),
            Event::Recover => self.recover(),
            Event::Turn => self.turn(),
            Event::Blow(blow) => self.blow(&blow),
            Event::Over(blow) => self.over(&blow),
            Event::Features(input) => self.see(*input),
            Event::Robot(state) => self.inbox.robot = Input::Message(*state),
            Event::Desired(desired) => self.inbox.desired = Input::Message(*desired),
            Event::Twist(command) => {
                self.robot.obey(&command);
                self.newest = Some(*command);
            }
            Event::Request(number, request) => {
                // Nobody is there, and there is no history.
                if self.is_at_work {
                    self.operators[number].arrive(*request, self.now_ns);
                }
            }
            Event::Reply(number, reply) => self.operators[number].hear(&reply),
        }
    }

    /// A delay between these, ns.
    pub fn between(&mut self, least_ns: u64, most_ns: u64) -> u64 {
        self.random.random_range(least_ns..most_ns)
    }

    /// Writes a line about what happens, where that is asked for.
    pub fn tell(&self, line: impl FnOnce() -> String) {
        if self.is_told {
            let ms = (self.now_ns - BEGIN_NS) as f64 / 1e6;
            testkit::tell(format_args!("{ms:10.3} ms: {}", line()));
        }
    }

    /// An operator asks.
    pub fn ask(&mut self, number: usize, request: Request) {
        let request = self.operators[number].stamped(request, self.now_ns);
        for at_ns in self.network.arrivals(Way::Requests, self.now_ns) {
            let event = Event::Request(number, Box::new(request));
            self.queue.at(at_ns, event);
        }
    }

    /// The daemon answers: each operator hears it.
    pub fn send_reply(&mut self, reply: &Reply) {
        let number = (reply.id >> 32) as usize;
        self.tell(|| {
            let named = reply.named;
            format!(
                "answer to {number}, {}, {named}: {:?}",
                reply.action,
                reply.outcome()
            )
        });
        if (1..=MOST).contains(&number) {
            for at_ns in self.network.arrivals(Way::Replies, self.now_ns) {
                let event = Event::Reply(number - 1, Box::new(*reply));
                self.queue.at(at_ns, event);
            }
        }
    }

    /// The daemon sends a command.
    pub fn send_twist(&mut self, command: &TwistCommand) {
        for at_ns in self.network.arrivals(Way::Twist, self.now_ns) {
            self.queue.at(at_ns, Event::Twist(Box::new(*command)));
        }
    }

    /// A daemon's cycle has ended.
    pub fn cycle(
        &mut self,
        record: &CycleRecord,
        inputs: &Inputs,
        seen: &Seen,
        control: &ControlStep,
    ) {
        self.cycles += 1;
        for v in record.twist {
            self.hash.write_u64(v.to_bits());
        }
        for code in [record.state, record.hold, record.predicted] {
            self.hash.write_u32(code);
        }
        let hold = Hold::from_code(record.hold);
        let state = TwistState::from_code(record.state).unwrap();
        self.last_state = state;
        let is_sent = seen.command.is_some();
        self.tell(|| {
            let each = record.twist.iter();
            let speed = each.fold(0.0_f64, |most, v| most.max(v.abs()));
            let error_px = record.error_px;
            let unsent = if is_sent { "" } else { " (not sent)" };
            let seen = match &inputs.features {
                Input::Message(features) => format!("{:b}", features.visible),
                Input::Nothing => "none".to_owned(),
                other => format!("{other:?}"),
            };
            let law = control.state().standing.decision.hold;
            format!("{state} {hold:?} {speed:.4}, {error_px:.1} px, features {seen}, law {law:?}{unsent}")
        });
        let waits_since_ns = self
            .operators
            .iter()
            .filter_map(Operator::waits_since_ns)
            .min();
        let facts = Facts {
            eyes_ns: self.eyes_ns,
            whole_ns: self.whole_ns,
            waits_since_ns,
            is_grave: self.is_grave(),
        };
        self.judge.cycle(record, inputs, seen, facts);
        if let Some(command) = &seen.command {
            self.observe(command, hold, seen.sent_ns);
        }
    }

    /// Whether something goes wrong now, or went wrong just before, that asks for zero at once.
    fn is_grave(&self) -> bool {
        let since_ns = self.now_ns - BEGIN_NS;
        let mut blows = self.plan.blows.iter();
        let is_now =
            |blow: &Blow| (blow.from_ns..blow.until_ns + AFTERWARDS_NS).contains(&since_ns);
        self.trial.is_grave || blows.any(|blow| blow.fault.is_grave() && is_now(blow))
    }

    /// Moves the camera to now by what the robot carries out.
    fn carry(&mut self) {
        let seconds = (self.now_ns - self.carried_ns) as f64 * 1e-9;
        self.carried_ns = self.now_ns;
        let twist = self.robot.twist();
        if twist != [0.0; 6] {
            self.camera.eye.advance(&twist, seconds);
        }
    }

    fn frame(&mut self) {
        self.carry();
        if let Some(image) = self.camera.expose(self.now_ns) {
            let delay_ns = self.plan.latency_ns + self.between(0, 500_000);
            self.queue
                .at(self.now_ns + delay_ns, Event::Publish(Box::new(image)));
        }
        let period_ns = self.plan.period_ns;
        let next_ns = self.now_ns + self.between(period_ns - 200_000, period_ns + 200_000);
        self.queue.at(next_ns, Event::Frame);
    }

    fn publish(&mut self, image: Features) {
        let Some(input) = self.camera.publish(image, self.now_ns) else {
            return;
        };
        for at_ns in self.network.arrivals(Way::Features, self.now_ns) {
            self.queue.at(at_ns, Event::Features(Box::new(input)));
        }
    }

    fn see(&mut self, input: Input<Features>) {
        self.eyes_ns = self.now_ns;
        if let Input::Message(features) = &input
            && features.all_visible()
        {
            self.whole_ns = self.now_ns;
        }
        self.inbox.features = input;
    }

    fn tick(&mut self) {
        self.carry();
        self.robot.tick(self.now_ns);
        let told = self.robot.told();
        self.judge.tick(&told, self.newest.as_ref(), self.now_ns);
        if let Some(joints) = &self.robot.joints {
            let beyond = joints.beyond();
            self.judge.joints(beyond);
        }
        self.observe_robot(told != [0.0; 6]);
        if let Some(referee) = &mut self.referee
            && let Ok(points) = self.camera.eye.features()
        {
            referee.judge_between(&points);
        }
        self.queue.at(self.now_ns + TICK_NS, Event::Tick);
    }

    fn state(&mut self) {
        // As reception checks it.
        let state = self.robot.state(self.now_ns);
        if let Some(state) = state.filter(|state| state.check().is_ok()) {
            for at_ns in self.network.arrivals(Way::Robot, self.now_ns) {
                self.queue.at(at_ns, Event::Robot(Box::new(state)));
            }
        }
        self.queue.at(self.now_ns + STATE_NS, Event::State);
    }

    fn act(&mut self, number: usize) {
        let operator = &mut self.operators[number];
        let next_ns = self.now_ns + operator.pause_ns();
        let (habit, arm) = (operator.habit, operator.arm());
        if self.is_at_work {
            match habit {
                Habit::Careful if self.trial.is_armed_for => self.ask(number, arm),
                Habit::Flood => self.fill(number),
                _ => {
                    if let Some(request) = self.operators[number].habitual() {
                        self.ask(number, request);
                    }
                }
            }
        }
        self.queue.at(next_ns, Event::Act(number));
    }

    /// Fills the queue of an operator.
    fn fill(&mut self, number: usize) {
        for _ in 0..=Request::QOS.buffer {
            let operator = &mut self.operators[number];
            if let Some(request) = operator.habitual() {
                let request = operator.stamped(request, self.now_ns);
                operator.arrive(request, self.now_ns);
            }
        }
    }

    fn want(&mut self) {
        if self.trial.wants_twist() {
            let desired = self.policy.publish(self.now_ns);
            for at_ns in self.network.arrivals(Way::Desired, self.now_ns) {
                self.queue.at(at_ns, Event::Desired(Box::new(desired)));
            }
            self.trial.twists += 1;
            self.queue.at(self.now_ns + policy::EVERY_NS, Event::Want);
        } else {
            self.policy_is_silent();
        }
    }
}
