//! The loop: wake, receive, decide, send, slack, rehearse. Nothing here allocates, logs, or waits
//! without a bound. What it meets outside is a [`World`].

use decision::{Answer, ControlStep, Input, Inputs};
use heapless::Vec;
use messages::{
    Action, ClockMode, CycleFlags, CycleRecord, FUTURE_NS, Features, Outcome, RealTime, Reply,
    Request, TwistCommand, TwistState,
};

use crate::clock::Grid;
use crate::pll::CameraPll;
use crate::shutdown::Stop;
use crate::usage::Usage;
use crate::world::World;

/// How long before its release a cycle is rehearsed, ns: several times what a decision takes, and
/// so short that no other thread uses the caches in between.
const REHEARSAL_NS: u64 = 300_000;
/// Time in lockstep for which polling only yields, before it sleeps, ns.
const YIELD_NS: u64 = 150_000;
/// Shortest sleep between two polls in lockstep, ns.
const POLL_NS: u64 = 20_000;
/// Longest wait in lockstep before the stop flag is checked, and longest sleep, ns.
const WAIT_NS: u64 = 5_000_000;

/// Growth of the time suspended that is no error of its measurement, ns.
const SUSPENDED_NS: u64 = 1_000_000;
/// Commands in a row that may fail to be sent: a broken segment stays broken.
pub const MOST_FAILURES: u32 = 30;
/// Answers to all requests of a cycle and to the stop file.
const REPLIES: usize = Request::PER_CYCLE + 1;

/// How the loop runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// What starts a cycle.
    pub clock: ClockMode,
    /// The period of the fixed clock, ns; unused in lockstep.
    pub period_ns: u64,
    /// Clock `phase`: how far after the expected arrival of features a cycle begins, ns.
    pub margin_ns: u64,
    /// The real-time properties that the thread has. Under SCHED_FIFO polling only sleeps.
    pub realtime: RealTime,
}

/// Sleep before the next poll in lockstep, after so long a wait, ns: an eighth of it, so that a
/// camera waits little longer for the answer than the answer for its frame.
fn pause_ns(waited_ns: u64) -> u64 {
    (waited_ns / 8).clamp(POLL_NS, WAIT_NS)
}

/// Whether a request that leads to motion has waited for too long, in a loop that hung perhaps, or
/// is from the future. Those that end it are never late.
pub fn is_late(request: &Request, now_ns: u64) -> bool {
    let asked_ns = request.stamp.published_ns;
    let is_in_time =
        asked_ns <= now_ns + FUTURE_NS && now_ns <= asked_ns.saturating_add(Request::LATE_NS);
    let leads_to_motion = matches!(request.action(), Some(Action::Arm | Action::Strategy));
    leads_to_motion && !is_in_time
}

/// The loop in its world.
pub struct Cycle<'m, W> {
    world: W,
    pace: Pace,
    /// Whether it asked for a stop that is not acknowledged yet.
    is_stopping: bool,
    control: ControlStep<'m>,
    grid: Grid,
    /// Moves the grid, in the clock `phase`.
    pll: Option<CameraPll>,
    /// What stays the same in each record.
    blank: CycleRecord,
    count: u64,
    /// Releases missed until the last cycle.
    missed: u64,
    /// How long the machine was suspended until the last cycle, ns.
    suspended_ns: u64,
    /// Requests taken since the last cycle.
    requests: u32,
    replies: Vec<Reply, REPLIES>,
    /// The thread's counters when it woke up.
    woken: Usage,
    /// Lockstep: since when it waits for a message, ns.
    waits_since_ns: Option<u64>,
}

