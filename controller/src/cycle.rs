//! The loop: Wake -> Receive -> Step -> Send -> Slack. Nothing here allocates, logs, or waits without a bound.

use heapless::Vec;
use ipc::{
    ClockMode, ControllerPorts, CycleFlags, CycleRecord, PublishError, RealTime, ReceiveError,
    Reply, TwistCommand, TwistState, now_ns,
};

use crate::clock::{Grid, sleep_until};
use crate::flight::Tap;
use crate::gate::Input;
use crate::law::Law;
use crate::phase::Phase;
use crate::pilot::{Answer, Inputs, Pilot};
use crate::shutdown::Stop;
use crate::supervisor::Rules;
use crate::usage::Usage;

/// Rounds of polling in lockstep that only yield, before polling sleeps.
const YIELDS: u32 = 100;
/// Sleep between two polls in lockstep, ns.
const POLL_NS: u64 = 20_000;
/// Longest wait in lockstep before the stop flag is looked at, ns.
const WAIT_NS: u64 = 5_000_000;

/// Most requests of operators taken in a cycle: as many as wait in the queue.
pub const REQUESTS: usize = 16;

/// How the loop runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// What starts a cycle.
    pub clock: ClockMode,
    /// The period of the fixed clock, ns; lockstep does not look at it.
    pub period_ns: u64,
    /// Periods for which a command may stand without news.
    pub stale_periods: f64,
    /// What the supervisor goes by.
    pub rules: Rules,
    /// Clock `phase`: how far after the expected arrival of features a cycle begins, ns.
    pub margin_ns: u64,
    /// How real the thread's real time is. Under SCHED_FIFO polling only sleeps.
    pub realtime: RealTime,
}

impl Pace {
    /// The pilot of such a loop before its first cycle.
    pub fn pilot(&self, mut law: Law) -> Pilot {
        let stale_ns = match self.clock {
            // Looked at once a period: what would be too old at the next release is too old now.
            ClockMode::Fixed | ClockMode::Phase => {
                Some(stale_ns(self).saturating_sub(self.period_ns))
            }
            ClockMode::Lockstep => None,
        };
        if stale_ns.is_some() {
            law.go_live(self::stale_ns(self));
        }
        Pilot::new(law, stale_ns, self.rules)
    }
}

/// The loop with all it owns. It shares nothing with other threads but the tap of flight records.
pub struct Cycle {
    pace: Pace,
    ports: ControllerPorts,
    pilot: Pilot,
    grid: Grid,
    /// What moves the grid, in the clock `phase`.
    phase: Option<Phase>,
    tap: Tap,
    /// What stays the same in each record.
    blank: CycleRecord,
    count: u64,
    /// Releases missed until the last cycle.
    missed: u64,
    /// Requests taken since the last cycle.
    requests: u32,
    replies: Vec<Reply, REQUESTS>,
    /// The thread's counters when it woke up.
    woken: Usage,
}

impl Cycle {
    /// A loop that starts now.
    pub fn new(pace: Pace, ports: ControllerPorts, law: Law, mut tap: Tap) -> Self {
        let blank = CycleRecord {
            clock: pace.clock.code(),
            realtime: pace.realtime.0,
            ..CycleRecord::default()
        };
        let pilot = pace.pilot(law);
        tap.begin(&pilot);
        Self {
            pace,
            ports,
            pilot,
            grid: Grid::new(now_ns(), pace.period_ns),
            phase: (pace.clock == ClockMode::Phase)
                .then(|| Phase::new(pace.period_ns, pace.margin_ns)),
            tap,
            blank,
            count: 0,
            missed: 0,
            requests: 0,
            replies: Vec::new(),
            woken: Usage::now(),
        }
    }

    /// Cycles so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Whether the last twist was zero.
    pub fn is_at_rest(&self) -> bool {
        self.pilot.is_at_rest()
    }

    /// Whether nobody takes the records any more: the ordinary thread is gone.
    pub fn is_unheard(&self) -> bool {
        self.tap.is_unheard()
    }

    /// One cycle; once `stop` is asked for it brakes. In lockstep `Ok(None)` where no message came within a few
    /// milliseconds.
    ///
    /// # Errors
    /// [`PublishError`] where the command could not be sent; the camera then stops by its validity.
    pub fn run(&mut self, stop: &Stop) -> Result<Option<CycleRecord>, PublishError> {
        let mut record = self.blank;
        // Wake, Receive.
        let (woken_ns, features) = match self.pace.clock {
            ClockMode::Fixed | ClockMode::Phase => self.release(&mut record),
            ClockMode::Lockstep => match self.poll() {
                Some(found) => found,
                None => {
                    self.take_requests();
                    self.reply();
                    return Ok(None);
                }
            },
        };
        let robot = self.ports.robot.latest().into();
        self.take_requests();
        let received_ns = now_ns();
        // Step.
        let inputs = Inputs {
            now_ns: received_ns,
            features,
            robot,
            missed: self.grid.missed() - self.missed,
            shutdown: stop.is_asked(),
        };
        self.missed = self.grid.missed();
        let answer = self.pilot.decide(&inputs, &mut record);
        let stepped_ns = now_ns();
        // Send.
        let sent = self.send(&answer);
        let sent_ns = now_ns();
        if sent.is_err() {
            self.pilot.unsent();
        }
        self.woken.tell(&mut record);
        // Slack.
        self.reply();
        self.count += 1;
        record.cycle = self.count;
        self.tell_inputs(&inputs, &mut record);
        if sent.is_ok() {
            record.flags |= CycleFlags::SENT.0;
        }
        record.stamp.data_ns = woken_ns;
        record.receive_ns = received_ns.saturating_sub(woken_ns);
        record.step_ns = stepped_ns.saturating_sub(received_ns);
        record.send_ns = sent_ns.saturating_sub(stepped_ns);
        record.features_age_ns = match answer.stamp.sequence {
            0 => 0,
            _ => self
                .pilot
                .effective_ns(&answer.stamp, woken_ns)
                .saturating_sub(answer.stamp.data_ns),
        };
        if self.pace.clock != ClockMode::Lockstep {
            self.advance(&mut record);
        }
        record.overruns = self.grid.missed();
        record.lost_records = self.tap.lost();
        self.tap
            .cycle(inputs, answer, sent.is_ok(), &record, &self.pilot);
        sent.map(|()| Some(record))
    }

