//! What must hold after every event, whatever happens: of each command, of each answer to an
//! operator, of each tick of the robot. The judge knows what the world knows, and nothing of the
//! decision but its commands and answers.

use std::collections::VecDeque;

use decision::{Inputs, Rules};
use messages::{
    Action, CycleRecord, FUTURE_NS, Hold, Outcome, Reply, Request, StrategyCode, TwistCommand,
    TwistState,
};

use crate::fault::{BLIND_NS, BRAKE_NS, BRAKING};
use crate::promise::{COUNT, Promise};
use crate::visitor;

/// Relative rounding of a command.
const ROUNDING: f64 = 1e-9;
/// How long a robot obeys a command that none follows, ns.
const OBEYED_NS: u64 = 100_000_000;
/// How long a start that begins armed waits for camera and robot, ns.
const PEERS_NS: u64 = 5_000_000_000;
/// How long a request that leads to motion may wait, ns, and within what that is not certain.
const LATE_NS: u64 = 300_000_000;
const ABOUT_NS: u64 = 1_000_000;
/// How far a joint may be beyond its range, rad.
const BEYOND: f64 = 0.01;

/// Whether anybody has allowed motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Consent {
    /// Nobody.
    None,
    /// An operator by `arm`, or the configuration.
    Given,
    /// It is taken back: the camera may brake.
    Ending,
}

/// What a process has received and sent in a cycle, beside its inputs.
#[derive(Default)]
pub struct Seen {
    /// Requests without an answer.
    taken: VecDeque<Request>,
    /// Those with one, in their order.
    pub answers: Vec<(Request, Reply)>,
    /// By what reading of the clock they were answered, ns.
    taken_ns: Vec<u64>,
    /// Answers that belong to no request.
    strays: u32,
    /// The command, where it was sent, and when that was tried, ns.
    pub command: Option<TwistCommand>,
    pub sent_ns: u64,
}

impl Seen {
    /// A request is taken.
    pub fn take(&mut self, request: Request) {
        self.taken.push_back(request);
    }

    /// The clock is read at `now_ns`: the first time after a request, its age is judged by it.
    pub fn read_clock(&mut self, now_ns: u64) {
        let requests = self.answers.len() + self.taken.len();
        self.taken_ns.resize(requests, now_ns);
    }

    /// The stop file asks.
    pub fn take_file(&mut self) {
        self.take(Request::new(Request::STOP_FILE, Action::Stop));
    }

    /// An answer goes out.
    pub fn answer(&mut self, reply: &Reply) {
        match self.taken.pop_front() {
            Some(request) if request.id == reply.id => self.answers.push((request, *reply)),
            _ => self.strays += 1,
        }
    }
}

/// What the world knows of a cycle.
#[derive(Clone, Copy, Debug)]
pub struct Facts {
    /// When any message of the camera came last, ns.
    pub eyes_ns: u64,
    /// When one came last that shows all points, ns.
    pub whole_ns: u64,
    /// Since when a request waits, ns.
    pub waits_since_ns: Option<u64>,
    /// Whether the robot is at fault, the clock or a stamp is from the future, or the machine was
    /// suspended.
    pub is_grave: bool,
}

/// The judge of a run.
pub struct Judge {
    rules: Rules,
    /// The limits that an operator has armed, m/s and rad/s.
    cell: [f64; 6],
    period_ns: u64,
    /// How far the clock may go back in this run, ns.
    back_ns: u64,
    begin_ns: u64,
    /// The last decision: its instant, and what it commanded.
    before: Option<(u64, [f64; 6])>,
    consent: Consent,
    /// Whether the configuration's consent waits for camera and robot.
    waits: bool,
    /// Whether the strategy has a goal.
    has_goal: bool,
    /// The veto that stands, and when a stop was answered last, ns.
    pub veto: u32,
    stopped_ns: Option<u64>,
    /// Whether a process was killed since.
    is_unclean: bool,
    /// When the oldest stop was asked that no zero has followed yet, ns.
    stop_asked_ns: Option<u64>,
    /// The greatest step of a component, as a share of its limit.
    pub steepest: f64,
    /// Longest time from asking a stop to zero, ns.
    pub stop_ns: u64,
    /// How often each property was checked.
    pub checks: [u64; COUNT],
    /// The first property that does not hold.
    pub broken: Option<String>,
}

