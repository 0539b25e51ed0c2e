//! What `vpcd`'s loop does around the decision, on a clock that the world moves: the order of
//! `controller/src/cycle.rs`, with the real grid of releases, the real phase loop and the real
//! stop file. What it received is an argument; what it sends is a result.

use controller::clock::Grid;
use controller::cycle::is_late;
use controller::pll::CameraPll;
use decision::{Answer, ControlStep, Input, Inputs};
use messages::{
    ClockMode, CycleFlags, CycleRecord, DesiredTwist, Features, Hold, Outcome, Reply, Request,
    RobotState, TwistCommand, TwistState,
};

use crate::PERIOD_NS;
use crate::plan::Plan;

/// From the expected features to the cycle's begin with clock `phase`, ns.
const MARGIN_NS: u64 = 1_000_000;
/// Growth of the time suspended from which on the machine was suspended, ns.
const SUSPENDED_NS: u64 = 1_000_000;

/// What waits for the daemon: the newest message of each port.
pub struct Inbox {
    pub features: Input<Features>,
    pub robot: Input<RobotState>,
    pub desired: Input<DesiredTwist>,
}

impl Default for Inbox {
    fn default() -> Self {
        Self {
            features: Input::Nothing,
            robot: Input::Nothing,
            desired: Input::Nothing,
        }
    }
}

/// How a daemon begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Begin {
    /// As its configuration says.
    Configured,
    /// After one that was killed or crashed.
    Unclean,
    /// After one that was told to begin again: with its count of stops.
    Again(u32),
}

/// A cycle between waking and the next sleep.
#[derive(Clone)]
pub struct Cycle {
    pub woken_ns: u64,
    pub inputs: Inputs,
    pub answer: Answer,
    pub record: CycleRecord,
    /// The requests that it took, and the answers.
    pub replies: Vec<(Request, Reply)>,
}

/// The loop of one process.
pub struct Daemon<'m> {
    control: ControlStep<'m>,
    clock: ClockMode,
    grid: Grid,
    pll: Option<CameraPll>,
    rehearses: bool,
    count: u64,
    sent: u64,
    missed: u64,
    suspended_ns: u64,
    replies: Vec<(Request, Reply)>,
    /// Cycles that it may still brake once it is to end.
    left: u64,
}

impl<'m> Daemon<'m> {
    /// One that starts now.
    pub fn new(plan: &Plan<'m>, begin: Begin, now_ns: u64, suspended_ns: u64) -> Self {
        let rules = plan.rules();
        let memory = Some(plan.stock.memory());
        let mut control = ControlStep::new(plan.scene, plan.settings, memory, rules).unwrap();
        match begin {
            Begin::Configured => (),
            Begin::Unclean => control.begin_disarmed(Hold::Unclean),
            Begin::Again(stops) => control.begin_again(stops),
        }
        Self {
            control,
            clock: plan.clock,
            grid: Grid::new(now_ns, PERIOD_NS),
            pll: (plan.clock == ClockMode::Phase).then(|| CameraPll::new(PERIOD_NS, MARGIN_NS)),
            rehearses: plan.rehearses,
            count: 0,
            sent: 0,
            missed: 0,
            suspended_ns,
            replies: Vec::new(),
            left: plan.brake_ns() / PERIOD_NS + 1,
        }
    }

