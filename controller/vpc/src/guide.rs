//! The guide: the sub-goals that the law tracks on the way to the goal.

use serde::{Deserialize, Serialize};

use crate::Points;
use crate::features::{self, PlainPoints};

/// Most sub-goals of a guide.
pub const MOST: usize = 2;
/// Most steps for which a sub-goal is tracked.
const LENGTH: f64 = 25.0;
/// Steps without progress after which a sub-goal is given up.
const BLOCKED: f64 = 3.0;
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
}

impl Kind {
    /// Whether the sub-goals are the memory's.
    pub fn is_remembered(self) -> bool {
        matches!(self, Self::Sample | Self::Neighbour | Self::Regression)
    }
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

    /// The target of the next `steps` steps (less than one in a cycle); `None` for the goal.
    pub fn advance(&mut self, points: &[[f64; 2]], reached_px: f64, steps: f64) -> Option<Points> {
        loop {
            let ahead = self.ahead.checked_sub(1)?;
            let target = self.targets.get(ahead as usize)?.get()?;
            let away_px = features::largest_error(points, &target);
            if away_px < self.least_px - PROGRESS_PX {
                (self.least_px, self.idle) = (away_px, 0.0);
            } else {
                self.idle += steps;
            }
            let is_blocked = self.idle > BLOCKED + ROUNDING;
            if away_px >= reached_px && !is_blocked && self.left > ROUNDING {
                self.left -= steps;
                return Some(target);
            }
            (self.ahead, self.left) = (ahead, LENGTH);
            (self.least_px, self.idle) = (f64::INFINITY, 0.0);
            if ahead == 0 {
                *self = self.direct();
            }
        }
    }
}