impl Judge {
    /// One who has seen nothing, of a clock that goes back perhaps.
    pub fn new(rules: Rules, period_ns: u64, turns_back: bool) -> Self {
        Self {
            rules,
            cell: rules.limits,
            period_ns,
            back_ns: if turns_back { 3 * period_ns } else { 0 },
            begin_ns: 0,
            before: None,
            consent: Consent::None,
            waits: false,
            has_goal: true,
            veto: 0,
            stopped_ns: None,
            is_unclean: false,
            stop_asked_ns: None,
            steepest: 0.0,
            stop_ns: 0,
            checks: [0; COUNT],
            broken: None,
        }
    }

    /// A property does not hold.
    pub fn fail(&mut self, promise: Promise, what: impl FnOnce() -> String) {
        self.check(promise, false, what);
    }

    /// Fails unless `holds`.
    pub fn check(&mut self, promise: Promise, holds: bool, what: impl FnOnce() -> String) {
        self.checks[promise as usize] += 1;
        if !holds && self.broken.is_none() {
            self.broken = Some(format!("{}: {}", promise.name(), what()));
        }
    }

    /// A process begins, with these rules; whether the configuration lets it move.
    pub fn begin(&mut self, rules: Rules, is_armed: bool, has_goal: bool, now_ns: u64) {
        (self.rules, self.has_goal) = (rules, has_goal);
        self.begin_ns = now_ns;
        self.before = None;
        let is_armed = is_armed && !self.is_unclean;
        self.waits = is_armed;
        self.consent = match is_armed {
            true => Consent::Given,
            false => Consent::None,
        };
    }

    /// The process was killed.
    pub fn killed(&mut self) {
        self.forget();
        self.is_unclean = true;
    }

    /// The process has gone without leaving its veto.
    pub fn forget(&mut self) {
        (self.veto, self.stopped_ns, self.stop_asked_ns) = (0, None, None);
    }

    /// Somebody asks for a stop at `now_ns`, who must see zero in time while the loop runs.
    pub fn stop_asked(&mut self, now_ns: u64) {
        self.stop_asked_ns.get_or_insert(now_ns);
    }

    /// The loop hung until `now_ns`: only from then on it can obey.
    pub fn hung_until(&mut self, now_ns: u64) {
        self.stop_asked_ns = self.stop_asked_ns.map(|asked| asked.max(now_ns));
    }

    /// A cycle: its answers, then its command.
    pub fn cycle(&mut self, record: &CycleRecord, inputs: &Inputs, seen: &Seen, facts: Facts) {
        let mut has_stopped = false;
        for ((request, reply), taken_ns) in std::iter::zip(&seen.answers, &seen.taken_ns) {
            has_stopped |= request.action() == Some(Action::Stop);
            self.answer(request, reply, *taken_ns);
        }
        let is_complete = seen.taken.is_empty() && seen.strays == 0;
        self.check(Promise::Replies, is_complete, || {
            format!("{} without, {} of nothing", seen.taken.len(), seen.strays)
        });
        let woken_ns = record.stamp.data_ns;
        // It takes no more than wait when it begins; others come meanwhile.
        let is_full = seen.answers.len() >= Request::PER_CYCLE;
        let is_empty = is_full || facts.waits_since_ns.is_none_or(|since| since >= woken_ns);
        self.check(Promise::Replies, is_empty, || {
            "one that came before the cycle has none".to_owned()
        });
        let state = TwistState::from_code(record.state).unwrap();
        let is_zero = record.twist == [0.0; 6];
        if has_stopped {
            self.check(
                Promise::Stop,
                is_zero && state == TwistState::Disarmed,
                || format!("another command in its cycle: {state}"),
            );
        }
        let sent_ns = seen.sent_ns;
        let most_ns = BRAKING * self.period_ns;
        if is_zero
            && seen.command.is_some()
            && let Some(asked_ns) = self.stop_asked_ns.take_if(|_| has_stopped)
        {
            let took_ns = sent_ns.saturating_sub(asked_ns);
            self.stop_ns = self.stop_ns.max(took_ns);
            self.check(Promise::Stop, took_ns <= most_ns, || {
                format!("zero after {} ms", took_ns / 1_000_000)
            });
        }
        if let Some(asked_ns) = self.stop_asked_ns {
            let waits_ns = sent_ns.saturating_sub(asked_ns);
            self.check(Promise::Stop, waits_ns <= most_ns, || {
                format!("none after {} ms", waits_ns / 1_000_000)
            });
        }
        let hold = Hold::from_code(record.hold);
        self.command(record, inputs.now_ns, (state, hold), facts, has_stopped);
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
        let leads_to_motion = matches!(action, Some(Action::Arm | Action::Strategy));
        let is_late = outcome == Some(Outcome::Late);
        let must_be = leads_to_motion && age_ns > most_ns;
        let is_near = age_ns.abs_diff(most_ns) < ABOUT_NS;
        self.check(Promise::Late, is_near || is_late == must_be, || {
            format!("{outcome:?} after {} ms", age_ns / 1_000_000)
        });
        match (action, outcome) {
            (Some(Action::Arm), Some(Outcome::Done)) => self.armed(request, now_ns),
            (Some(Action::Disarm), _) => self.vetoed(reply),
            (Some(Action::Stop), _) => {
                self.vetoed(reply);
                self.consent = Consent::None;
                self.stopped_ns = Some(now_ns);
            }
            (Some(Action::Strategy), Some(Outcome::Done)) => {
                let has_goal = reply.strategy != StrategyCode::Follow.code();
                // One that is braking already needs no veto.
                if reply.veto != self.veto {
                    self.vetoed(reply);
                } else if has_goal != self.has_goal && self.consent == Consent::Given {
                    self.consent = Consent::Ending;
                }
                self.has_goal = has_goal;
            }
            _ => (),
        }
        let veto = self.veto;
        self.check(Promise::Consent, reply.veto == veto, || {
            format!("veto {veto} stands, {} is told", reply.veto)
        });
    }

