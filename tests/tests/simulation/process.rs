//! A process of the daemon: the real loop ([`controller::cycle::Cycle`]) in this world. Each of its
//! calls takes a little time, in which everything else goes on; it hangs, and is killed, in any of
//! them.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use controller::cycle::{Cycle, Pace};
use controller::shutdown::Stop;
use controller::usage::Usage;
use decision::presence::{Note, Presence};
use decision::{ControlStep, Input, Inputs};
use messages::{
    CycleRecord, DesiredTwist, Features, Hold, RealTime, Reply, Request, RobotState, TwistCommand,
    TwistState,
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use vpc::Strategy;

use crate::dice;
use crate::operator::Operator;
use crate::promise::Promise;
use crate::property::Seen;
use crate::world::World;

/// From the expected features to the cycle's begin with clock `phase`, ns.
const MARGIN_NS: u64 = 1_000_000;

/// What ends a process in the middle of a call: it was killed, or the run is over.
struct Killed;

/// A command was not sent.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("not sent")]
pub struct Unsent;

/// The daemon's end of the world.
struct Process<'w, 's> {
    world: &'w mut World<'s>,
    number: u64,
    random: ChaCha8Rng,
    /// What it has received and sent in this cycle.
    seen: Seen,
    /// How far its clock is back, ns.
    back_ns: u64,
    sent: u64,
}

impl World<'_> {
    /// A new process, after what the one before has left, until it ends.
    pub fn run_process(&mut self) {
        self.process += 1;
        (self.is_at_work, self.hung_until_ns) = (true, 0);
        let again = self.again.take();
        self.id += u64::from(again.is_none());
        let mut presence = Presence::claim(self.id, self.note.replace(self.id));
        if let Some(domain) = &mut self.domain {
            domain.open_again();
        }
        let (scene, settings) = (self.scene, self.plan.settings);
        let (rules, memory) = (self.plan.rules(scene), self.plan.memory());
        let mut control = ControlStep::new(scene, settings, memory, rules).unwrap();
        control.name_vetoes(self.names());
        if let Some(veto) = again {
            control.begin_again(veto);
            presence.follow();
        }
        if presence.unclean.is_some() {
            control.begin_disarmed(Hold::Unclean);
        }
        self.tell(|| format!("vpcd starts: {presence:?}, {again:?}"));
        let is_armed = rules.begins_armed && again.is_none();
        let has_goal = settings.strategy != Strategy::Follow;
        self.judge.begin(rules, is_armed, has_goal, self.now_ns);
        self.recorder.begin(scene, &control, self.now_ns);
        (self.stop, self.is_again) = (Stop::default(), false);
        let stop = self.stop.clone();
        let pace = Pace {
            clock: self.plan.clock,
            period_ns: self.plan.period_ns,
            margin_ns: MARGIN_NS,
            realtime: RealTime::default(),
        };
        let process = Process {
            number: self.process,
            random: dice(self.plan.seed, 1000 + self.process),
            seen: Seen::default(),
            back_ns: 0,
            sent: 0,
            world: self,
        };
        let run = AssertUnwindSafe(|| {
            let mut cycle = Cycle::new(pace, process, control);
            let sent = cycle.turn(&stop, None, || ());
            let last_word = cycle.stop();
            (sent.and(last_word), cycle.has_consent(), cycle.veto())
        });
        match catch_unwind(run) {
            Ok((sent, has_consent, veto)) => {
                // As one that fails.
                self.is_again &= sent.is_ok();
                presence.has_consent = has_consent;
                presence.is_followed = self.is_again;
                self.note = match presence.leave() {
                    Note::Us => Some(self.id),
                    Note::Before(process) => Some(*process),
                    Note::Empty => None,
                };
                self.ended(veto);
            }
            Err(payload) if payload.is::<Killed>() => (),
            Err(payload) => {
                let words = payload.downcast_ref::<String>().cloned();
                let words = words.or_else(|| payload.downcast_ref().map(|s: &&str| s.to_string()));
                self.judge.fail(Promise::Panic, || format!("{words:?}"));
            }
        }
    }

    /// The secret seed of the names of vetoes, of the process at work.
    pub fn names(&self) -> u64 {
        self.plan.seed << 32 | self.process
    }

    /// The process is gone, whatever it was about to do.
    pub fn kill(&mut self) {
        self.tell(|| "vpcd is killed".to_owned());
        self.process += 1;
        self.is_at_work = false;
        self.operators.iter_mut().for_each(Operator::forget);
        self.judge.killed();
    }
}

impl Process<'_, '_> {
    /// A call takes so long, ns.
    fn spend(&mut self, least_ns: u64, most_ns: u64) {
        let takes_ns = self.random.random_range(least_ns..most_ns);
        self.pass(self.world.now_ns + takes_ns);
    }

