//! What keeps a guarded camera in front of the pattern: seen from the side, its points come to lie
//! on a line, and no detector finds them.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | n | `normal` | the normal of the pattern's plane in the camera frame |
//! | x | `middle` | the mean of its points, m |
//! | s = n'x / abs(x) | `sine` | of the angle between the line of sight to it and the plane |
//! | d abs(s)/dt = g v | `slope` | v: the camera's velocity against the pattern |
//!
//! Turning the camera changes nothing: g has no such part. A pattern that may be mirrored in depth
//! about its middle has the same s, and the opposite g.

use ::arm::Dampers;
use nalgebra::Vector3;

use crate::Twist;
use crate::motion::Motion;
use crate::prediction::InitialState;
use crate::row::{Row, beyond_px};
use crate::task::Task;

/// The least sine: of 15 degrees.
const LEAST: f64 = 0.259;
/// Least time in which what is left of it may be used up, s, and in periods.
const LEAST_S: f64 = 0.15;
const PERIODS: f64 = 2.0;
/// Share of the camera's deceleration with which it nears that.
const SHARE: f64 = 0.5;
/// Two poses explain an image alike where the mean squares of their errors differ by less, px^2.
const ALIKE_PX2: f64 = 1.0;

/// How far a check of the next view may be off.
const TINY: f64 = 1e-3;

/// The pattern as a guarded camera sees it, where its pose is known.
#[derive(Clone, Copy, Debug)]
pub struct View {
    normal: Vector3<f64>,
    middle: Vector3<f64>,
    /// The motion of the pattern itself, as that of a camera.
    drift: Twist,
    /// Time for which a command is in force, s.
    period: f64,
    /// One for each pose that the pattern may have.
    rows: [Option<Row>; 2],
}

impl View {
    /// The view before a command, with the command in force.
    pub(crate) fn new(
        task: &Task,
        initial: &InitialState,
        standing: &Twist,
        dampers: Option<&Dampers>,
    ) -> Option<Self> {
        let (pose, tilt) = (initial.pose(task)?, initial.tilt.as_ref()?);
        let points = task.pattern.iter().map(|p| pose.apply(p));
        let mut view = Self {
            normal: pose.normal(),
            middle: points.sum::<Vector3<f64>>() / task.pattern.len() as f64,
            drift: initial.drift.twist,
            period: task.period,
            rows: [None; 2],
        };
        let [x, y, z, ..] = task.acceleration;
        let ramps = dampers.map_or(1.0, |dampers| dampers.ramps);
        // A camera that turns goes elsewhere than where it looks at first.
        let halfway = view.after(standing, 0.5 * task.period);
        let (slope, most) = halfway.bound(ramps * x.min(y).min(z));
        let [x, y, z, ..] = view.drift;
        let row = |slope: Vector3<f64>| Row {
            gradient: [-slope.x, -slope.y, -slope.z, 0.0, 0.0, 0.0],
            most: most - slope.dot(&Vector3::new(x, y, z)),
        };
        let is_alike = tilt.evidence * task.camera.fx * task.camera.fy < ALIKE_PX2;
        view.rows = [Some(row(slope)), is_alike.then(|| row(-slope))];
        Some(view)
    }

    /// The bounds on the command.
    pub(crate) fn rows(&self) -> impl Iterator<Item = Row> {
        self.rows.into_iter().flatten()
    }

    /// Whether a command is beyond the bounds by more than `slack`, px, or leads to the pattern's
    /// side at once; and further than braking does.
    pub(crate) fn is_left_by(&self, command: &Twist, braking: &Twist, slack: f64) -> bool {
        let [beyond, anyway] = [command, braking].map(|twist| beyond_px(self.rows(), twist));
        let [after, braked] = [command, braking].map(|twist| self.after(twist, self.period).sine());
        beyond > anyway.max(slack) || after.abs() < LEAST.min(braked.abs()) - TINY
    }

    /// The view after a camera at `twist` has moved for some seconds.
    fn after(&self, twist: &Twist, seconds: f64) -> Self {
        let mut relative = *twist;
        let pairs = relative.iter_mut().zip(&self.drift);
        pairs.for_each(|(v, own)| *v -= own);
        let motion = Motion::of_camera(&relative, seconds);
        Self {
            normal: motion.rotation * self.normal,
            middle: motion.apply(&self.middle),
            ..*self
        }
    }

    fn sine(&self) -> f64 {
        self.normal.dot(&self.middle) / self.middle.norm()
    }

    /// g, and how fast abs(s) may fall with such a deceleration, m/s^2.
    fn bound(&self, deceleration: f64) -> (Vector3<f64>, f64) {
        let (sine, away) = (self.sine(), self.middle.norm());
        let slope = (self.normal - self.middle * (sine / away)) * (-sine.signum() / away);
        let left = (sine.abs() - LEAST).max(0.0);
        let nearing = libm::sqrt(2.0 * SHARE * deceleration / away * left);
        // Without a limit of acceleration, 0 of it is no number: the other counts.
        let most = nearing.min(left / LEAST_S.max(PERIODS * self.period));
        (slope, most)
    }
}