    /// Somebody has stopped or disarmed it: by a name of its own.
    fn vetoed(&mut self, reply: &Reply) {
        let is_new = ![0, self.veto].contains(&reply.veto);
        self.check(Promise::Consent, is_new, || {
            format!("veto {} again", reply.veto)
        });
        (self.veto, self.waits) = (reply.veto, false);
        if self.consent == Consent::Given {
            self.consent = Consent::Ending;
        }
    }

    fn armed(&mut self, request: &Request, now_ns: u64) {
        let (named, veto) = (request.veto, self.veto);
        let is_program = request.id >> 32 == visitor::OPERATOR as u64 + 1;
        let is_named = [0, named].contains(&veto);
        self.check(Promise::Consent, is_named, || {
            format!("armed by the name {named}, veto {veto} stands")
        });
        let stopped_ns = self.stopped_ns.unwrap_or(0);
        let since_ns = now_ns.saturating_sub(stopped_ns);
        let is_late = veto == 0 || since_ns + self.back_ns >= Request::AFTER_STOP_NS;
        self.check(Promise::Consent, is_late, || {
            format!("armed {} ms after a stop", since_ns / 1_000_000)
        });
        self.check(Promise::Consent, self.consent != Consent::Ending, || {
            "armed while it brakes to disarm".to_owned()
        });
        (self.consent, self.waits) = (Consent::Given, false);
        (self.veto, self.is_unclean) = (0, false);
        if !is_program {
            self.cell = self.rules.limits;
        }
    }

    fn command(
        &mut self,
        record: &CycleRecord,
        now_ns: u64,
        (state, hold): (TwistState, Option<Hold>),
        facts: Facts,
        has_stopped: bool,
    ) {
        let twist = &record.twist;
        let is_still = *twist == [0.0; 6];
        let share = share(twist, &self.rules.limits);
        self.check(Promise::Limits, share <= 1.0 + ROUNDING, || {
            share.to_string()
        });
        let of_cell = self::share(twist, &self.cell);
        self.check(Promise::Cell, of_cell <= 1.0 + ROUNDING, || {
            format!("{of_cell} of those that an operator has armed")
        });
        let must_be_still = matches!(state, TwistState::Disarmed | TwistState::Holding);
        self.check(Promise::Still, is_still || !must_be_still, || {
            format!("{state} with {twist:?}")
        });
        self.check(Promise::Still, hold.is_some() || !must_be_still, || {
            format!("{state} without a cause")
        });
        let is_of_law = matches!(state, TwistState::Moving | TwistState::Arrived);
        if is_of_law && !is_still {
            let silent_ns = now_ns.saturating_sub(facts.eyes_ns);
            let most_ns = BRAKING * self.period_ns;
            self.check(Promise::Silence, silent_ns <= most_ns, || {
                format!("the law's command {} ms after it", silent_ns / 1_000_000)
            });
            let blind_ns = now_ns.saturating_sub(facts.whole_ns);
            self.check(Promise::Blind, blind_ns <= BLIND_NS + most_ns, || {
                format!("the law's command {} ms after it", blind_ns / 1_000_000)
            });
        }
        self.step(record, now_ns, hold, facts, has_stopped);
        self.unasked(twist, state, now_ns);
        self.before = Some((now_ns, *twist));
        if hold.is_none() {
            self.waits = false;
        }
        if state == TwistState::Disarmed {
            self.consent = Consent::None;
        }
    }

