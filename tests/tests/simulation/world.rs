//! The world of a run: camera, robot, daemon, operators, the stop file and another program, on one
//! clock. Every choice is of one seed, so that the same seed gives the same run.

use std::hash::{DefaultHasher, Hasher};

use decision::Input;
use hw_sim::Referee;
use messages::TwistCommand;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::PERIOD_NS;
use crate::camera::Camera;
use crate::daemon::{Daemon, Inbox};
use crate::fault::Fault;
use crate::figures::Figures;
use crate::operator::{Habit, MOST, Operator};
use crate::plan::{Plan, Stock};
use crate::policy::{self, Policy};
use crate::property::Judge;
use crate::queue::{Event, Queue};
use crate::recorder::Recorder;
use crate::robot::Robot;
use crate::stop_file::Domain;
use crate::trial::Trial;

/// When a run begins, CLOCK_MONOTONIC, ns.
const BEGIN_NS: u64 = 1_000_000_000_000;
/// Longest run, ns.
const LONGEST_NS: u64 = 60_000_000_000;
/// The robot's control period, ns.
const TICK_NS: u64 = 4_000_000;
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

/// What a process leaves for the next of its domain, beside the stop file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Left {
    /// Nothing: none was there, or it ended in order.
    Nothing,
    /// It was killed.
    Killed,
    /// It begins again; the number of stops before.
    Again(u32),
}

/// All that there is.
pub struct World<'s> {
    pub plan: Plan<'s>,
    pub random: ChaCha8Rng,
    pub now_ns: u64,
    pub queue: Queue,
    pub camera: Camera,
    pub robot: Robot,
    pub daemon: Option<Daemon<'s>>,
    pub left: Left,
    /// Number of the daemon at work: events of others are void.
    pub process: u64,
    pub inbox: Inbox,
    pub operators: Vec<Operator>,
    pub domain: Option<Domain>,
    pub policy: Policy,
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
    pub shutdown: bool,
    /// The newest command that came to the robot.
    pub newest: Option<TwistCommand>,
    /// The instant of the camera's pose, ns.
    carried_ns: u64,
    /// When the last message of the camera came, ns.
    pub eyes_ns: u64,
    pub recorder: Recorder,
    pub hash: DefaultHasher,
    pub cycles: u64,
    /// Whether it tells what happens.
    is_told: bool,
}

impl<'s> World<'s> {
    /// The run of this seed.
    pub fn run(stock: &'s Stock, seed: u64, is_told: bool) -> Found {
        let (plan, random) = Plan::new(stock, seed);
        Self::of(plan, random, is_told).finished()
    }

    /// The world before anything happens.
    pub fn of(plan: Plan<'s>, random: ChaCha8Rng, is_told: bool) -> Self {
        let rules = plan.rules();
        let mut habits = [Habit::Idle; MOST];
        habits[0] = Habit::Careful;
        let operators = habits.into_iter().enumerate();
        let is_guarded = plan.fault == Fault::Guardian;
        let has_file = matches!(
            plan.fault,
            Fault::StopFile | Fault::Reload | Fault::StopAgainstArm | Fault::Storm
        );
        Self {
            now_ns: BEGIN_NS,
            queue: Queue::default(),
            camera: Camera::new(plan.scene, &plan.start),
            robot: Robot::default(),
            daemon: None,
            left: Left::Nothing,
            process: 0,
            inbox: Inbox::default(),
            operators: operators
                .map(|(k, habit)| Operator::new(k, habit))
                .collect(),
            domain: has_file.then(Domain::new),
            policy: Policy::new(rules.limits),
            referee: is_guarded.then(|| Referee::new(plan.scene)),
            judge: Judge::new(rules, BEGIN_NS),
            trial: Trial::new(plan.fault),
            peers_ns: BEGIN_NS,
            hung_until_ns: 0,
            suspended_ns: 0,
            back_ns: 0,
            late: (0, 0),
            unsent: 0,
            shutdown: false,
            newest: None,
            carried_ns: BEGIN_NS,
            eyes_ns: 0,
            recorder: Recorder::new(plan.is_recorded && plan.fault != Fault::ClockBack),
            hash: DefaultHasher::new(),
            cycles: 0,
            is_told,
            plan,
            random,
        }
    }