    /// Notes what the cycle received.
    fn tell_inputs(&mut self, inputs: &Inputs, record: &mut CycleRecord) {
        let (features, robot) = (inputs.features.seen(), inputs.robot.seen());
        (record.features_input, record.features_seen) = (features.0.code(), features.1);
        (record.robot_input, record.robot_seen) = (robot.0.code(), robot.1);
        record.requests = core::mem::take(&mut self.requests);
        record.missed = u32::try_from(inputs.missed).unwrap_or(u32::MAX);
        if inputs.shutdown {
            record.flags |= CycleFlags::SHUTDOWN.0;
        }
    }

    /// Most cycles that braking from the limits to zero takes, and one to begin with; none in lockstep.
    pub fn braking_cycles(&self) -> u64 {
        match self.pace.clock {
            ClockMode::Fixed | ClockMode::Phase => {
                self.pace.rules.brake_ns.div_ceil(self.pace.period_ns) + 1
            }
            ClockMode::Lockstep => 0,
        }
    }

    /// Sends the zero twist that ends a run, whatever came before.
    ///
    /// # Errors
    /// [`PublishError`] where it could not be sent.
    pub fn stop(&mut self) -> Result<(), PublishError> {
        let command = TwistCommand::zero(TwistState::Stopped);
        self.ports.twist.publish(&command).map(|_| ())
    }

    /// Fixed clock: waits for the next release, and takes the latest message.
    fn release(&mut self, record: &mut CycleRecord) -> (u64, Input) {
        let release_ns = self.grid.next_ns();
        sleep_until(release_ns);
        let woken_ns = now_ns();
        self.woken = Usage::now();
        record.wake_latency_ns = woken_ns.saturating_sub(release_ns);
        let features = self.ports.features.latest().into();
        if let (Some(phase), Input::Message(received)) = (&mut self.phase, &features) {
            phase.hear(&received.message.stamp, woken_ns);
        }
        (woken_ns, features)
    }

    /// Moves the grid on to the next release.
    fn advance(&mut self, record: &mut CycleRecord) {
        let Some(phase) = &mut self.phase else {
            self.grid.advance(now_ns());
            return;
        };
        let interval_ns = phase.interval_ns(self.grid.next_ns());
        let (code, error_ns) = phase.standing();
        (record.phase, record.phase_error_ns) = (code.code(), error_ns);
        self.grid.advance_by(interval_ns, now_ns());
    }

    /// Lockstep: polls for a message. A repeated one was answered already.
    fn poll(&mut self) -> Option<(u64, Input)> {
        let end_ns = now_ns() + WAIT_NS;
        let is_fifo =
            self.pace.realtime.has(RealTime::ASKED) && !self.pace.realtime.has(RealTime::NO_FIFO);
        let mut polls = if is_fifo { YIELDS } else { 0 };
        loop {
            let woken_ns = now_ns();
            self.woken = Usage::now();
            match self.ports.features.latest().into() {
                Input::Nothing => (),
                Input::Message(received) if received.order == ipc::Order::Repeated => (),
                input => return Some((woken_ns, input)),
            }
            if woken_ns >= end_ns {
                return None;
            }
            if polls < YIELDS {
                polls += 1;
                std::thread::yield_now();
            } else {
                sleep_until(now_ns() + POLL_NS);
            }
        }
    }

    /// Hands the requests of operators to the pilot. Those without a head are passed over here; the recorder, which
    /// reads along, logs them.
    fn take_requests(&mut self) {
        for _ in 0..REQUESTS {
            match self.ports.requests.oldest() {
                Ok(Some(request)) => {
                    let mut reply = self.pilot.request(&request);
                    reply.cycle = self.count + 1;
                    self.requests += 1;
                    self.tap.ask(&request, &mut reply);
                    // There is room for as many as this loop takes.
                    let _ = self.replies.push(reply);
                }
                Ok(None) | Err(ReceiveError::Transport { .. }) => break,
                Err(ReceiveError::Invalid { .. }) => (),
            }
        }
    }

    /// Answers the requests. An answer that cannot be sent is missed by the operator, who asks again.
    fn reply(&mut self) {
        for reply in &self.replies {
            let _ = self.ports.replies.publish(reply);
        }
        self.replies.clear();
    }

    fn send(&mut self, answer: &Answer) -> Result<(), PublishError> {
        let decision = &answer.decision;
        let command = TwistCommand::answer_to(&answer.stamp, decision.twist, decision.state);
        let command = match self.pace.clock {
            ClockMode::Fixed | ClockMode::Phase => command.valid_for_ns(stale_ns(&self.pace)),
            ClockMode::Lockstep => command,
        };
        self.ports.twist.publish(&command).map(|_| ())
    }
}

/// Age from which on features and commands are stale, ns.
fn stale_ns(pace: &Pace) -> u64 {
    (pace.stale_periods * pace.period_ns as f64) as u64
}
