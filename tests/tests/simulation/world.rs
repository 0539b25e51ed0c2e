//! The world of a run: camera, robot, daemon, operators, the stop file and another program, on one
//! clock. Every choice is of one seed, so that the same seed gives the same run.

use std::hash::{DefaultHasher, Hasher};

use decision::Input;
use hw_sim::Referee;
use messages::{Action, Hold, Reply, Request, TwistCommand};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::PERIOD_NS;
use crate::camera::Camera;
use crate::daemon::{Begin, Cycle, Daemon, Inbox};
use crate::fault::Fault;
use crate::operator::{Habit, MOST, Operator};
use crate::plan::{Plan, Stock};
use crate::policy::{self, Policy};
use crate::property::{Facts, Judge};
use crate::queue::{Event, Queue};
use crate::recorder::Recorder;
use crate::robot::Robot;
use crate::stop_file::Domain;
use crate::trial::{Figures, Trial};

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
    /// It begins again, after so many stops.
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
    newest: Option<TwistCommand>,
    /// The instant of the camera's pose, ns.
    carried_ns: u64,
    /// When the last message of the camera came, ns.
    eyes_ns: u64,
    recorder: Recorder,
    hash: DefaultHasher,
    cycles: u64,
    /// Whether it tells what happens.
    is_told: bool,
}