    /// Its decision.
    pub fn control(&self) -> &ControlStep<'m> {
        &self.control
    }

    /// Cycles so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The next release, ns.
    pub fn release_ns(&self) -> u64 {
        self.grid.next_ns()
    }

    /// Rehearses the next cycle shortly before its release.
    pub fn rehearse(&mut self) {
        if self.rehearses {
            self.control.rehearse(self.grid.next_ns());
        }
    }

    /// Takes a request; its answer is sent behind the command.
    pub fn take(&mut self, request: &Request, now_ns: u64) {
        let cycle = self.count + 1;
        let reply = match is_late(request, now_ns) {
            true => self.control.reply(request, cycle, Outcome::Late),
            false => self.control.request(request, cycle),
        };
        self.replies.push((*request, reply));
    }

    /// Wakes up with the features, which are taken first.
    pub fn hear(&mut self, features: &Input<Features>, woken_ns: u64) {
        if let (Some(pll), Input::Message(message)) = (&mut self.pll, features) {
            pll.hear(&message.stamp, woken_ns);
        }
    }

    /// Decides at `now_ns`, which is not before it woke up and took requests.
    pub fn decide(
        &mut self,
        inbox: Inbox,
        woken_ns: u64,
        now_ns: u64,
        suspended_ns: u64,
        shutdown: bool,
    ) -> Cycle {
        let missed = self.grid.missed() - self.missed;
        self.missed = self.grid.missed();
        let slept_ns = suspended_ns - self.suspended_ns;
        self.suspended_ns = suspended_ns;
        let inputs = Inputs {
            now_ns,
            features: inbox.features,
            robot: inbox.robot,
            desired: inbox.desired,
            missed: missed as u32,
            suspended: slept_ns > SUSPENDED_NS,
            shutdown,
        };
        let mut record = CycleRecord {
            clock: self.clock.code(),
            ..CycleRecord::default()
        };
        let answer = self.control.decide(&inputs, &mut record);
        record.stamp.data_ns = woken_ns;
        record.receive_ns = now_ns - woken_ns;
        Cycle {
            woken_ns,
            inputs,
            answer,
            record,
            replies: std::mem::take(&mut self.replies),
        }
    }

    /// The decision was made by `now_ns`.
    pub fn decided(&mut self, cycle: &mut Cycle, now_ns: u64) {
        self.control.sent_at(now_ns);
        cycle.record.step_ns = now_ns - cycle.inputs.now_ns;
    }

    /// The command that goes out at `now_ns`; `None` where it cannot be sent.
    pub fn send(&mut self, cycle: &mut Cycle, now_ns: u64, can_send: bool) -> Option<TwistCommand> {
        if !can_send {
            self.control.unsent();
            return None;
        }
        let decision = &cycle.answer.decision;
        let command = TwistCommand::answer_to(&cycle.answer.stamp, decision.twist, decision.state)
            .with_elbow(decision.elbow);
        let valid_ns = self.control.rules().valid_ns.unwrap();
        cycle.record.flags |= CycleFlags::SENT.0;
        Some(self.stamped(command.valid_until(now_ns + valid_ns), now_ns))
    }

    /// The last word of a process that ends in order.
    pub fn last_word(&mut self, now_ns: u64) -> TwistCommand {
        self.stamped(TwistCommand::zero(TwistState::Stopped), now_ns)
    }

    /// Thinks ahead, then moves the grid on to the next release after `now_ns`.
    pub fn finish(&mut self, cycle: &mut Cycle, now_ns: u64) {
        self.control.think();
        self.count += 1;
        cycle.record.cycle = self.count;
        cycle.record.requests = cycle.replies.len() as u32;
        match &mut self.pll {
            None => _ = self.grid.advance(now_ns),
            Some(pll) => {
                let interval_ns = pll.interval_ns(self.grid.next_ns());
                self.grid.advance_by(interval_ns, now_ns);
            }
        }
        cycle.record.overruns = self.grid.missed();
    }

    /// Whether a daemon that is to end has come to rest, or has braked for long enough.
    pub fn is_over(&mut self) -> bool {
        let is_over = self.left == 0 || self.control.is_at_rest();
        self.left = self.left.saturating_sub(1);
        is_over
    }

    fn stamped(&mut self, mut command: TwistCommand, now_ns: u64) -> TwistCommand {
        self.sent += 1;
        (command.stamp.sequence, command.stamp.published_ns) = (self.sent, now_ns);
        command
    }
}
