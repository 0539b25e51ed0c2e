//! The robot's state by its messages: not there, at fault, silent, not following, late, or fine.
//! Pure; the time is an argument.

use messages::{Hold, RobotFaults, RobotMode, RobotState};
use serde::{Deserialize, Serialize};
use vpc::lag::{self, Displacement, Track};

use crate::contract;
use crate::input::Input;
use crate::rules::Rules;

/// Spans of time whose commands a robot may still be carrying out, and the length of each, ns: a
/// shaper, a low-pass filter and the way there have half a second together.
const SPANS: usize = 5;
const SPAN_NS: u64 = 100_000_000;
/// A robot follows where each component is no further from what was commanded than this share of
/// its limit.
const SHARE: f64 = 0.1;

/// What it may miss for a second of what was commanded, at the lag that explains it best: the mean
/// of its components, as a share of their limits.
const MISSED: f64 = 0.1;
/// Reports further apart than this tell no motion in between, ns.
const GAP_NS: u64 = 500_000_000;

/// What the robot's messages have said so far.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotWatch {
    lost_ns: Option<u64>,
    is_needed: bool,
    /// Largest magnitude of each component, m/s and rad/s.
    limits: [f64; 6],
    /// What was commanded of late, the newest first.
    spans: [Span; SPANS],
    /// When the last state was published, CLOCK_MONOTONIC, ns; not later than it was looked at.
    heard_ns: Option<u64>,
    at_fault: bool,
    is_idle: bool,
    /// Since when it has not followed, CLOCK_MONOTONIC, ns.
    strays_ns: Option<u64>,
    /// What it reported and was commanded of late: motions as the time that they take at the limit.
    track: Track,
    /// The last report and its instant, and what moved since the end of the newest slot.
    report: Option<([f64; 6], u64)>,
    moved: Displacement,
    lag_s: Option<f64>,
}

/// The smallest and the greatest of each component that was commanded in a span of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Span {
    begin_ns: u64,
    last: [f64; 6],
    least: [f64; 6],
    most: [f64; 6],
}

impl RobotWatch {
    /// A watch by these rules, before the first message.
    pub fn new(rules: &Rules) -> Self {
        Self {
            lost_ns: rules.lost_ns,
            is_needed: rules.needs_robot,
            limits: rules.limits,
            spans: Default::default(),
            heard_ns: None,
            at_fault: false,
            is_idle: false,
            strays_ns: None,
            track: Track::NEW,
            report: None,
            moved: Displacement::default(),
            lag_s: None,
        }
    }

    /// What is wrong at `now_ns`, after what was received by then: [`Hold::NoRobot`],
    /// [`Hold::RobotFault`], [`Hold::RobotLost`], [`Hold::NotFollowed`] or [`Hold::RobotLate`].
    /// Where none is needed, a robot that was never heard is not missed: a camera may be carried by
    /// something that says nothing. `commanded` is the mean command between two instants.
    pub fn look(
        &mut self,
        input: &Input<RobotState>,
        now_ns: u64,
        commanded: impl Fn(u64, u64) -> [f64; 6],
    ) -> Option<Hold> {
        if let Input::Message(state) = input {
            // A stamp from the future would put off the silence after it.
            self.heard_ns = Some(state.stamp.published_ns.min(now_ns));
            self.at_fault = is_fault(state);
            // An idle robot says that it obeys no commands.
            self.is_idle = state.mode() == Some(RobotMode::Idle);
            self.strays_ns = match self.is_idle || self.follows(&state.twist) {
                true => None,
                false => self.strays_ns.or(Some(now_ns)),
            };
            self.compare(state, now_ns, commanded);
        }
        let is_long = |since: u64| {
            let limit = self.lost_ns;
            limit.is_some_and(|limit| now_ns.saturating_sub(since) > limit)
        };
        // A state that breaks the contract is as good as none: it ends in silence.
        match self.heard_ns {
            None => self.is_needed.then_some(Hold::NoRobot),
            _ if self.at_fault => Some(Hold::RobotFault),
            Some(heard) if is_long(heard) => Some(Hold::RobotLost),
            _ if self.strays_ns.is_some_and(is_long) => Some(Hold::NotFollowed),
            _ if self.lost_ns.is_some() && self.lag_s.is_some() => Some(Hold::RobotLate),
            _ => None,
        }
    }

    /// How late the reported motion is, s, where that is more than the law stands.
    pub fn lag_s(&self) -> Option<f64> {
        self.lag_s
    }

