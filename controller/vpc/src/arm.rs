//! The arm that carries the camera, as far as the law knows it: where its joints are, and the rows
//! that they give the optimal-control problem.
//!
//! The joints q are a part of the state; each step of a future moves them by the bridges' own
//! mapping. A row is a velocity damper ([`::arm::damper`]) on each free command: what is left
//! of a joint's range, of its speed, of the way to a wall, a singular posture, or of a link to what
//! it is near. So a simulated future goes no farther than the arm does, and one that would have to
//! does not arrive.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | q | [`Posture::q`] | joint positions, rad or m |
//! | g v <= b | `Bound` | a damper |
//! | n v = 0 | `Dampers::still` | a direction in which no joint moves the camera |
//! | c = P (b - g v) | [`Row`] | its clearance as the solver has it, px |

use ::arm::{Arm, Bound, Dampers, JOINTS, Joints};
pub use ::arm::{Cause, Other, Pair};
use serde::{Deserialize, Serialize};

use crate::row::Row;
use crate::{DOF, Twist};

/// A damper binds a command that leaves less than this share of what a twist at the scene's limits
/// would take of it. Commands that a damper stops leave at most 0.002, by the solver's accuracy,
/// and a camera that waits at a bound comes nearer without end; few others leave less than 0.02.
const NEAR: f64 = 0.01;

/// What an arm costs a command, ns (`cargo bench --bench steer`).
const ARM: u32 = 2600;
/// What its links' shapes cost it more, ns, and each pair of them.
const SHAPES: u32 = 600;
const PAIR: u32 = 20;

/// What an arm costs a command, [work](crate::work).
pub(crate) fn work_ns(arm: &Arm) -> u32 {
    ARM + match arm.shapes.pairs.len() as u32 {
        0 => 0,
        pairs => SHAPES + pairs * PAIR,
    }
}

/// Where an arm's joints were. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Posture {
    /// Base to flange, rad or m; further entries are zero.
    pub q: [f64; JOINTS],
    /// When, on the clock of the exposures, ns.
    pub at_ns: u64,
}

impl Posture {
    /// The posture of an arm with so many joints.
    pub fn new(q: &[f64], at_ns: u64) -> Self {
        let q = ::arm::joints(q).into();
        Self { q, at_ns }
    }
}

/// The joints after `seconds`, in which the camera moves at `twist` and the elbow at `elbow`,
/// rad/s.
pub(crate) fn moved(
    arm: Option<&Arm>,
    q: Option<&Joints>,
    twist: &Twist,
    elbow: f64,
    seconds: f64,
) -> Option<Joints> {
    Some(arm?.moved(q?, twist, elbow, seconds))
}

/// The camera's mean velocity while it is told to move at `twist` for `seconds`: `twist` itself,
/// unless the arm has fewer than six joints.
pub(crate) fn carried(arm: Option<&Arm>, q: Option<&Joints>, twist: &Twist, seconds: f64) -> Twist {
    let known = arm.zip(q);
    known.map_or(*twist, |(arm, q)| arm.carried(q, twist, seconds))
}

/// The rows of a command: its dampers, and n v <= 0 and -n v <= 0 for each n.
pub(crate) fn rows(dampers: &Dampers) -> impl Iterator<Item = Row> {
    let damped = dampers.bounds.iter().map(|bound| Row {
        gradient: bound.gradient,
        most: bound.most,
    });
    let both = |n: &[f64; DOF]| [*n, n.map(|x| -x)];
    let still = dampers.still.iter().flat_map(both);
    let most = 0.0;
    damped.chain(still.map(move |gradient| Row { gradient, most }))
}

/// What binds a command within these limits: the cause of the damper of which it leaves the least
/// share; `None` where it leaves enough of all.
pub(crate) fn cause(dampers: Option<&Dampers>, twist: &Twist, limits: &Twist) -> Option<Cause> {
    let left = |bound: &Bound| {
        let most = bound.gradient.iter().zip(limits);
        let most: f64 = most.map(|(g, limit)| (g * limit).abs()).sum();
        (bound.left(twist) / most, bound.cause)
    };
    let all = dampers?.bounds.iter().map(left);
    // A NaN, of a bound that no twist moves, is not near.
    let near = all.filter(|(share, _)| *share <= NEAR);
    let least = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(least.1)
}

/// The part of a command that its dampers allow, its direction kept as far as the joints go there.
pub(crate) fn within(dampers: Option<&Dampers>, twist: &Twist) -> Twist {
    let Some(dampers) = dampers else {
        return *twist;
    };
    let reached = dampers.reached(twist);
    let share = dampers.share(&reached);
    reached.map(|v| share * v)
}