    /// How far the command is from the one before.
    fn step(
        &mut self,
        record: &CycleRecord,
        now_ns: u64,
        hold: Option<Hold>,
        facts: Facts,
        has_stopped: bool,
    ) {
        let twist = &record.twist;
        let Some((before_ns, before)) = self.before else {
            self.check(Promise::Unasked, *twist == [0.0; 6], || {
                format!("the first command moves by {twist:?}")
            });
            return;
        };
        let elapsed_ns = now_ns.checked_sub(before_ns);
        let stood_still = elapsed_ns.is_none_or(|ns| Some(ns) > self.rules.lost_ns);
        let may_jump = has_stopped || facts.is_grave || stood_still;
        if may_jump && *twist == [0.0; 6] {
            return;
        }
        let changes: [f64; 6] = std::array::from_fn(|k| (twist[k] - before[k]).abs());
        let each = std::iter::zip(changes, self.rules.change);
        let steep = each.map(|(change, most)| change / most).fold(0.0, f64::max);
        self.check(Promise::Steps, steep <= 1.0 + ROUNDING, || {
            format!("{steep:.3} of what is allowed, to {twist:?}")
        });
        let each = std::iter::zip(changes, self.rules.limits);
        self.steepest = each.map(|(c, most)| c / most).fold(self.steepest, f64::max);
        let [was, is] = [&before, twist].map(|twist| share(twist, &self.rules.limits));
        if hold.is_some() {
            self.check(Promise::Held, is <= was + ROUNDING, || {
                format!("it grows from {was} to {is}")
            });
            let most = elapsed_ns.unwrap_or(u64::MAX) as f64 / BRAKE_NS as f64;
            self.check(Promise::Slow, was - is <= most + ROUNDING, || {
                format!("{} of the limits, {most} is allowed", was - is)
            });
        }
    }

    /// Nothing moves that nobody has asked for.
    fn unasked(&mut self, twist: &[f64; 6], state: TwistState, now_ns: u64) {
        let waited_ns = PEERS_NS + 2 * self.period_ns;
        if self.waits && now_ns > self.begin_ns + waited_ns {
            (self.consent, self.waits) = (Consent::None, false);
        }
        let is_still = *twist == [0.0; 6];
        let brakes = state == TwistState::Braking;
        match self.consent {
            Consent::Given => (),
            Consent::None => self.check(Promise::Unasked, is_still, || {
                format!("it moves by {twist:?}")
            }),
            Consent::Ending => self.check(Promise::Unasked, is_still || brakes, || {
                format!("it goes on by {twist:?} after its consent was taken back")
            }),
        }
    }

    /// The command with which a process ends in order.
    pub fn last_word(&mut self, command: &TwistCommand) {
        // It answers a stop that came too late for a cycle.
        self.stop_asked_ns = None;
        let rests = self.before.is_none_or(|(_, before)| before == [0.0; 6]);
        self.check(Promise::End, rests, || {
            "the last word is a jump to zero".to_owned()
        });
        let is_zero = command.twist == [0.0; 6] && command.state() == Some(TwistState::Stopped);
        self.check(Promise::End, is_zero, || {
            format!("the last word is {:?}", command.twist)
        });
    }

    /// The robot is let carry this out from `now_ns` on; `newest` is the newest command that came
    /// to it.
    pub fn tick(&mut self, twist: &[f64; 6], newest: Option<&TwistCommand>, now_ns: u64) {
        if *twist == [0.0; 6] {
            return;
        }
        let until_ns = newest.map_or(0, |command| {
            command
                .valid_until_ns
                .min(command.stamp.published_ns + OBEYED_NS)
        });
        self.check(Promise::DeadMan, now_ns < until_ns, || {
            let late_ms = (now_ns - until_ns) / 1_000_000;
            format!("it moves {late_ms} ms after the end of the last command")
        });
    }

    /// The worst joint is so far beyond its range, rad.
    pub fn joints(&mut self, beyond: f64) {
        self.check(Promise::Joints, beyond <= BEYOND, || {
            format!("one is {beyond:.3} rad beyond its range")
        });
    }

    /// Whether the last disarming has a cause among these.
    pub fn cause(&mut self, causes: &[Hold], found: Option<Hold>) {
        let is_one = found.is_some_and(|hold| causes.contains(&hold));
        self.check(Promise::Cause, is_one, || {
            format!("{found:?}, must be one of {causes:?}")
        });
    }
}

/// The largest component of a twist as a share of its limit; infinite for a NaN.
pub fn share(twist: &[f64; 6], limits: &[f64; 6]) -> f64 {
    let shares = std::iter::zip(twist, limits);
    shares.fold(0.0, |most: f64, (v, limit)| match v.abs() / limit {
        share if share.is_nan() => f64::INFINITY,
        share => most.max(share),
    })
}