impl<'m, W: World> Cycle<'m, W> {
    /// A loop that starts now.
    pub fn new(pace: Pace, mut world: W, control: ControlStep<'m>) -> Self {
        let is_phase = pace.clock == ClockMode::Phase;
        Self {
            is_stopping: false,
            control,
            grid: Grid::new(world.now_ns(), pace.period_ns),
            pll: is_phase.then(|| CameraPll::new(pace.period_ns, pace.margin_ns)),
            blank: CycleRecord {
                clock: pace.clock.code(),
                realtime: pace.realtime.0,
                ..CycleRecord::default()
            },
            count: 0,
            missed: 0,
            suspended_ns: world.suspended_ns(),
            requests: 0,
            replies: Vec::new(),
            woken: Usage::default(),
            waits_since_ns: None,
            pace,
            world,
        }
    }

    /// Cycles so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The name of the last operator's stop or disarm since it was last armed; 0: none.
    pub fn veto(&self) -> u32 {
        self.control.veto()
    }

    /// Whether an operator has armed it.
    pub fn has_consent(&self) -> bool {
        self.control.has_consent()
    }

    /// Whether the last twist was zero.
    pub fn is_at_rest(&self) -> bool {
        self.control.is_at_rest()
    }

    /// Runs cycles until `stop` is asked for, or until there were `most`, and then until the camera
    /// stands; in lockstep, where nothing moves between messages, no longer. Calls `advance` after
    /// each.
    ///
    /// # Errors
    /// [`World::Unsent`] of the last of [`MOST_FAILURES`] commands in a row that could not be sent.
    pub fn turn(
        &mut self,
        stop: &Stop,
        most: Option<u64>,
        advance: impl Fn(),
    ) -> Result<(), W::Unsent> {
        let mut failures = 0;
        let mut left = self.braking_cycles();
        loop {
            let is_over = most.is_some_and(|most| self.count >= most);
            // Without telemetry, log and watchdog the camera would move unobserved.
            if is_over || self.world.is_unheard() {
                stop.ask();
            }
            if stop.is_asked() {
                if left == 0 || self.is_at_rest() {
                    return Ok(());
                }
                left -= 1;
            }
            match self.run(stop) {
                Ok(_) => {
                    failures = 0;
                    advance();
                }
                Err(source) => {
                    failures += 1;
                    if failures >= MOST_FAILURES {
                        return Err(source);
                    }
                }
            }
        }
    }

    /// One cycle; once `stop` is asked for it brakes. In lockstep `Ok(None)` if no message came
    /// within a few milliseconds.
    ///
    /// # Errors
    /// The command could not be sent; the camera then stops by its validity.
    pub fn run(&mut self, stop: &Stop) -> Result<Option<CycleRecord>, W::Unsent> {
        let mut record = self.blank;
        let Some((woken_ns, features)) = self.wake(&mut record) else {
            self.take_requests();
            self.reply();
            self.acknowledge_stop();
            return Ok(None);
        };
        let inputs = self.receive(features, stop);
        let answer = self.control.decide(&inputs, &mut record);
        let decided_ns = self.world.now_ns();
        self.control.sent_at(decided_ns);
        let sent = self.send(&answer, &mut record);
        record.stamp.data_ns = woken_ns;
        record.receive_ns = inputs.now_ns.saturating_sub(woken_ns);
        record.step_ns = decided_ns.saturating_sub(inputs.now_ns);
        record.send_ns = self.world.now_ns().saturating_sub(decided_ns);
        let usage = self.world.usage();
        usage.record_since(&self.woken, &mut record);
        self.reply();
        if sent.is_ok() {
            self.acknowledge_stop();
        }
        self.control.think();
        self.finish(&inputs, &answer, &mut record);
        sent.map(|()| Some(record))
    }

    /// Most cycles that braking from the limits to zero takes, and one to begin with; none in
    /// lockstep.
    fn braking_cycles(&self) -> u64 {
        if self.pace.clock == ClockMode::Lockstep {
            return 0;
        }
        let rules = self.control.rules();
        let by_time = rules.brake_ns.div_ceil(self.pace.period_ns);
        by_time.max(rules.stop_cycles(&rules.limits).ceil() as u64) + 1
    }

