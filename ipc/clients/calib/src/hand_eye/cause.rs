//! What is wrong with poses, as far as they tell: one of them, a board that was moved, its size,
//! the focal length, or how well images show it.
//!
//! Each cause is a change of the model with parameters of its own. It is named if it explains more
//! than chance would (F test). An error of the principal point is no cause: the mounting turns with
//! it, and nothing is left to see. Nor are the arm's lengths: their ratio to the board's size is
//! all that motions show.

use vision_calibration_core::Vec3;

use super::poses::{Change, Poses};
use crate::pose_fit::{COUNT, Fit};

/// F from which on a change with one parameter, or one with six, is no chance: below 1 in 1000
/// where 40 numbers are left.
const CHANCE: [f64; 2] = [15.0, 5.5];
/// Of two changes with as many parameters, both are named if their sums of squares are this near.
const AS_LIKELY: f64 = 4.0;
/// The logarithm of a ratio of two variances is no chance from so many standard deviations on.
const RATIO: f64 = 2.5;

/// The target's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Of what was believed.
    pub size: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// What explains the misses.
#[derive(Clone, Debug, PartialEq)]
pub struct Cause {
    /// What it is.
    pub reason: Reason,
    /// What poses miss by without it and with it: as [`super::HandEye::robot`], m and rad.
    pub sigma: [[f64; 2]; 2],
}

/// A cause.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// One pose disagrees with all others.
    Pose {
        /// The image's name.
        name: String,
        /// By so much, m and rad.
        off: [f64; 2],
    },
    /// The board was moved.
    Moved {
        /// The image's name before which it was.
        name: String,
        /// By so much, m and rad.
        off: [f64; 2],
    },
    /// Sizes, of what was believed: of the board, of the focal length, or either of them.
    Size {
        /// Of the board.
        board: Option<f64>,
        /// Of the focal length.
        focal: Option<f64>,
    },
}

/// A change that was tried.
struct Trial {
    change: Change,
    fit: Fit,
    /// Of 1: no chance.
    score: f64,
}

fn freedom(fit: &Fit) -> f64 {
    fit.numbers.saturating_sub(COUNT + fit.state.extra.len()) as f64
}

fn trial(poses: &Poses, fit: &Fit, change: Change) -> Option<Trial> {
    let changed = poses.with(change, fit, Some(fit.sigma))?;
    let spent = freedom(fit) - freedom(&changed);
    let left = changed.squares / freedom(&changed).max(1.0);
    let gained = (fit.squares - changed.squares) / spent.max(1.0);
    let chance = CHANCE[usize::from(spent > 1.0)];
    Some(Trial {
        change,
        fit: changed,
        score: gained / left.max(f64::MIN_POSITIVE) / chance,
    })
}

/// The size of the target, with its deviation.
pub(super) fn scale(poses: &Poses, fit: &Fit) -> Option<Scale> {
    let changed = poses.with(Change::Size, fit, None)?;
    Some(Scale {
        size: 1.0 + changed.state.extra[0],
        sigma: changed.covariance[(COUNT, COUNT)].sqrt(),
    })
}

/// The change that explains most, if it is no chance.
pub(super) fn find(poses: &Poses, fit: &Fit) -> Option<Cause> {
    let count = poses.seen.len();
    let changes = [Change::Size, Change::Focal].into_iter();
    let changes = changes.chain((0..count).map(Change::Without));
    let changes = changes.chain((2..count - 1).map(Change::Moved));
    let trials = changes.filter_map(|change| trial(poses, fit, change));
    let trials: Vec<Trial> = trials.collect();
    let best = trials
        .iter()
        .filter(|trial| trial.score > 1.0)
        .max_by(|a, b| a.score.total_cmp(&b.score))?;
    let left = |trial: &Trial| trial.fit.squares / freedom(&trial.fit).max(1.0);
    let off = |[moved, turned]: [Vec3; 2]| [moved.norm(), turned.norm()];
    let reason = match best.change {
        Change::Size | Change::Focal => {
            let most = best.fit.squares + AS_LIKELY * left(best);
            let share = |change: Change| {
                let other = trials.iter().find(|trial| trial.change == change)?;
                let changed = poses.with(change, fit, None)?;
                (other.fit.squares <= most).then(|| 1.0 + changed.state.extra[0])
            };
            Reason::Size {
                board: share(Change::Size),
                focal: share(Change::Focal),
            }
        }
        Change::Moved(first) => {
            let [x, y, z, a, b, c] = *best.fit.state.extra.as_slice() else {
                return None;
            };
            Reason::Moved {
                name: poses.names[first].clone(),
                off: off([Vec3::new(x, y, z), Vec3::new(a, b, c)]),
            }
        }
        Change::Without(one) => {
            let state = &best.fit.state;
            let seen = poses.robots[one] * state.mount * poses.seen[one];
            let miss = state.target.inverse() * seen;
            Reason::Pose {
                name: poses.names[one].clone(),
                off: off([miss.translation.vector, miss.rotation.scaled_axis()]),
            }
        }
    };
    let with = poses.with(best.change, fit, None)?;
    Some(Cause {
        reason,
        sigma: [fit.sigma, with.sigma],
    })
}

/// Which way poses miss, in the camera: the robot knows no difference between the camera's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// RMS of turns of the board about an axis across the view, and about the optical axis, rad.
    pub turn: [f64; 2],
    /// RMS of shifts along the optical axis, and along one across it, m.
    pub shift: [f64; 2],
    /// Shares of numbers that are left to tell.
    left: f64,
}

pub(super) fn spread(poses: &Poses, fit: &Fit) -> Spread {
    let mut squares = [Vec3::zeros(); 2];
    let mut count = 0.0;
    for (seen, miss) in poses.seen.iter().zip(&fit.misses) {
        let Some(miss) = miss else { continue };
        for (sum, part) in squares.iter_mut().zip(miss) {
            *sum += (seen.rotation * part).map(|x| x * x);
        }
        count += 1.0;
    }
    let rms = |square: f64| (square / f64::max(count, 1.0)).sqrt();
    let [shift, turn] = squares;
    let across = |square: Vec3| rms(0.5 * (square.x + square.y));
    Spread {
        turn: [across(turn), rms(turn.z)],
        shift: [rms(shift.z), across(shift)],
        left: freedom(fit) / 6.0,
    }
}

impl Spread {
    /// Whether the first is larger than the second by more than chance, where their squares are
    /// means of so many numbers a pose.
    fn is_larger(&self, [first, second]: [f64; 2], numbers: [f64; 2]) -> bool {
        let deviation = numbers.map(|k| 2.0 / (k * self.left).max(1.0));
        let ratio = 2.0 * (first / second.max(f64::MIN_POSITIVE)).ln();
        ratio > RATIO * (deviation[0] + deviation[1]).sqrt()
    }

    /// Whether boards are turned wrongly as images show them wrongly, not as arms err.
    pub fn is_tilt(&self) -> bool {
        self.is_larger(self.turn, [2.0, 1.0])
    }

    /// Whether they are at wrong distances as images show them.
    pub fn is_depth(&self) -> bool {
        self.is_larger(self.shift, [1.0, 2.0])
    }
}
