//! Whether the joints that the robot tells can be its own. Pure; times are arguments.
//!
//! A posture is judged by itself, by the one before it, and by the camera's motion since: that by
//! the joints and the arm's kinematics against the twist that the robot reports. Motions of the
//! elbow alone move no camera, and count in no sum.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | q, v | `Told` | joints, and the camera's twist along its axes, of one message |
//! | J dq | `step` | the camera's way from one message to the next by the joints |
//! | e = sum (J dq - v dt) | `apart` | difference of both motions, m and rad |
//! | p = sum abs(v) dt | `path` | length of the reported one |
//! | m | `speed` | the greatest that was reported or commanded |
//! | T | `MEMORY_S` | time constant by which e, p and m fade |
//!
//! Joints follow while abs(e) <= `NOISE` + `SHARE` p + `LATE_S` m, translation and rotation each.
//! Joints that stand while the camera moves are found when their part of the way is
//! more than that: from rest after 0.3 s, on a steady way after (`SHARE` T + `LATE_S`), 0.6 s, and
//! longer at less than five times the least speed, `NOISE` / T.

use arm::{Arm, JOINTS, Joints, Limits};
use messages::{FUTURE_NS, Hold, JointFault, JointFaultCode, RobotMode, RobotState};
use serde::{Deserialize, Serialize};

use crate::contract;
use crate::rules::Rules;

/// How far outside its range a joint may be told, rad or m: zero points and ranges of a data sheet
/// differ from those of a controller by some hundredths, and the law keeps a margin of 0.2. Another
/// unit, turn or arm is off by more.
const BEYOND: f64 = 0.05;
/// Farthest position of a joint that turns without end, rad: more turns than an arm makes, and few
/// enough to tell hundredths of one.
const FARTHEST: f64 = 1e6;
/// A joint leaps where it moves by more than this multiple of its greatest speed, and this much
/// more, rad or m: for messages whose instants are a few milliseconds wrong.
const FASTER: f64 = 2.0;
const LEAP: f64 = 0.05;
/// Time between two messages after which nothing is compared, ns: a posture as old is unknown.
const GAP_NS: u64 = 500_000_000;

/// Time in which the sums fade, s.
const MEMORY_S: f64 = 2.0;
/// Share of the way by which both motions may differ: a robot that carries out nine tenths of what
/// it reports, and a camera mounted 5 degrees otherwise than the arm file says.
const SHARE: f64 = 0.2;
/// Time by which the joints may be later or earlier than the twist, s.
const LATE_S: f64 = 0.2;
/// Lever at which a rotation counts as a translation, m: with [`SHARE`] that of a camera mounted
/// 5 cm from where the arm file says.
const LEVER: f64 = 0.25;
/// Difference by noise and by the steps of coarse encoders, m and rad.
const NOISE: [f64; 2] = [0.005, 0.01];

/// What a message tells. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Told {
    q: [f64; JOINTS],
    twist: [f64; 6],
    /// On the clock of the exposures, ns.
    at_ns: u64,
}

/// What the joints of the robot's messages have said so far. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointWatch {
    /// Whether time is real; in lockstep neither instants nor motions are compared.
    is_live: bool,
    last: Option<Told>,
    apart: [f64; 6],
    path: [f64; 2],
    speed: [f64; 2],
    /// Why the last posture cannot be used.
    refused: Option<JointFault>,
    /// Whether the last posture that can be used does not follow from those before, and what was
    /// wrong when that last was so.
    strays: bool,
    strayed: Option<JointFault>,
}

impl JointWatch {
    /// A watch by these rules, before the first message.
    pub fn new(rules: &Rules) -> Self {
        Self {
            is_live: rules.valid_ns.is_some(),
            last: None,
            apart: [0.0; 6],
            path: [0.0; 2],
            speed: [0.0; 2],
            refused: None,
            strays: false,
            strayed: None,
        }
    }

    /// Takes a message that was received by `now_ns` (CLOCK_MONOTONIC). The instant of its joints,
    /// ns, or `None` where they cannot be used: of another number than the arm's, from the future,
    /// or out of range.
    pub fn look(&mut self, arm: &Arm, state: &RobotState, now_ns: u64) -> Option<u64> {
        let count = arm.chain.count();
        let q = state.q.get(..state.joints as usize);
        let told = Told {
            q: arm::joints(q.unwrap_or_default()).into(),
            twist: state.twist,
            at_ns: contract::exposed_ns(&state.stamp),
        };
        self.refused = None;
        if state.joints as usize != count {
            return None;
        }
        let future = self
            .is_live
            .then(|| from_future(told.at_ns, now_ns))
            .flatten();
        self.refused = future.or_else(|| out_of_range(&arm.limits, count, &told.q));
        if self.refused.is_some() {
            return None;
        }
        // An idle robot may be moved by hand, and tells of no twist then.
        match self.is_live && state.mode() != Some(RobotMode::Idle) {
            true => self.compare(arm, &told),
            false => self.begin(&told),
        }
        Some(told.at_ns)
    }

    /// Notes what was commanded, which joints may follow sooner than the twist that is reported.
    pub fn sent(&mut self, twist: &[f64; 6]) {
        let pairs = self.speed.iter_mut().zip(speeds(twist));
        pairs.for_each(|(speed, commanded)| *speed = speed.max(commanded));
    }

    /// What is wrong with the joints of the last message; where the camera is held because they do
    /// not follow, what was wrong with them.
    pub fn fault(&self, hold: Option<Hold>) -> Option<JointFault> {
        let is_held = hold == Some(Hold::JointsNotFollowing);
        let strayed = self.strayed.filter(|_| is_held || self.strays);
        self.refused.filter(|_| !is_held).or(strayed)
    }