    /// Sends the zero twist that ends a run, whatever came before.
    ///
    /// # Errors
    /// It could not be sent.
    pub fn stop(&mut self) -> Result<(), W::Unsent> {
        self.world.send(&TwistCommand::zero(TwistState::Stopped))
    }

    /// Waits for the beginning of a cycle: when it was, and the features that are there.
    fn wake(&mut self, record: &mut CycleRecord) -> Option<(u64, Input<Features>)> {
        match self.pace.clock {
            ClockMode::Fixed | ClockMode::Phase => Some(self.wait_for_release(record)),
            ClockMode::Lockstep => self.poll(),
        }
    }

    /// Waits for the next release, rehearses the cycle just before it, and takes the latest
    /// message.
    fn wait_for_release(&mut self, record: &mut CycleRecord) -> (u64, Input<Features>) {
        let release_ns = self.grid.next_ns();
        let rehearsal_ns = release_ns.saturating_sub(REHEARSAL_NS);
        if self.world.now_ns() < rehearsal_ns {
            self.world.sleep_until(rehearsal_ns);
            self.control.rehearse(release_ns);
        }
        self.world.sleep_until(release_ns);
        let woken_ns = self.world.now_ns();
        self.woken = self.world.usage();
        record.wake_latency_ns = woken_ns.saturating_sub(release_ns);
        let features = self.world.features();
        if let (Some(pll), Input::Message(message)) = (&mut self.pll, &features) {
            pll.hear(&message.stamp, woken_ns);
        }
        (woken_ns, features)
    }

    /// Lockstep: polls for a message, the less often the longer none comes.
    fn poll(&mut self) -> Option<(u64, Input<Features>)> {
        let begin_ns = self.world.now_ns();
        let since_ns = *self.waits_since_ns.get_or_insert(begin_ns);
        let is_fifo =
            self.pace.realtime.has(RealTime::ASKED) && !self.pace.realtime.has(RealTime::NO_FIFO);
        loop {
            let woken_ns = self.world.now_ns();
            self.woken = self.world.usage();
            match self.world.features() {
                Input::Nothing => (),
                features => {
                    self.waits_since_ns = None;
                    return Some((woken_ns, features));
                }
            }
            if woken_ns >= begin_ns + WAIT_NS {
                return None;
            }
            let waited_ns = woken_ns - since_ns;
            if waited_ns < YIELD_NS && !is_fifo {
                self.world.yield_now();
            } else {
                self.world.sleep_until(woken_ns + pause_ns(waited_ns));
            }
        }
    }

    /// Takes what came from robot and operators, and the time for which the cycle decides.
    fn receive(&mut self, features: Input<Features>, stop: &Stop) -> Inputs {
        let robot = self.world.robot();
        let desired = self.world.desired();
        self.take_requests();
        let missed = self.grid.missed() - self.missed;
        self.missed = self.grid.missed();
        let suspended_ns = self.world.suspended_ns().max(self.suspended_ns);
        let slept_ns = suspended_ns - self.suspended_ns;
        self.suspended_ns = suspended_ns;
        Inputs {
            now_ns: self.world.now_ns(),
            features,
            robot,
            desired,
            missed: u32::try_from(missed).unwrap_or(u32::MAX),
            suspended: slept_ns > SUSPENDED_NS,
            shutdown: stop.is_asked(),
        }
    }

    /// Passes the requests of operators to the control step, and that of the stop file after them,
    /// so that it wins. Those without a head are skipped here; the ordinary thread, which also
    /// receives them, logs them.
    fn take_requests(&mut self) {
        for _ in 0..Request::PER_CYCLE {
            match self.world.request() {
                Input::Message(request) => {
                    let outcome = self.answer(&request);
                    if outcome == Some(Outcome::Done) && request.action() == Some(Action::Record) {
                        self.world.dump();
                    }
                }
                Input::Nothing | Input::Failed => break,
                Input::Refused(_) => (),
            }
        }
        if self.world.is_stop_asked() {
            self.answer(&Request::new(Request::STOP_FILE, Action::Stop));
            self.is_stopping = true;
        }
    }