    /// Everything until then happens, and until it goes on where it hangs.
    fn pass(&mut self, until_ns: u64) {
        self.world.pass(until_ns);
        while self.is_alive() && self.world.now_ns < self.world.hung_until_ns {
            self.world.pass(self.world.hung_until_ns);
        }
        if !self.is_alive() {
            resume_unwind(Box::new(Killed));
        }
    }

    fn is_alive(&self) -> bool {
        self.world.process == self.number && !self.world.is_over()
    }
}

impl controller::world::World for Process<'_, '_> {
    type Unsent = Unsent;

    fn now_ns(&mut self) -> u64 {
        self.spend(500, 15_000);
        let now_ns = self.world.now_ns - self.back_ns;
        self.seen.read_clock(now_ns);
        now_ns
    }

    fn suspended_ns(&mut self) -> u64 {
        self.world.suspended_ns
    }

    fn usage(&mut self) -> Usage {
        Usage::default()
    }

    fn sleep_until(&mut self, deadline_ns: u64) {
        let mut wakes_ns =
            deadline_ns.max(self.world.now_ns) + self.random.random_range(20_000..120_000);
        let (count, late_ns) = self.world.late;
        if count > 0 && deadline_ns > self.world.now_ns {
            self.world.late.0 -= 1;
            wakes_ns += late_ns;
        }
        self.pass(wakes_ns);
        self.back_ns = self.back_ns.max(std::mem::take(&mut self.world.back_ns));
    }

    fn yield_now(&mut self) {
        self.spend(1_000, 100_000);
    }

    fn features(&mut self) -> Input<Features> {
        self.spend(500, 5_000);
        std::mem::replace(&mut self.world.inbox.features, Input::Nothing)
    }

    fn robot(&mut self) -> Input<RobotState> {
        std::mem::replace(&mut self.world.inbox.robot, Input::Nothing)
    }

    fn desired(&mut self) -> Input<DesiredTwist> {
        std::mem::replace(&mut self.world.inbox.desired, Input::Nothing)
    }

    fn request(&mut self) -> Input<Request> {
        let operators = &mut self.world.operators;
        let waiting = operators.iter().filter(|one| one.waits()).count();
        if waiting == 0 {
            return Input::Nothing;
        }
        let any = self.random.random_range(0..waiting);
        let mut waiting = operators.iter_mut().filter(|one| one.waits());
        let Some(request) = waiting.nth(any).and_then(Operator::oldest) else {
            return Input::Nothing;
        };
        self.seen.take(request);
        Input::Message(request)
    }

    fn is_stop_asked(&mut self) -> bool {
        let is_asked = self.world.domain.as_mut().is_some_and(|one| one.is_asked());
        if is_asked {
            self.seen.take_file();
        }
        is_asked
    }

    fn obey_stop(&mut self) {
        self.spend(500, 30_000);
        let is_zero = self
            .seen
            .command
            .is_some_and(|command| command.twist == [0.0; 6]);
        if let Some(domain) = &mut self.world.domain {
            let was_confirmed = domain.is_confirmed();
            domain.acknowledge();
            let is_new = domain.is_confirmed() && !was_confirmed;
            self.world
                .judge
                .check(Promise::Stop, !is_new || is_zero, || {
                    "confirmed before zero was sent".to_owned()
                });
        }
    }

    fn send(&mut self, command: &TwistCommand) -> Result<(), Unsent> {
        // The decision took its time.
        self.spend(10_000, 300_000);
        self.back_ns = 0;
        if command.state() == Some(TwistState::Stopped) {
            self.world.judge.last_word(command);
        }
        self.seen.sent_ns = self.world.now_ns;
        if self.world.unsent > 0 {
            self.world.unsent -= 1;
            return Err(Unsent);
        }
        let mut command = *command;
        self.sent += 1;
        command.stamp.sequence = self.sent;
        command.stamp.published_ns = self.world.now_ns;
        self.seen.command = Some(command);
        self.world.send_twist(&command);
        Ok(())
    }

    fn reply(&mut self, reply: &Reply) {
        self.spend(500, 5_000);
        let mut reply = *reply;
        (reply.stamp.sequence, reply.stamp.published_ns) = (1, self.world.now_ns);
        self.seen.answer(&reply);
        self.world.send_reply(&reply);
    }

    fn dump(&mut self) {}

    fn keep(&mut self, record: &mut CycleRecord, inputs: &Inputs, control: &ControlStep) {
        let seen = std::mem::take(&mut self.seen);
        self.world.cycle(record, inputs, &seen, control);
        self.world.recorder.cycle(record, inputs, &seen, control);
        // What it thinks.
        self.spend(20_000, 1_000_000);
    }

    fn is_unheard(&self) -> bool {
        false
    }
}
