//! The supervisor: whether the law's twist may go out, and what goes out instead. Pure; the time is
//! an argument.
//!
//! Three modes: *armed*, where the law moves the camera; *braking to disarm*; *disarmed*, where the
//! twist is zero until an operator arms. Each cycle has at most one hold on the law's twist, the
//! gravest of all that are present, and each hold has one response:
//!
//! - *Zero at once, disarm*: operator's stop, robot fault, clock anomaly, a standstill of the loop.
//! - *Brake, disarm*: shutdown, operator's disarm, robot silent, not following or late, joints not
//!   following, overruns, bad twist, solver failure, frozen image, an image that does not follow,
//!   moves more than commanded or is late, features lost.
//! - *Brake, go on with the next good features*: no robot yet; features stale, invalid, hidden,
//!   miscounted, not finite, off the image, mixed up, elsewhere, out of order; transport; no way
//!   known; a solver that failed once or twice.
//! - *Brake, and stand or disarm*: it has arrived, and is not to follow.
//!
//! Each list begins with its gravest hold. A start that begins armed disarms if camera and robot
//! do not come within 5 s. Features are *lost* if the law could use none for [`Rules::lost_ns`];
//! where that is for want of the arm's joints, it disarms for them. After a response the law's
//! twist is taken up again as steeply as it is braked, and no more so.

use messages::{Action, Hold, Outcome, TwistState};
use serde::{Deserialize, Serialize};

use crate::decision::Decision;
use crate::rules::{AfterArrival, Rules};
use crate::veto::{Names, Veto};

/// Cycles in a row with missed releases, or with a solver that failed, after which the camera is
/// stopped.
const IN_A_ROW: u32 = 3;
/// How long a start that begins armed waits for camera and robot, ns.
const PEERS_NS: u64 = 5_000_000_000;
/// Relative error of a sum of two twists.
const ROUNDING: f64 = 1e-9;
/// A cycle with missed releases adds this to the count, one without subtracts 1. So overruns in
/// more than one of three cycles also stop the camera, if they last.
const OVERRUN: u32 = 2;

/// What the supervisor decides from in a cycle, apart from the time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Situation {
    /// What the law, or the gate before it, decided.
    pub decision: Decision,
    /// When the last features that the law could use were published, CLOCK_MONOTONIC, ns; `None`
    /// before the first.
    pub good_ns: Option<u64>,
    /// Whether the law ran in this cycle, and if so, whether its solver failed.
    pub solver_failed: Option<bool>,
    /// Releases missed just before this cycle.
    pub missed: u32,
    /// What is wrong with the robot, as [`RobotWatch::look`](crate::robot::RobotWatch::look) or
    /// [`JointWatch::hold`](crate::joints::JointWatch::hold) says.
    pub robot: Option<Hold>,
    /// Whether the machine was suspended just before this cycle.
    pub suspended: bool,
    /// Whether the daemon is to stop.
    pub shutdown: bool,
}

/// Whether the law moves the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum Mode {
    Armed,
    /// On the way to disarmed, for this hold.
    Disarming(Hold),
    Disarmed(Hold),
}

/// The state machine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Supervisor {
    rules: Rules,
    mode: Mode,
    /// The last cycle: when it was, and what it sent.
    last: Option<u64>,
    sent: Decision,
    /// Whether the law's twist is taken up again, and was not reached yet.
    is_ramping: bool,
    /// The last operator's stop or disarm since the last arming, and the names of those to come.
    veto: Option<Veto>,
    names: Names,
    /// Whether an operator has armed it.
    has_consent: bool,
    /// Since when it waits for camera and robot, if it began armed and has not met them yet.
    waits_since: Option<u64>,
    has_met: bool,
    /// Whether it has arrived since the last arming, and is not to follow.
    has_arrived: bool,
    /// The situation of the last cycle.
    situation: Option<Situation>,
    overruns: u32,
    failures: u32,
}