    /// Everything until the trial is over or a property does not hold.
    pub fn finished(mut self) -> Found {
        self.begin();
        while !self.trial.is_over() && self.judge.broken.is_none() {
            let Some((at_ns, event)) = self.queue.next() else {
                break;
            };
            self.now_ns = at_ns;
            if at_ns > BEGIN_NS + LONGEST_NS {
                let stage = self.trial.stage();
                self.judge
                    .fail(|| format!("end: none after a minute: {stage}"));
            }
            self.happens(event);
        }
        if self.judge.broken.is_none() {
            let replayed = self.recorder.replay(&self.plan);
            let failed = |error: String| self.judge.fail(|| format!("replay: {error}"));
            replayed.unwrap_or_else(failed);
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
        let mut within = |period_ns| self.random.random_range(0..period_ns);
        let (frame, tick, state) = (within(PERIOD_NS), within(TICK_NS), within(STATE_NS));
        let (start, act) = (within(PERIOD_NS), within(PERIOD_NS));
        self.queue.at(self.peers_ns + frame, Event::Frame);
        self.queue.at(self.now_ns + tick, Event::Tick);
        self.queue.at(self.peers_ns + state, Event::State);
        self.queue.at(self.now_ns + start, Event::Start);
        self.queue.at(self.now_ns + act, Event::Act(0));
    }

    fn happens(&mut self, event: Event) {
        match event {
            Event::Wake(process) | Event::Send(process, _) | Event::Sleep(process, _)
                if process != self.process => {}
            Event::Wake(_) | Event::Send(..) | Event::Sleep(..)
                if self.now_ns < self.hung_until_ns =>
            {
                self.queue.at(self.hung_until_ns, event);
            }
            Event::Wake(_) => self.wake(),
            Event::Send(_, cycle) => self.send(cycle),
            Event::Sleep(_, cycle) => self.sleep(cycle),
            Event::Frame => self.frame(),
            Event::Publish(image) => self.publish(*image),
            Event::Tick => self.tick(),
            Event::State => self.state(),
            Event::Start => self.start(),
            Event::Act(number) => self.act(number),
            Event::Want => self.want(),
            Event::Strike => self.strike(),
            Event::Recover => self.recover(),
            Event::Turn => self.turn(),
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
        if let Some(image) = self.camera.expose(self.now_ns, &mut self.random) {
            let delay_ns = self.plan.latency_ns + self.between(0, 500_000);
            self.queue
                .at(self.now_ns + delay_ns, Event::Publish(Box::new(image)));
        }
        let next_ns = self.now_ns + self.between(PERIOD_NS - 200_000, PERIOD_NS + 200_000);
        self.queue.at(next_ns, Event::Frame);
    }

    fn publish(&mut self, image: messages::Features) {
        let published = self.camera.publish(image, self.now_ns, &mut self.random);
        if let Some(input) = published {
            self.eyes_ns = self.now_ns;
            self.inbox.features = input;
        }
    }

    fn tick(&mut self) {
        self.carry();
        self.robot.tick(self.now_ns);
        let told = self.robot.twist();
        self.judge.tick(&told, self.newest.as_ref(), self.now_ns);
        self.observe_robot(told != [0.0; 6]);
        if let Some(referee) = &mut self.referee
            && let Ok(points) = self.camera.eye.features()
        {
            referee.judge_between(&points);
        }
        self.queue.at(self.now_ns + TICK_NS, Event::Tick);
    }

    fn state(&mut self) {
        if let Some(state) = self.robot.state(self.now_ns) {
            self.inbox.robot = Input::Message(state);
        }
        self.queue.at(self.now_ns + STATE_NS, Event::State);
    }

    fn act(&mut self, number: usize) {
        let operator = &mut self.operators[number];
        let every_ns = match operator.habit {
            Habit::ArmLoop => 10_000_000,
            Habit::Wild => 150_000_000,
            Habit::Careful | Habit::Flood | Habit::Idle => 40_000_000,
        };
        if self.daemon.is_some() {
            match operator.habit {
                Habit::Careful if self.trial.wants_motion() => operator.arm(self.now_ns),
                // When the daemon looks, its queue is full.
                Habit::Flood => (),
                _ => operator.act(self.now_ns, &mut self.random),
            }
        }
        let next_ns = self.now_ns + self.random.random_range(every_ns / 2..every_ns);
        self.queue.at(next_ns, Event::Act(number));
    }

    fn want(&mut self) {
        if self.trial.wants_twist() {
            let desired = self.policy.publish(self.now_ns, &mut self.random);
            self.inbox.desired = Input::Message(desired);
            self.trial.wanted();
            self.queue.at(self.now_ns + policy::EVERY_NS, Event::Want);
        } else {
            self.policy_is_silent();
        }
    }
}