    /// [`Hold::JointsNotFollowing`], where the joints leap or do not move as the robot reports that
    /// the camera does.
    pub fn hold(&self) -> Option<Hold> {
        self.strays.then_some(Hold::JointsNotFollowing)
    }

    /// Begins to compare with this message.
    fn begin(&mut self, told: &Told) {
        *self = Self {
            is_live: self.is_live,
            last: Some(*told),
            apart: [0.0; 6],
            path: [0.0; 2],
            speed: [0.0; 2],
            refused: None,
            strays: false,
            strayed: self.strayed,
        };
    }

    fn compare(&mut self, arm: &Arm, told: &Told) {
        let Some(before) = self.last else {
            return self.begin(told);
        };
        let since_ns = told.at_ns.abs_diff(before.at_ns);
        if since_ns > GAP_NS {
            return self.begin(told);
        }
        let seconds = since_ns as f64 * 1e-9;
        let way = arm.limits.way(&before.q.into(), &told.q.into());
        let leap = leap(&arm.limits, &way, seconds);
        // The same joints with another twist, or older ones, tell of no motion.
        if told.at_ns > before.at_ns {
            self.last = Some(*told);
            if leap.is_none() {
                self.add(arm, &before, told, &way, seconds);
            }
        }
        let fault = leap.or_else(|| self.judge());
        (self.strays, self.strayed) = (fault.is_some(), fault.or(self.strayed));
    }

    /// Adds the motion from one message to the next.
    fn add(&mut self, arm: &Arm, before: &Told, told: &Told, way: &Joints, seconds: f64) {
        let keeps = 1.0 / (1.0 + seconds / MEMORY_S);
        let middle = Joints::from(before.q) + way * 0.5;
        let step = arm.camera_twist(&middle, way);
        let ends = before.twist.iter().zip(&told.twist);
        let sums = self.apart.iter_mut().zip(step.iter().zip(ends));
        sums.for_each(|(apart, (step, (from, to)))| {
            *apart = keeps * *apart + step - 0.5 * (from + to) * seconds;
        });
        let [from, to] = [before, told].map(|told| speeds(&told.twist));
        for k in 0..2 {
            self.path[k] = keeps * self.path[k] + 0.5 * (from[k] + to[k]) * seconds;
            self.speed[k] = (keeps * self.speed[k]).max(to[k]);
        }
    }

    /// How far apart both motions are, and may be: translation, m, and rotation, rad.
    fn distances(&self) -> [[f64; 2]; 2] {
        let found = lengths(&self.apart);
        core::array::from_fn(|k| {
            let most = NOISE[k] + SHARE * self.path[k] + LATE_S * self.speed[k];
            [found[k], most]
        })
    }

    /// Whether both motions are further apart than they may be.
    fn judge(&self) -> Option<JointFault> {
        let codes = [JointFaultCode::Translation, JointFaultCode::Rotation];
        let mut all = codes.into_iter().zip(self.distances());
        // A NaN is too far.
        let (code, [found, most]) =
            all.find(|(_, [found, most])| found.is_nan() || found > most)?;
        Some(JointFault {
            code,
            joint: 0,
            found,
            allowed: [0.0, most],
        })
    }
}

/// The speeds of a twist, m/s and rad/s, with what the lever adds to the first.
fn speeds(twist: &[f64; 6]) -> [f64; 2] {
    let [linear, angular] = lengths(twist);
    [linear + LEVER * angular, angular]
}

/// The lengths of the linear and of the angular part.
fn lengths(twist: &[f64; 6]) -> [f64; 2] {
    let [x, y, z, a, b, c] = *twist;
    [[x, y, z], [a, b, c]].map(|part| libm::sqrt(part.iter().map(|v| v * v).sum()))
}

fn from_future(at_ns: u64, now_ns: u64) -> Option<JointFault> {
    let ahead_ns = at_ns.saturating_sub(now_ns);
    (ahead_ns > FUTURE_NS).then_some(JointFault {
        code: JointFaultCode::Future,
        joint: 0,
        found: ahead_ns as f64 * 1e-9,
        allowed: [0.0, FUTURE_NS as f64 * 1e-9],
    })
}

/// The first joint that is outside its range; a NaN is.
fn out_of_range(limits: &Limits, count: usize, q: &[f64; JOINTS]) -> Option<JointFault> {
    let mut joints = limits.0.iter().zip(q).take(count).zip(0..);
    joints.find_map(|((joint, q), index)| {
        let [least, most] = match joint.is_endless() {
            true => [-FARTHEST, FARTHEST],
            false => [joint.range[0] - BEYOND, joint.range[1] + BEYOND],
        };
        (!(least..=most).contains(q)).then_some(JointFault {
            code: JointFaultCode::Range,
            joint: index,
            found: *q,
            allowed: [least, most],
        })
    })
}

/// The first joint that is faster than it can be.
fn leap(limits: &Limits, way: &Joints, seconds: f64) -> Option<JointFault> {
    let mut joints = limits.0.iter().zip(way.iter()).zip(0..);
    joints.find_map(|((joint, way), index)| {
        let most = FASTER * joint.velocity * seconds + LEAP;
        (way.abs() > most).then_some(JointFault {
            code: JointFaultCode::Leap,
            joint: index,
            found: *way,
            allowed: [-most, most],
        })
    })
}

#[cfg(test)]
mod tests;
