//! The guide: the sub-goals that the law tracks on the way to the goal.

use ::arm::Joints;
use serde::{Deserialize, Serialize};

use crate::features::{self, PlainPoints};
use crate::joint_path::JointPath;
use crate::motion::Motion;
use crate::task::Task;
use crate::way::{self, COMMANDS, Placed, Way};
use crate::{Points, Twist};

/// Most sub-goals of a guide.
pub const MOST: usize = 2;
/// Most steps for which a sub-goal is tracked.
const LENGTH: f64 = 25.0;
/// Steps without progress after which a sub-goal is given up.
const BLOCKED: f64 = 3.0;
/// The same two of a place of a path in the joints.
const PLACE_LENGTH: f64 = 100.0;
const PLACE_BLOCKED: f64 = 20.0;
/// A place is passed at this distance, the last one at the next, px.
const PASSED_PX: f64 = 10.0;
const LAST_PX: f64 = 0.5;
/// Pixels that 1 rad or m of a joint counts as.
const JOINT_PX: f64 = 200.0;
/// Rounding of a sum of shares of steps.
const ROUNDING: f64 = 1e-6;
/// Decrease of the distance to the sub-goal that is progress, px.
const PROGRESS_PX: f64 = 3.0;

/// Where a sub-goal comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kind {
    /// There is no sub-goal: the law tracks the goal itself.
    Goal,
    /// The features of a stored sample, or of two.
    Sample,
    /// The present features, moved a little.
    Aside,
    /// The way point of the nearest sample.
    Neighbour,
    /// The way point that the Gaussian process infers.
    Regression,
    /// The places of a [path in the joints](crate::joint_path).
    Joints,
    /// The commands of a [refined way](crate::way).
    Refined,
}

impl Kind {
    /// Whether the sub-goals are the memory's.
    pub fn is_remembered(self) -> bool {
        matches!(self, Self::Sample | Self::Neighbour | Self::Regression)
    }
}

/// Where the law or one of its futures is.
pub(crate) struct At<'a> {
    pub task: &'a Task,
    /// The features, px.
    pub points: &'a [[f64; 2]],
    /// The joints of the arm, where it is known.
    pub q: Option<&'a Joints>,
    /// The path in the joints that was found last.
    pub path: &'a JointPath,
}

/// Sub-goals, one after the other, each until it is reached or given up; then the goal. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Guide {
    /// Where the sub-goals come from.
    pub kind: Kind,
    /// The sub-goals, the last first.
    pub targets: [PlainPoints; MOST],
    /// Sub-goals ahead, including the tracked one.
    pub ahead: u32,
    /// Steps for which the present sub-goal may still be tracked.
    pub left: f64,
    /// Least distance to the present sub-goal so far (largest component), px.
    pub least_px: f64,
    /// Steps without progress.
    pub idle: f64,
    /// Whether the way may lead behind a crossable occlusion.
    pub crosses: bool,
    /// Which refined way it is, else 0.
    pub way: u32,
    /// Where the pattern should be on a refined way.
    pub reference: Placed,
}

impl Guide {
    /// Straight to the goal.
    pub const GOAL: Self = Self {
        kind: Kind::Goal,
        targets: [PlainPoints::NONE; MOST],
        ahead: 0,
        left: 0.0,
        least_px: f64::INFINITY,
        idle: 0.0,
        crosses: false,
        way: 0,
        reference: Placed::ORIGIN,
    };

    /// Straight to the goal, by a way that may cross.
    pub const ACROSS: Self = Self {
        crosses: true,
        ..Self::GOAL
    };

    /// What is left of this guide without its sub-goals.
    pub fn direct(self) -> Self {
        match self.crosses {
            true => Self::ACROSS,
            false => Self::GOAL,
        }
    }

    /// This guide with a sub-goal before it; it must have room for one more.
    pub fn after(mut self, kind: Kind, target: &[[f64; 2]]) -> Self {
        if let Some(place) = self.targets.get_mut(self.ahead as usize) {
            *place = target.into();
            self.ahead += 1;
        }
        Self {
            kind,
            left: LENGTH,
            least_px: f64::INFINITY,
            idle: 0.0,
            ..self
        }
    }