/// The response to a hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Response {
    /// Zero at once, and disarm.
    Stop,
    /// Brake, and disarm.
    Disarm,
    /// Brake, and go on when the hold is gone.
    Wait,
}

impl Supervisor {
    /// A supervisor at rest.
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            mode: match rules.begins_armed {
                true => Mode::Armed,
                false => Mode::Disarmed(Hold::NotArmed),
            },
            last: None,
            sent: Decision::hold(Hold::NoFeatures),
            is_ramping: true,
            veto: None,
            names: Names(0),
            has_consent: false,
            waits_since: None,
            has_met: !rules.begins_armed || rules.lost_ns.is_none(),
            has_arrived: false,
            situation: None,
            overruns: 0,
            failures: 0,
        }
    }

    /// Before the first cycle: begins disarmed, whatever the rules say.
    pub fn begin_disarmed(&mut self, hold: Hold) {
        (self.mode, self.has_met) = (Mode::Disarmed(hold), true);
    }

    /// Before the first cycle: begins disarmed, under the veto of this name that stood before; 0:
    /// none stood.
    pub fn begin_again(&mut self, veto: u32) {
        self.begin_disarmed(Hold::NotArmed);
        self.veto = Veto::named(veto);
    }

    /// Before the first cycle: the names of vetoes follow from this secret seed.
    pub fn name_vetoes(&mut self, seed: u64) {
        self.names = Names(seed);
    }

    /// Its settings.
    pub fn rules(&self) -> Rules {
        self.rules
    }

    /// Whether the law may move the camera.
    pub fn is_armed(&self) -> bool {
        self.mode == Mode::Armed
    }

    /// Whether the last twist was zero.
    pub fn is_at_rest(&self) -> bool {
        self.sent.twist == [0.0; 6]
    }

    /// The state, and its hold.
    pub fn state(&self) -> (TwistState, Option<Hold>) {
        match self.mode {
            Mode::Disarmed(hold) => (TwistState::Disarmed, Some(hold)),
            Mode::Disarming(hold) => (TwistState::Braking, Some(hold)),
            // Armed since the last cycle: nothing was sent yet.
            Mode::Armed if self.sent.state == TwistState::Disarmed => (TwistState::Holding, None),
            Mode::Armed => (self.sent.state, self.sent.hold),
        }
    }

    /// The last operator's stop or disarm since it was last armed.
    pub fn veto(&self) -> Option<Veto> {
        self.veto
    }

    /// Whether an operator has armed it.
    pub fn has_consent(&self) -> bool {
        self.has_consent
    }

    /// Takes an operator's request: arm, disarm, stop. It is judged by the situation of the last
    /// cycle, and counts from the next cycle on. `named` is the veto that an arming names. Other
    /// actions do not concern the supervisor.
    pub fn request(&mut self, action: Action, named: u32) -> Outcome {
        match action {
            Action::Arm => return self.arm(named),
            Action::Disarm => {
                self.disarm(Hold::Operator);
                // After a stop it stays one.
                let stands = self.veto.and_then(|veto| Action::of_veto(veto.name));
                self.forbid(stands == Some(Action::Stop));
            }
            Action::Stop => {
                self.mode = Mode::Disarmed(Hold::Operator);
                self.forbid(true);
            }
            Action::Status | Action::Strategy | Action::Record | Action::Recover => (),
        }
        Outcome::Done
    }

    /// What goes out in the cycle of `now_ns` (CLOCK_MONOTONIC): the law's decision, or another
    /// instead.
    pub fn supervise(&mut self, situation: &Situation, now_ns: u64) -> Decision {
        let elapsed_ns = match self.last.replace(now_ns) {
            // After the clock went back, the time that passed is unknown: brake in one step.
            Some(last) if now_ns < last => u64::MAX,
            Some(last) => now_ns - last,
            None => 0,
        };
        self.count(situation);
        let hold = self.gravest(situation, now_ns, elapsed_ns);
        // Features that the law cannot use for want of the arm's joints are lost for that cause.
        let is_over = self.has_waited(hold, now_ns) || self.is_lost(situation, now_ns);
        if let Some(hold) = hold {
            match self.response(hold) {
                Response::Stop => self.mode = Mode::Disarmed(hold),
                Response::Disarm => self.disarm(hold),
                Response::Wait if is_over => self.disarm(hold),
                Response::Wait => (),
            }
        }
        let decision = match (self.mode, hold) {
            (Mode::Armed, None) => self.ramped(&situation.decision, elapsed_ns),
            (Mode::Armed, Some(Hold::Arrived)) => {
                self.braked(Hold::Arrived, TwistState::Arrived, elapsed_ns)
            }
            (Mode::Armed, Some(hold)) => self.braked(hold, TwistState::Holding, elapsed_ns),
            (Mode::Disarming(hold), _) => self.braked(hold, TwistState::Disarmed, elapsed_ns),
            (Mode::Disarmed(hold), _) => Decision::still(hold, TwistState::Disarmed),
        };
        if decision.state == TwistState::Disarmed {
            self.mode = Mode::Disarmed(decision.hold.unwrap_or(Hold::NotArmed));
        }
        self.has_arrived |= decision.state == TwistState::Arrived
            && self.rules.after_arrival != AfterArrival::Follow;
        self.sent = decision;
        if let Some(veto) = &mut self.veto {
            veto.pass(now_ns);
        }
        self.situation = Some(*situation);
        decision
    }

    /// Whether it began armed and has waited for too long for camera and robot: they would set it
    /// in motion when no operator expects it any more.
    fn has_waited(&mut self, hold: Option<Hold>, now_ns: u64) -> bool {
        self.has_met |= hold.is_none_or(|hold| matches!(hold, Hold::NoWay | Hold::Unwanted));
        let since = *self.waits_since.get_or_insert(now_ns);
        !self.has_met && now_ns.saturating_sub(since) > PEERS_NS
    }

    /// Until somebody arms who names it.
    fn forbid(&mut self, is_stop: bool) {
        self.veto = Veto::named(self.names.next(is_stop));
    }

    fn arm(&mut self, named: u32) -> Outcome {
        let Some(situation) = self.situation else {
            return Outcome::NoFeatures;
        };
        if situation.shutdown {
            return Outcome::Shutdown;
        }
        match self.mode {
            Mode::Armed => {
                (self.has_consent, self.has_arrived) = (true, false);
                return Outcome::Done;
            }
            Mode::Disarming(_) => return Outcome::Braking,
            Mode::Disarmed(_) => (),
        }
        if let Some(veto) = self.veto {
            let is_live = self.rules.lost_ns.is_some();
            if veto.name != named {
                return Outcome::Vetoed;
            }
            // Its zero goes out before anything moves again.
            if veto.is_fresh(self.last.unwrap_or(0), is_live) {
                return Outcome::Braking;
            }
        }
        match situation.robot {
            None => (),
            Some(Hold::NoRobot) => return Outcome::NoRobot,
            Some(Hold::RobotLost) => return Outcome::RobotLost,
            Some(Hold::JointsNotFollowing) => return Outcome::JointsNotFollowing,
            Some(Hold::NotFollowed | Hold::RobotLate) => return Outcome::NotFollowed,
            Some(_) => return Outcome::RobotFault,
        }
        // Where no way is known, or no twist is wanted, it may be armed, and waits.
        match situation.decision.hold {
            None | Some(Hold::NoWay | Hold::Unwanted) => (),
            Some(Hold::NoJoints) => return Outcome::NoJoints,
            Some(_) => return Outcome::NoFeatures,
        }
        (self.overruns, self.failures) = (0, 0);
        (self.veto, self.has_arrived) = (None, false);
        (self.has_consent, self.has_met) = (true, true);
        self.mode = Mode::Armed;
        Outcome::Done
    }

    /// Disarms, or brakes to disarm. If it already is disarmed or on the way, the first hold
    /// stays.
    fn disarm(&mut self, hold: Hold) {
        if self.mode == Mode::Armed {
            self.mode = Mode::Disarming(hold);
        }
    }

    fn count(&mut self, situation: &Situation) {
        self.overruns = match situation.missed {
            0 => self.overruns.saturating_sub(1),
            _ => self.overruns.saturating_add(OVERRUN),
        };
        self.failures = in_a_row(self.failures, situation.solver_failed);
    }

    /// The present response to a hold: a failed solver is given a few cycles to recover.
    fn response(&self, hold: Hold) -> Response {
        match hold {
            Hold::Solver if self.failures < IN_A_ROW => Response::Wait,
            Hold::Arrived if self.rules.after_arrival == AfterArrival::Hold => Response::Wait,
            _ => response(hold),
        }
    }

    /// Whether the law could use no features for too long.
    fn is_lost(&self, situation: &Situation, now_ns: u64) -> bool {
        let since = situation.good_ns.zip(self.rules.lost_ns);
        since.is_some_and(|(since, limit)| now_ns.saturating_sub(since) > limit)
    }

    /// The gravest hold on the law's twist.
    fn gravest(&self, situation: &Situation, now_ns: u64, elapsed_ns: u64) -> Option<Hold> {
        let decided = situation.decision.hold;
        let stood_still = self.rules.lost_ns.is_some_and(|limit| elapsed_ns > limit);
        let is_robot = |hold| situation.robot == Some(hold);
        let is_decided = |hold| decided == Some(hold);
        // The order of this list is the order of gravity.
        [
            (is_robot(Hold::RobotFault), Hold::RobotFault),
            (
                is_decided(Hold::Clock) || elapsed_ns == u64::MAX,
                Hold::Clock,
            ),
            (stood_still || situation.suspended, Hold::Standstill),
            (situation.shutdown, Hold::Shutdown),
            (is_robot(Hold::RobotLost), Hold::RobotLost),
            (is_robot(Hold::NotFollowed), Hold::NotFollowed),
            (is_robot(Hold::JointsNotFollowing), Hold::JointsNotFollowing),
            (is_robot(Hold::RobotLate), Hold::RobotLate),
            (self.overruns >= OVERRUN * IN_A_ROW, Hold::Overruns),
            (is_decided(Hold::BadTwist), Hold::BadTwist),
            (self.failures >= IN_A_ROW, Hold::Solver),
            (is_decided(Hold::Frozen), Hold::Frozen),
            (is_decided(Hold::NotFollowing), Hold::NotFollowing),
            (is_decided(Hold::ImageExceeds), Hold::ImageExceeds),
            (is_decided(Hold::ImageLate), Hold::ImageLate),
            (
                self.is_lost(situation, now_ns) && !is_decided(Hold::NoJoints),
                Hold::Lost,
            ),
            (is_robot(Hold::NoRobot), Hold::NoRobot),
            (self.has_arrived, Hold::Arrived),
        ]
        .into_iter()
        .find_map(|(is_present, hold)| is_present.then_some(hold))
        .or(decided)
    }

    /// The law's decision; after anything else its twist grows as a whole, so that the camera stays
    /// on the path that the law has looked at.
    fn ramped(&mut self, decision: &Decision, elapsed_ns: u64) -> Decision {
        self.is_ramping |= self.sent.hold.is_some() || !self.may_follow(&decision.twist);
        let share = match self.rules.change.iter().all(|c| c.is_finite()) {
            // The law keeps to them by itself; but what it decided before it was held stands still.
            true if self.may_follow(&decision.twist) => 1.0,
            true => self.share_by_change(&decision.twist),
            false if self.rules.ramp_ns == 0 => 1.0,
            false => {
                let step = elapsed_ns as f64 / self.rules.ramp_ns as f64;
                (self.speed(&self.sent.twist) + step) / self.speed(&decision.twist)
            }
        };
        // Also where the law asks for zero.
        if !self.is_ramping || share.is_nan() || share >= 1.0 {
            self.is_ramping = false;
            return *decision;
        }
        let twist = decision.twist.map(|v| v * share);
        match self.may_follow(&twist) {
            true => Decision { twist, ..*decision },
            false => self.braked(Hold::Stale, TwistState::Holding, elapsed_ns),
        }
    }

    /// Whether a twist is no further from the last one than a cycle's change.
    fn may_follow(&self, twist: &[f64; 6]) -> bool {
        let pairs = core::iter::zip(twist, self.sent.twist).zip(self.rules.change);
        let mut each = pairs.map(|((v, sent), most)| (v - sent).abs() <= most * (1.0 + ROUNDING));
        each.all(|is_within| is_within)
    }

    /// The largest share of a twist to which no component has to grow by more than a cycle's
    /// change.
    fn share_by_change(&self, twist: &[f64; 6]) -> f64 {
        let pairs = core::iter::zip(twist, self.sent.twist).zip(self.rules.change);
        let each = pairs.map(|((v, sent), most)| (sent * v.signum() + most) / v.abs());
        each.fold(1.0, f64::min).max(0.0)
    }

    /// Largest component of a twist as a share of its limit.
    fn speed(&self, twist: &[f64; 6]) -> f64 {
        let shares = twist.iter().zip(self.rules.limits);
        let shares = shares.map(|(v, limit)| v.abs() / limit);
        shares.fold(0.0, f64::max)
    }

    /// One step of braking: the twist shrinks as a whole, so that the camera stays on its path, at
    /// a rate that takes one at the limits to zero in the braking time, but by no more than a
    /// cycle's change. At zero the state is `after`.
    fn braked(&self, hold: Hold, after: TwistState, elapsed_ns: u64) -> Decision {
        let speed = self.speed(&self.sent.twist);
        let slower = match self.rules.brake_ns {
            0 => 0.0,
            brake_ns => speed - elapsed_ns as f64 / brake_ns as f64,
        };
        let stop_cycles = self.rules.stop_cycles(&self.sent.twist).max(1.0);
        let slower = slower.max(speed * (1.0 - 1.0 / stop_cycles));
        // Also where the last twist was zero, and for a NaN.
        if slower.is_nan() || slower <= 0.0 {
            return Decision::still(hold, after);
        }
        Decision {
            twist: self.sent.twist.map(|v| v * (slower / speed)),
            elbow: 0.0,
            state: TwistState::Braking,
            hold: Some(hold),
        }
    }
}