impl<'s> World<'s> {
    /// The run of this seed.
    pub fn run(stock: &'s Stock, seed: u64, is_told: bool) -> Found {
        let (plan, random) = Plan::new(stock, seed);
        Self::of(plan, random, is_told).to_the_end()
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
            Fault::StopFile | Fault::Reload | Fault::StopAgainstArm
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
    pub fn to_the_end(mut self) -> Found {
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
        Found {
            fault: self.plan.fault,
            hash: self.hash.finish(),
            cycles: self.cycles,
            took_ns: self.now_ns - BEGIN_NS,
            figures: Figures {
                steepest: self.judge.steepest,
                stop_ns: self.judge.stop_ns,
                ..self.trial.figures
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
            Event::Frame => self.frame(),
            Event::Publish(image) => self.publish(*image),
            Event::Tick => self.tick(),
            Event::State => self.state(),
            Event::Wake(process) if process == self.process => {
                if !self.waits_for_process(|| Event::Wake(process)) {
                    self.wake();
                }
            }
            Event::Send(process, cycle) if process == self.process => {
                match self.now_ns < self.hung_until_ns {
                    true => self
                        .queue
                        .at(self.hung_until_ns, Event::Send(process, cycle)),
                    false => self.send(cycle),
                }
            }
            Event::Sleep(process, cycle) if process == self.process => {
                match self.now_ns < self.hung_until_ns {
                    true => self
                        .queue
                        .at(self.hung_until_ns, Event::Sleep(process, cycle)),
                    false => self.sleep(cycle),
                }
            }
            Event::Wake(_) | Event::Send(..) | Event::Sleep(..) => (),
            Event::Start => self.start(),
            Event::Act(number) => self.act(number),
            Event::Want => self.want(),
            Event::Strike => self.strike(),
            Event::Recover => self.recover(),
            Event::Turn => self.turn(),
        }
    }

    fn waits_for_process(&mut self, event: impl FnOnce() -> Event) -> bool {
        let hangs = self.now_ns < self.hung_until_ns;
        if hangs {
            self.queue.at(self.hung_until_ns, event());
        }
        hangs
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

    /// A new process, after what the one before has left.
    fn start(&mut self) {
        let begin = match self.left {
            Left::Nothing => Begin::Configured,
            Left::Killed => Begin::Unclean,
            Left::Again(stops) => Begin::Again(stops),
        };
        self.tell(|| format!("vpcd starts: {begin:?}"));
        self.process += 1;
        self.shutdown = false;
        let daemon = Daemon::new(&self.plan, begin, self.now_ns, self.suspended_ns);
        self.recorder.state(&daemon, self.now_ns);
        let release_ns = daemon.release_ns();
        self.daemon = Some(daemon);
        self.queue
            .at(release_ns + 50_000, Event::Wake(self.process));
    }

    /// The process is gone, whatever it was about to do.
    pub fn kill(&mut self) {
        self.tell(|| "vpcd is killed".to_owned());
        self.daemon = None;
        self.process += 1;
        self.left = Left::Killed;
        self.operators.iter_mut().for_each(Operator::forget);
        self.judge.killed();
    }

    /// The daemon's cycle up to its decision.
    fn wake(&mut self) {
        let back_ns = std::mem::take(&mut self.back_ns);
        let woken_ns = self.now_ns - back_ns;
        let now_ns = woken_ns + self.between(5_000, 40_000);
        let inbox = std::mem::take(&mut self.inbox);
        let Some(mut daemon) = self.daemon.take() else {
            return;
        };
        daemon.hear(&inbox.features, woken_ns);
        self.take_requests(&mut daemon, now_ns);
        let mut cycle = daemon.decide(inbox, woken_ns, now_ns, self.suspended_ns, self.shutdown);
        let decided_ns = now_ns + self.between(10_000, 300_000);
        daemon.decided(&mut cycle, decided_ns);
        self.daemon = Some(daemon);
        let sent_ns = decided_ns + back_ns + self.between(5_000, 60_000);
        self.queue
            .at(sent_ns, Event::Send(self.process, Box::new(cycle)));
    }

    /// All requests that wait, in any order of the operators, and the stop file after them.
    fn take_requests(&mut self, daemon: &mut Daemon, now_ns: u64) {
        for operator in &mut self.operators {
            if operator.habit == Habit::Flood {
                operator.act(self.now_ns, &mut self.random);
            }
        }
        for _ in 0..Request::PER_CYCLE {
            let waiting = (0..MOST).filter(|k| self.operators[*k].waits());
            let waiting: Vec<usize> = waiting.collect();
            if waiting.is_empty() {
                break;
            }
            let number = waiting[self.random.random_range(0..waiting.len())];
            if let Some(request) = self.operators[number].oldest() {
                daemon.take(&request, now_ns);
            }
        }
        if self.domain.as_mut().is_some_and(Domain::is_asked) {
            daemon.take(&Request::new(Request::STOP_FILE, Action::Stop), now_ns);
        }
    }

    /// The cycle's command and its answers go out.
    fn send(&mut self, mut cycle: Box<Cycle>) {
        let Some(daemon) = &mut self.daemon else {
            return;
        };
        let can_send = self.unsent == 0;
        self.unsent = self.unsent.saturating_sub(1);
        let sent = daemon.send(&mut cycle, self.now_ns, can_send);
        let decision = cycle.answer.decision;
        let command = sent.unwrap_or_else(|| {
            TwistCommand::answer_to(&cycle.answer.stamp, decision.twist, decision.state)
        });
        for v in command.twist {
            self.hash.write_u64(v.to_bits());
        }
        self.hash.write_u32(command.state);
        self.hash.write_u32(Hold::number(decision.hold));
        self.tell(|| {
            let speed = command
                .twist
                .iter()
                .fold(0.0_f64, |most, v| most.max(v.abs()));
            format!(
                "{} {:?} {speed:.4}{}",
                decision.state,
                decision.hold,
                if sent.is_some() { "" } else { " (not sent)" }
            )
        });
        let facts = Facts {
            eyes_ns: self.eyes_ns,
            is_grave: self.trial.is_grave,
        };
        self.judge.cycle(&cycle, &command, facts, self.now_ns);
        self.answer(&mut cycle);
        if let Some(command) = sent {
            self.robot.obey(&command);
            self.newest = Some(command);
            self.acknowledge_stop(&command);
            self.observe(&command, decision.hold);
        }
        let thought_ns = self.now_ns + self.between(20_000, 7_000_000);
        self.queue.at(thought_ns, Event::Sleep(self.process, cycle));
    }

    /// Each answer goes to the operator that asked; each request has exactly one.
    fn answer(&mut self, cycle: &mut Cycle) {
        for (request, reply) in &mut cycle.replies {
            (reply.stamp.sequence, reply.stamp.published_ns) = (1, self.now_ns);
            let reply: &Reply = reply;
            if request.id == Request::STOP_FILE {
                continue;
            }
            self.tell(|| format!("answer to {:?}: {:?}", request.action(), reply.outcome()));
            let asks = self.operators.iter_mut().enumerate();
            let mut asks = asks.filter(|(k, _)| *k as u64 + 1 == reply.id >> 32);
            let is_heard = asks
                .next()
                .is_some_and(|(_, operator)| operator.hear(reply));
            self.judge.check(is_heard, || {
                format!("replies: one that nobody waits for: {reply:?}")
            });
        }
        for operator in &self.operators {
            let since_ns = operator.waits_since_ns().unwrap_or(u64::MAX);
            let woken_ns = cycle.woken_ns;
            self.judge.check(since_ns >= woken_ns, || {
                let waits_us = (woken_ns - since_ns) / 1000;
                format!("replies: none in a cycle that began {waits_us} us after the request")
            });
        }
    }

    fn acknowledge_stop(&mut self, command: &TwistCommand) {
        let Some(domain) = &mut self.domain else {
            return;
        };
        let was_confirmed = domain.is_confirmed();
        domain.acknowledge();
        let is_new = domain.is_confirmed() && !was_confirmed;
        self.judge.check(!is_new || command.twist == [0.0; 6], || {
            "stop: confirmed before zero was sent".to_owned()
        });
    }

    /// The cycle ends: the daemon thinks, and sleeps until its next release, or ends.
    fn sleep(&mut self, mut cycle: Box<Cycle>) {
        let Some(mut daemon) = self.daemon.take() else {
            return;
        };
        daemon.finish(&mut cycle, self.now_ns);
        self.cycles += 1;
        self.recorder.cycle(&cycle);
        self.recorder.state(&daemon, self.now_ns);
        if self.shutdown && daemon.is_over() {
            let command = daemon.last_word(self.now_ns);
            self.robot.obey(&command);
            self.newest = Some(command);
            self.judge.last_word(&command);
            self.ended(daemon);
            return;
        }
        daemon.rehearse();
        let (count, late_ns) = self.late;
        let late_ns = if count > 0 { late_ns } else { 0 };
        self.late.0 = count.saturating_sub(1);
        let wake_ns = daemon.release_ns() + self.between(20_000, 120_000) + late_ns;
        self.daemon = Some(daemon);
        let wake_ns = wake_ns.max(self.now_ns);
        self.queue.at(wake_ns, Event::Wake(self.process));
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