    /// Compares the reported motion since the last report with the commanded one.
    fn compare(
        &mut self,
        state: &RobotState,
        now_ns: u64,
        commanded: impl Fn(u64, u64) -> [f64; 6],
    ) {
        let at_ns = contract::exposed_ns(&state.stamp).min(now_ns);
        let before = self.report.replace((state.twist, at_ns));
        let before = before
            .filter(|&(_, from_ns)| !self.is_idle && from_ns < at_ns && at_ns - from_ns < GAP_NS);
        let Some((twist, from_ns)) = before else {
            (self.track, self.lag_s) = (Track::NEW, None);
            self.moved = Displacement::default();
            return;
        };
        let seconds = (at_ns - from_ns) as f64 * 1e-9;
        let told = commanded(from_ns, at_ns);
        let mean = core::array::from_fn(|k| 0.5 * (twist[k] + state.twist[k]));
        let (moved, told) = (self.at_limit(&mean, seconds), self.at_limit(&told, seconds));
        lag::add(&mut self.moved, &moved, 1.0);
        self.track.command(&told, at_ns);
        if self.track.is_due(at_ns) {
            self.track.end(core::mem::take(&mut self.moved));
            self.lag_s = self.track.late([0.0, MISSED]);
        }
    }

    /// A motion as the time that each component takes at its limit, s.
    fn at_limit(&self, twist: &[f64; 6], seconds: f64) -> Displacement {
        let mut motion = Displacement::default();
        let pairs = twist.iter().zip(&self.limits);
        for (to, (v, limit)) in motion.as_flattened_mut().iter_mut().zip(pairs) {
            *to = (v / limit * seconds) as f32;
        }
        motion
    }

    /// Whether the last message says that the robot obeys no commands.
    pub fn is_idle(&self) -> bool {
        self.is_idle
    }

    /// Notes what was commanded at `now_ns`.
    pub fn sent(&mut self, twist: &[f64; 6], now_ns: u64) {
        let newest = self.spans[0];
        if now_ns.saturating_sub(newest.begin_ns) >= SPAN_NS {
            self.spans.rotate_right(1);
            // The command before is in force until this one.
            let last = newest.last;
            self.spans[0] = Span {
                begin_ns: now_ns,
                last,
                least: last,
                most: last,
            };
        }
        let span = &mut self.spans[0];
        span.last = *twist;
        for (k, v) in twist.iter().enumerate() {
            (span.least[k], span.most[k]) = (span.least[k].min(*v), span.most[k].max(*v));
        }
    }

    /// Whether a robot that carries this out does what was commanded of late.
    fn follows(&self, twist: &[f64; 6]) -> bool {
        (0..6).all(|k| {
            let spans = self.spans.iter();
            let (least, most) = spans.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), span| {
                (a.min(span.least[k]), b.max(span.most[k]))
            });
            let room = SHARE * self.limits[k];
            (least - room..=most + room).contains(&twist[k])
        })
    }
}