    /// A guide along a path in the joints.
    pub fn along(path: &JointPath) -> Self {
        Self {
            kind: Kind::Joints,
            ahead: path.count,
            left: PLACE_LENGTH,
            ..Self::GOAL
        }
    }

    /// A guide along a refined way that begins with the pattern at `start`.
    pub(crate) fn refined(way: &Way, start: &Motion) -> Self {
        Self {
            kind: Kind::Refined,
            ahead: COMMANDS as u32,
            left: 1.0,
            way: way.number,
            reference: start.into(),
            ..Self::GOAL
        }
    }

    /// The twist that follows a refined way for the next `steps` steps (one at most), where the
    /// pattern moves by itself at `drift`; `None` for other guides, and at the way's end.
    pub(crate) fn follow(
        &mut self,
        at: &At,
        way: &Way,
        drift: &Twist,
        steps: f64,
    ) -> Option<Twist> {
        if self.kind != Kind::Refined {
            return None;
        }
        let command = way.left(self.ahead).first();
        let Some(command) = command.filter(|_| self.way == way.number) else {
            *self = self.direct();
            return None;
        };
        let reference = Motion::from(&self.reference);
        let mut wanted = way::correction(at.task, &reference, at.points)?;
        let terms = wanted.iter_mut().zip(command.iter().zip(drift));
        terms.for_each(|(v, (command, drift))| *v += command + drift);
        self.go_on(at.task, way, steps);
        Some(wanted)
    }

    /// Goes on along a refined way by `steps` steps, one at most. Another guide stays.
    pub(crate) fn go_on(&mut self, task: &Task, way: &Way, steps: f64) {
        let command = way.left(self.ahead).first();
        let is_along = self.kind == Kind::Refined && self.way == way.number;
        let Some(command) = command.filter(|_| is_along) else {
            return;
        };
        let passed = Motion::of_camera(command, steps * task.ts);
        self.reference = (&Motion::from(&self.reference).then(&passed)).into();
        self.left -= steps;
        if self.left <= ROUNDING {
            (self.left, self.ahead) = (self.left + 1.0, self.ahead - 1);
        }
    }

    /// The posture of the present sub-goal, where it has one.
    pub(crate) fn posture(&self, path: &JointPath) -> Option<Joints> {
        path.posture(self.ahead)
            .filter(|_| self.kind == Kind::Joints)
    }

    /// The present sub-goal, and how far it is away, px.
    fn target(&self, at: &At) -> Option<(Points, f64)> {
        if self.kind == Kind::Refined {
            return None;
        }
        if self.kind != Kind::Joints {
            let target = self
                .targets
                .get(self.ahead.checked_sub(1)? as usize)?
                .get()?;
            let away_px = features::largest_error(at.points, &target);
            return Some((target, away_px));
        }
        let (target, posture) = at.path.target(at.task, self.ahead)?;
        let way = at.task.arm.as_ref()?.limits.way(at.q?, &posture);
        Some((target, JOINT_PX * way.amax()))
    }

    /// The target of the next `steps` steps (less than one in a cycle); `None` for the goal.
    pub(crate) fn advance(&mut self, at: &At, reached_px: f64, steps: f64) -> Option<Points> {
        let (length, blocked) = match self.kind {
            Kind::Joints => (PLACE_LENGTH, PLACE_BLOCKED),
            _ => (LENGTH, BLOCKED),
        };
        loop {
            let ahead = self.ahead.checked_sub(1)?;
            let passed_px = match (self.kind, ahead) {
                (Kind::Joints, 0) => LAST_PX,
                (Kind::Joints, _) => PASSED_PX,
                _ => reached_px,
            };
            let (target, away_px) = self.target(at)?;
            if away_px < self.least_px - PROGRESS_PX {
                (self.least_px, self.idle) = (away_px, 0.0);
            } else {
                self.idle += steps;
            }
            let is_blocked = self.idle > blocked + ROUNDING;
            if away_px >= passed_px && !is_blocked && self.left > ROUNDING {
                self.left -= steps;
                return Some(target);
            }
            (self.ahead, self.left) = (ahead, length);
            (self.least_px, self.idle) = (f64::INFINITY, 0.0);
            if ahead == 0 {
                *self = self.direct();
            }
        }
    }
}