/// The number of failures in a row after one more cycle. `None`: the cycle does not say whether it
/// failed, and the number stays.
fn in_a_row(before: u32, failed: Option<bool>) -> u32 {
    match failed {
        Some(true) => before.saturating_add(1),
        Some(false) => 0,
        None => before,
    }
}

/// The response to a hold that lasts.
fn response(hold: Hold) -> Response {
    match hold {
        Hold::RobotFault | Hold::Clock | Hold::Standstill => Response::Stop,
        Hold::Shutdown
        | Hold::Operator
        | Hold::NotArmed
        | Hold::Unclean
        | Hold::RobotLost
        | Hold::NotFollowed
        | Hold::JointsNotFollowing
        | Hold::RobotLate
        | Hold::Overruns
        | Hold::BadTwist
        | Hold::Solver
        | Hold::Frozen
        | Hold::NotFollowing
        | Hold::ImageExceeds
        | Hold::ImageLate
        | Hold::Lost
        | Hold::Arrived => Response::Disarm,
        Hold::NoRobot
        | Hold::NoFeatures
        | Hold::Stale
        | Hold::Invalid
        | Hold::Hidden
        | Hold::Count
        | Hold::NotFinite
        | Hold::OffImage
        | Hold::Transport
        | Hold::Mixed
        | Hold::Elsewhere
        | Hold::Order
        | Hold::NoJoints
        | Hold::NoWay
        | Hold::Unwanted => Response::Wait,
    }
}

#[cfg(test)]
mod tests;
