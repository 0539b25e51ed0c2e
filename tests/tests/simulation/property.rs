//! What must hold after every event, whatever happens: of each command, of each answer to an
//! operator, of each tick of the robot. The judge knows what the world knows, and nothing of the
//! decision but its commands and answers.

use decision::Rules;
use messages::{Action, FUTURE_NS, Hold, Outcome, Reply, Request, TwistCommand, TwistState};

use crate::PERIOD_NS;
use crate::daemon::Cycle;
use crate::fault::{BRAKE_NS, BRAKING_NS};

/// Relative rounding of a command.
const ROUNDING: f64 = 1e-9;
/// How long a robot obeys a command that none follows, ns.
const OBEYED_NS: u64 = 100_000_000;
/// How long a start that begins armed waits for camera and robot, ns.
const PEERS_NS: u64 = 5_000_000_000;
/// How long a request that leads to motion may wait, ns.
const LATE_NS: u64 = 300_000_000;

/// Whether anybody has allowed motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Consent {
    /// Nobody.
    None,
    /// An operator by `arm`, or the configuration.
    Given,
    /// An operator has taken it back by `disarm`: it may brake.
    Ending,
}

/// What the world knows of a cycle.
#[derive(Clone, Copy, Debug)]
pub struct Facts {
    /// When any message of the camera came last, ns.
    pub eyes_ns: u64,
    /// Whether the robot is at fault, the clock or a stamp is from the future, or the machine was
    /// suspended.
    pub is_grave: bool,
}

/// The judge of a run.
pub struct Judge {
    rules: Rules,
    begin_ns: u64,
    /// The last decision: its instant, and what it commanded.
    before: Option<(u64, TwistCommand)>,
    consent: Consent,
    /// Whether the configuration's consent waits for camera and robot.
    waits: bool,
    /// Stops so far, and whether one came since the last arming.
    stops: u32,
    is_stop_new: bool,
    /// When the oldest stop was asked that no zero has followed yet, ns.
    stop_asked_ns: Option<u64>,
    /// The greatest step of a component, as a share of its limit.
    pub steepest: f64,
    /// Longest time from asking a stop to zero, ns.
    pub stop_ns: u64,
    /// The first property that does not hold.
    pub broken: Option<String>,
}

impl Judge {
    /// One who has seen nothing.
    pub fn new(rules: Rules, now_ns: u64) -> Self {
        let mut judge = Self {
            rules,
            begin_ns: 0,
            before: None,
            consent: Consent::None,
            waits: false,
            stops: 0,
            is_stop_new: false,
            stop_asked_ns: None,
            steepest: 0.0,
            stop_ns: 0,
            broken: None,
        };
        judge.begin(rules.begins_armed, now_ns);
        judge
    }

    /// A property does not hold.
    pub fn fail(&mut self, what: impl FnOnce() -> String) {
        if self.broken.is_none() {
            self.broken = Some(what());
        }
    }