/// Whether the robot stopped by itself.
fn is_fault(state: &RobotState) -> bool {
    state.mode() == Some(RobotMode::Fault) || state.faults().any(RobotFaults::REFLEX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(mode: RobotMode, faults: RobotFaults, published_ns: u64) -> Input<RobotState> {
        let mut message = RobotState::free_camera([0.0; 3], [0.0; 3], published_ns);
        message.mode = mode.code();
        message.faults = faults.0;
        message.stamp.published_ns = published_ns;
        Input::Message(message)
    }

    fn watch(lost_ns: Option<u64>) -> RobotWatch {
        let rules = Rules {
            limits: [0.5, 0.5, 0.5, 1.0, 1.0, 1.0],
            change: [f64::INFINITY; 6],
            brake_ns: 0,
            ramp_ns: 0,
            valid_ns: None,
            lost_ns,
            needs_robot: false,
            begins_armed: true,
            after_arrival: Default::default(),
        };
        RobotWatch::new(&rules)
    }

    /// Looks, where nothing was commanded.
    fn look(watch: &mut RobotWatch, input: &Input<RobotState>, now_ns: u64) -> Option<Hold> {
        watch.look(input, now_ns, |_, _| [0.0; 6])
    }

    #[test]
    fn a_robot_that_was_never_heard_is_missed_where_one_is_needed() {
        let mut watch = watch(Some(10));
        assert_eq!(look(&mut watch, &Input::Nothing, 1 << 40), None);
        watch.is_needed = true;
        let missed = look(&mut watch, &Input::Nothing, 1 << 40);
        assert_eq!(missed, Some(Hold::NoRobot));
        let idle = state(RobotMode::Idle, RobotFaults::default(), 1 << 40);
        assert_eq!(look(&mut watch, &idle, 1 << 40), None);
    }

    #[test]
    fn a_robot_that_ignores_commands_does_not_follow() {
        const MS: u64 = 1_000_000;
        // What it carries out of a command that changes from 0 to 0.4 m/s at 1 s; when it is found
        // not to follow, if ever, ms.
        let found_in = |mode: RobotMode, carries: fn(u64) -> f64| {
            let mut watch = watch(Some(300 * MS));
            (0..4000).step_by(33).find(|ms| {
                let mut message = RobotState {
                    mode: mode.code(),
                    ..RobotState::default()
                };
                message.stamp.published_ns = ms * MS;
                message.twist[1] = carries(*ms);
                let wrong = look(&mut watch, &Input::Message(message), ms * MS);
                let commanded = if *ms < 1000 { 0.0 } else { 0.4 };
                watch.sent(&[0.0, commanded, 0.0, 0.0, 0.0, 0.0], ms * MS);
                assert!(wrong.is_none_or(|hold| hold == Hold::NotFollowed));
                wrong.is_some()
            })
        };
        let found = |carries| found_in(RobotMode::Moving, carries);
        let command = |ms: u64| if ms < 1000 { 0.0 } else { 0.4 };
        assert_eq!(found(command), None);
        // Late by 0.4 s, too slow by a twentieth of the limit, shaped over 0.3 s.
        assert_eq!(found(|ms| if ms < 1400 { 0.0 } else { 0.4 }), None);
        assert_eq!(found(|ms| if ms < 1000 { 0.0 } else { 0.375 }), None);
        assert_eq!(
            found(|ms| (ms.saturating_sub(1000) as f64 / 300.0).min(1.0) * 0.4),
            None
        );
        // It stands; it moves by itself; it goes the other way.
        let stands = found(|_| 0.0).unwrap();
        assert!((1700..1950).contains(&stands), "{stands}");
        let by_itself = found(|_| 0.1).unwrap();
        assert!((300..400).contains(&by_itself), "{by_itself}");
        let other_way = found(|ms| if ms < 1000 { 0.0 } else { -0.4 }).unwrap();
        assert!((1300..1450).contains(&other_way), "{other_way}");
        // While something else moves it, it says so.
        assert_eq!(found_in(RobotMode::Idle, |_| 0.1), None);
    }

    #[test]
    fn silence_is_noticed_and_ends_with_the_next_state() {
        let mut watch = watch(Some(10));
        let fine = RobotFaults::default();
        assert_eq!(
            look(&mut watch, &state(RobotMode::Moving, fine, 100), 101),
            None
        );
        assert_eq!(look(&mut watch, &Input::Nothing, 110), None);
        assert_eq!(
            look(&mut watch, &Input::Nothing, 111),
            Some(Hold::RobotLost)
        );
        assert_eq!(
            look(&mut watch, &state(RobotMode::Idle, fine, 112), 113),
            None
        );
    }

    #[test]
    fn a_state_from_the_future_puts_off_no_silence() {
        let mut watch = watch(Some(10));
        let future = state(RobotMode::Moving, RobotFaults::default(), u64::MAX);
        assert_eq!(look(&mut watch, &future, 100), None);
        assert_eq!(
            look(&mut watch, &Input::Nothing, 111),
            Some(Hold::RobotLost)
        );
    }

    #[test]
    fn a_fault_lasts_until_the_robot_says_otherwise() {
        let mut watch = watch(None);
        let fine = RobotFaults::default();
        let reflex = state(RobotMode::Moving, RobotFaults::REFLEX, 1);
        assert_eq!(look(&mut watch, &reflex, 2), Some(Hold::RobotFault));
        assert_eq!(
            look(&mut watch, &Input::Nothing, 1 << 40),
            Some(Hold::RobotFault)
        );
        assert_eq!(look(&mut watch, &state(RobotMode::Idle, fine, 3), 4), None);
        let fault = state(RobotMode::Fault, fine, 5);
        assert_eq!(look(&mut watch, &fault, 6), Some(Hold::RobotFault));
        // Standing still because commands are missing, or cutting one to the limits, is no fault.
        let cut = RobotFaults(RobotFaults::STALE_COMMAND.0 | RobotFaults::COMMAND_LIMITED.0);
        assert_eq!(look(&mut watch, &state(RobotMode::Stale, cut, 7), 8), None);
    }
}