    fn answer(&mut self, request: &Request) -> Option<Outcome> {
        let cycle = self.count + 1;
        let reply = match is_late(request, self.world.now_ns()) {
            true => self.control.reply(request, cycle, Outcome::Late),
            false => self.control.request(request, cycle),
        };
        let outcome = reply.outcome();
        self.requests = self.requests.saturating_add(1);
        // There is room for as many as this loop takes.
        let _ = self.replies.push(reply);
        outcome
    }

    /// Acknowledges a stop by the file: the zero twist is sent.
    fn acknowledge_stop(&mut self) {
        if std::mem::take(&mut self.is_stopping) {
            self.world.obey_stop();
        }
    }

    fn send(&mut self, answer: &Answer, record: &mut CycleRecord) -> Result<(), W::Unsent> {
        let decision = &answer.decision;
        let command = TwistCommand::answer_to(&answer.stamp, decision.twist, decision.state)
            .with_elbow(decision.elbow);
        let command = match self.control.rules().valid_ns {
            Some(valid_ns) => command.valid_until(self.world.now_ns().saturating_add(valid_ns)),
            None => command,
        };
        let sent = self.world.send(&command);
        match sent {
            Ok(()) => record.flags |= CycleFlags::SENT.0,
            Err(_) => self.control.unsent(),
        }
        sent
    }

    /// Answers the requests.
    fn reply(&mut self) {
        for reply in &self.replies {
            self.world.reply(reply);
        }
        self.replies.clear();
    }

    /// Ends a cycle: moves the grid on to the next release, and leaves the record.
    fn finish(&mut self, inputs: &Inputs, answer: &Answer, record: &mut CycleRecord) {
        self.count += 1;
        record.cycle = self.count;
        record.requests = std::mem::take(&mut self.requests);
        record.features_age_ns = match answer.stamp.sequence {
            0 => 0,
            _ => self
                .control
                .effective_ns(&answer.stamp, record.stamp.data_ns)
                .saturating_sub(answer.stamp.data_ns),
        };
        if self.pace.clock != ClockMode::Lockstep {
            self.advance(record);
        }
        record.overruns = self.grid.missed();
        self.world.keep(record, inputs, &self.control);
    }

    /// Moves the grid on to the next release.
    fn advance(&mut self, record: &mut CycleRecord) {
        let now_ns = self.world.now_ns();
        let Some(pll) = &mut self.pll else {
            self.grid.advance(now_ns);
            return;
        };
        let interval_ns = pll.interval_ns(self.grid.next_ns());
        let (code, error_ns) = pll.standing();
        (record.phase, record.phase_error_ns) = (code.code(), error_ns);
        self.grid.advance_by(interval_ns, now_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lockstep_polls_a_fast_camera_often_and_a_silent_one_seldom() {
        assert_eq!(pause_ns(0), 20_000);
        assert_eq!(pause_ns(8_000_000), 1_000_000);
        assert_eq!(pause_ns(3_600_000_000_000), 5_000_000);
    }

    #[test]
    fn only_what_moves_the_camera_can_be_late() {
        const NOW: u64 = 5_000_000_000;
        let asked = |action, published_ns| {
            let mut request = Request::new(7, action);
            request.stamp.published_ns = published_ns;
            is_late(&request, NOW)
        };
        for action in [Action::Arm, Action::Strategy] {
            assert!(!asked(action, NOW) && !asked(action, NOW - Request::LATE_NS));
            assert!(asked(action, NOW - Request::LATE_NS - 1) && asked(action, 0));
            assert!(asked(action, NOW + 2 * FUTURE_NS) && asked(action, u64::MAX));
        }
        for action in [Action::Stop, Action::Disarm, Action::Status, Action::Record] {
            assert!(!asked(action, 0) && !asked(action, u64::MAX));
        }
    }
}