    /// Fails unless `holds`.
    pub fn check(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.fail(what);
        }
    }

    fn begin(&mut self, is_armed: bool, now_ns: u64) {
        self.begin_ns = now_ns;
        self.before = None;
        self.waits = is_armed;
        self.consent = if is_armed {
            Consent::Given
        } else {
            Consent::None
        };
    }

    /// The process was killed: whatever the configuration says, the next one may not move.
    pub fn killed(&mut self) {
        self.begin(false, 0);
        (self.stops, self.is_stop_new, self.stop_asked_ns) = (0, false, None);
    }

    /// The process begins again: an operator's stop is not forgotten.
    pub fn begins_again(&mut self) {
        self.begin(false, 0);
    }

    /// Somebody asks for a stop at `now_ns`, who must see zero in time while the loop runs.
    pub fn stop_asked(&mut self, now_ns: u64) {
        self.stop_asked_ns.get_or_insert(now_ns);
    }

    /// The loop hung until `now_ns`: only from then on it can obey.
    pub fn hung_until(&mut self, now_ns: u64) {
        self.stop_asked_ns = self.stop_asked_ns.map(|asked| asked.max(now_ns));
    }

    /// A cycle whose command goes out at `sent_ns`: its answers, then its command.
    pub fn cycle(&mut self, cycle: &Cycle, command: &TwistCommand, facts: Facts, sent_ns: u64) {
        let mut has_stopped = false;
        for (request, reply) in &cycle.replies {
            has_stopped |= request.action() == Some(Action::Stop);
            self.answer(request, reply, cycle.inputs.now_ns);
        }
        if has_stopped {
            self.check(
                command.twist == [0.0; 6] && command.state() == Some(TwistState::Disarmed),
                || format!("stop: another command in its cycle: {:?}", command.state()),
            );
        }
        if command.twist == [0.0; 6]
            && let Some(asked_ns) = self.stop_asked_ns.take_if(|_| has_stopped)
        {
            let took_ns = sent_ns.saturating_sub(asked_ns);
            self.stop_ns = self.stop_ns.max(took_ns);
            self.check(took_ns <= BRAKING_NS, || {
                format!("stop: zero after {} ms", took_ns / 1_000_000)
            });
        }
        if let Some(asked_ns) = self.stop_asked_ns {
            let waits_ns = sent_ns.saturating_sub(asked_ns);
            self.check(waits_ns <= BRAKING_NS, || {
                format!("stop: none after {} ms", waits_ns / 1_000_000)
            });
        }
        self.command(cycle, command, facts, has_stopped);
    }

    /// The answer to one request that was taken at `now_ns`.
    fn answer(&mut self, request: &Request, reply: &Reply, now_ns: u64) {
        let asked_ns = request.stamp.published_ns;
        let age_ns = now_ns.abs_diff(asked_ns);
        let most_ns = if asked_ns > now_ns {
            FUTURE_NS
        } else {
            LATE_NS
        };
        let (action, outcome) = (request.action(), reply.outcome());
        self.check(reply.id == request.id, || format!("replies: {reply:?}"));
        let leads_to_motion = matches!(action, Some(Action::Arm | Action::Strategy));
        let is_late = outcome == Some(Outcome::Late);
        self.check(is_late == (leads_to_motion && age_ns > most_ns), || {
            format!("late requests: {outcome:?} after {} ms", age_ns / 1_000_000)
        });
        match (action, outcome) {
            (Some(Action::Arm), Some(Outcome::Done)) => self.armed(request),
            (Some(Action::Disarm), _) if self.consent == Consent::Given => {
                self.consent = Consent::Ending;
            }
            (Some(Action::Stop), _) => {
                (self.consent, self.waits) = (Consent::None, false);
                (self.stops, self.is_stop_new) = (self.stops + 1, true);
            }
            _ => (),
        }
        let stops = self.stops;
        self.check(reply.stops == stops, || {
            format!("stops: {stops} came, {} are told", reply.stops)
        });
    }

    fn armed(&mut self, request: &Request) {
        let named = request.stops;
        let (stops, is_new) = (self.stops, self.is_stop_new);
        let is_named = named == stops || (named == 0 && !is_new);
        self.check(self.consent == Consent::Given || is_named, || {
            format!("consent: armed by the name of stop {named}, the last is {stops}")
        });
        self.check(self.consent != Consent::Ending, || {
            "consent: armed while it brakes to disarm".to_owned()
        });
        (self.consent, self.is_stop_new, self.waits) = (Consent::Given, false, false);
    }

    fn command(&mut self, cycle: &Cycle, command: &TwistCommand, facts: Facts, has_stopped: bool) {
        let now_ns = cycle.inputs.now_ns;
        let (state, hold) = (command.state().unwrap(), cycle.answer.decision.hold);
        let is_still = command.twist == [0.0; 6];
        let share = self.share(&command.twist);
        self.check(share <= 1.0 + ROUNDING, || format!("limits: {share}"));
        let must_be_still = matches!(state, TwistState::Disarmed | TwistState::Holding);
        self.check(is_still || !must_be_still, || {
            format!("still: {state} with {:?}", command.twist)
        });
        self.check(hold.is_some() || !must_be_still, || {
            format!("cause: {state} without one")
        });
        let is_of_law = matches!(state, TwistState::Moving | TwistState::Arrived);
        let eyes_ns = now_ns.saturating_sub(facts.eyes_ns);
        let blind = is_of_law && !is_still && eyes_ns > BRAKING_NS;
        self.check(!blind, || {
            format!(
                "silence: the law's command {} ms after it",
                eyes_ns / 1_000_000
            )
        });
        self.step(cycle, command, facts, has_stopped);
        self.unasked(command, now_ns);
        self.before = Some((now_ns, *command));
        if hold.is_none() {
            self.waits = false;
        }
        if state == TwistState::Disarmed {
            self.consent = Consent::None;
        }
    }

    /// How far the command is from the one before.
    fn step(&mut self, cycle: &Cycle, command: &TwistCommand, facts: Facts, has_stopped: bool) {
        let Some((before_ns, before)) = self.before else {
            self.check(command.twist == [0.0; 6], || {
                format!("start: the first command moves by {:?}", command.twist)
            });
            return;
        };
        let elapsed_ns = cycle.inputs.now_ns.checked_sub(before_ns);
        let stood_still = elapsed_ns.is_none_or(|ns| Some(ns) > self.rules.lost_ns);
        let may_jump = has_stopped || facts.is_grave || stood_still;
        if may_jump && command.twist == [0.0; 6] {
            return;
        }
        let changes: [f64; 6] = std::array::from_fn(|k| (command.twist[k] - before.twist[k]).abs());
        let each = std::iter::zip(changes, self.rules.change);
        let steep = each.map(|(change, most)| change / most).fold(0.0, f64::max);
        self.check(steep <= 1.0 + ROUNDING, || {
            format!(
                "steps: {steep:.3} of what is allowed, to {:?}",
                command.twist
            )
        });
        let each = std::iter::zip(changes, self.rules.limits);
        self.steepest = each.map(|(c, most)| c / most).fold(self.steepest, f64::max);
        let (was, is) = (self.share(&before.twist), self.share(&command.twist));
        if cycle.answer.decision.hold.is_some() {
            self.check(is <= was + ROUNDING, || {
                format!("held: it grows from {was} to {is}")
            });
            let most = elapsed_ns.unwrap_or(u64::MAX) as f64 / BRAKE_NS as f64;
            self.check(was - is <= most + ROUNDING, || {
                format!("brake: {} of the limits, {most} is allowed", was - is)
            });
        }
    }

    /// Nothing moves that nobody has asked for.
    fn unasked(&mut self, command: &TwistCommand, now_ns: u64) {
        if self.waits && now_ns > self.begin_ns + PEERS_NS + 2 * PERIOD_NS {
            (self.consent, self.waits) = (Consent::None, false);
        }
        let is_still = command.twist == [0.0; 6];
        let brakes = matches!(command.state(), Some(TwistState::Braking));
        match self.consent {
            Consent::Given => (),
            Consent::None => self.check(is_still, || {
                format!("unasked: it moves by {:?}", command.twist)
            }),
            Consent::Ending => self.check(is_still || brakes, || {
                format!("unasked: it goes on after a disarm by {:?}", command.twist)
            }),
        }
    }

    /// The command with which a process ends in order.
    pub fn last_word(&mut self, command: &TwistCommand) {
        // It answers a stop that came too late for a cycle.
        self.stop_asked_ns = None;
        let rests = self
            .before
            .is_none_or(|(_, before)| before.twist == [0.0; 6]);
        self.check(rests, || "end: the last word is a jump to zero".to_owned());
        let is_zero = command.twist == [0.0; 6] && command.state() == Some(TwistState::Stopped);
        self.check(is_zero, || {
            format!("end: the last word is {:?}", command.twist)
        });
    }

    /// The robot carries this out from `now_ns` on; `newest` is the newest command that came to it.
    pub fn tick(&mut self, twist: &[f64; 6], newest: Option<&TwistCommand>, now_ns: u64) {
        if *twist == [0.0; 6] {
            return;
        }
        let until_ns = newest.map_or(0, |command| {
            command
                .valid_until_ns
                .min(command.stamp.published_ns + OBEYED_NS)
        });
        self.check(now_ns < until_ns, || {
            let late_ms = (now_ns - until_ns) / 1_000_000;
            format!("dead man: it moves {late_ms} ms after the end of the last command")
        });
    }

    /// Whether the last disarming has a cause among these.
    pub fn cause(&mut self, causes: &[Hold], found: Option<Hold>) {
        self.check(found.is_some_and(|hold| causes.contains(&hold)), || {
            format!("cause: {found:?}, must be one of {causes:?}")
        });
    }

    /// The largest component of a twist as a share of its limit; infinite for a NaN.
    fn share(&self, twist: &[f64; 6]) -> f64 {
        let shares = std::iter::zip(twist, self.rules.limits);
        shares.fold(0.0, |most: f64, (v, limit)| match v.abs() / limit {
            share if share.is_nan() => f64::INFINITY,
            share => most.max(share),
        })
    }
}
