//! Blind: where the points are that an image does not show.
//!
//! The commands and the pattern's own motion carry the last pose on; the points that are seen
//! correct it, as far as they say more than the prediction. The points that are not seen are those
//! of the corrected pose.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | x, P | [`Drift::pose`] | the pose against the expected one, and its covariance |
//! | J | `rows` | derivative of a pixel by a small motion of the camera |
//!
//! The law goes on while three deviations of the worst point, sqrt(J P J'), are below what the gate
//! takes for a leap, and the budget of hidden time that the settings give is not spent. Images that
//! show all points refill it at half of their time: a point that is hidden in every third image is
//! served without end.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: from_fn gives indices inside the matrices"
)]

use serde::{Deserialize, Serialize};

use crate::drift::{Drift, Six, Square};
use crate::measurement::Measurement;
use crate::prediction::{InitialState, Model};
use crate::task::Task;
use crate::{MAX_POINTS, Points, camera, gate, interaction};

/// Deviations of a hidden point within which it must be known.
const SURE: f64 = 3.0;
/// Budget that an image with all points gives back, as a share of its time.
pub(crate) const REFILL: f64 = 0.5;
/// After the budget was spent the law waits until this share of it is back.
const RESUME: f64 = 0.1;
/// An image counts for so many periods at most when it refills the budget.
const MOST_PERIODS: f64 = 1.5;
/// Relative error of a sum of times.
const ROUNDING: f64 = 1e-6;
/// Gauss-Newton steps of a correction.
const STEPS: usize = 3;

/// How well the pose is known while points are hidden. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Blind {
    /// Hidden time that images with all points have not given back yet, s.
    pub spent_s: f64,
    /// Whether the budget was spent, and too little of it is back.
    pub is_spent: bool,
    /// The last exposure that was counted, ns; 0 before the first.
    counted_ns: u64,
    /// Deviation of the worst point, px; 0 where the last image showed all points.
    pub deviation_px: f64,
    /// Covariance of each point, uu uv vv, px^2; zero where the last image showed all points.
    pub ellipses: [[f32; 3]; MAX_POINTS],
}

impl Blind {
    /// Before the first image.
    pub const NEW: Self = Self {
        spent_s: 0.0,
        is_spent: false,
        counted_ns: 0,
        deviation_px: 0.0,
        ellipses: [[0.0; 3]; MAX_POINTS],
    };

    /// Counts an image of a camera with this period, s, against a budget of `most_s`.
    pub(crate) fn count(&mut self, measurement: &Measurement, period: f64, most_s: f64) {
        let exposed_ns = measurement.exposed_ns;
        let since_ns = match core::mem::replace(&mut self.counted_ns, exposed_ns) {
            0 => 0,
            before => exposed_ns.saturating_sub(before),
        };
        let since_s = since_ns as f64 * 1e-9;
        if measurement.is_whole() {
            let given_s = REFILL * since_s.min(MOST_PERIODS * period);
            self.spent_s = (self.spent_s - given_s).max(0.0);
            self.is_spent &= self.spent_s > (1.0 - RESUME) * most_s;
        } else {
            let spent_s = self.spent_s + since_s.max(f64::MIN_POSITIVE);
            self.is_spent |= spent_s > most_s * (1.0 + ROUNDING);
            self.spent_s = spent_s.min(most_s);
        }
    }

    /// After an image that shows all points.
    pub(crate) fn whole(self) -> Self {
        Self {
            deviation_px: 0.0,
            ellipses: [[0.0; 3]; MAX_POINTS],
            ..self
        }
    }

    fn keep(&mut self, task: &Task, at: &InitialState, covariance: &Square) {
        self.deviation_px = deviation_px(task, at, covariance);
        let mut rows = rows(task, at, &at.points).map(|(row, _)| row);
        for ellipse in &mut self.ellipses {
            let (Some(u), Some(v)) = (rows.next(), rows.next()) else {
                break;
            };
            let by = |a: &Six, b: &Six| a.dot(&(covariance * b));
            *ellipse = [by(&u, &u), by(&u, &v), by(&v, &v)].map(|x| x as f32);
        }
    }

    /// The points of an image that shows some, or none, where `expected` is the prediction for it.
    pub(crate) fn complete(
        &mut self,
        task: &Task,
        model: Model,
        expected: &InitialState,
        measurement: &Measurement,
        (pose, covariance): (Six, Square),
        noise: f64,
    ) -> Option<Points> {
        let still = expected.clone().without_drift();
        let mut refined = still.moved(task, model, &pose.into(), 1.0)?;
        self.keep(task, &refined, &covariance);
        if measurement.visible != 0 {
            let prior = covariance.try_inverse()?;
            let mut moved = pose;
            let mut information = prior;
            for _ in 0..STEPS {
                information = prior;
                let mut right = prior * (pose - moved);
                let seen = rows(task, &refined, &measurement.points).enumerate();
                for (_, (row, error)) in seen.filter(|(k, _)| measurement.sees(k / 2)) {
                    information += row * row.transpose() / noise;
                    right += row * (error / noise);
                }
                let step = information.cholesky()?.solve(&right);
                refined = refined.moved(task, model, &step.into(), 1.0)?;
                moved += step;
            }
            self.keep(task, &refined, &information.try_inverse()?);
        }
        let points = refined.points.iter().zip(&measurement.points).enumerate();
        let points = points.map(|(i, (&own, &seen))| if measurement.sees(i) { seen } else { own });
        Some(points.collect())
    }
}

/// Most deviation of a hidden point that is known well enough, px.
pub(crate) fn most_px(task: &Task) -> f64 {
    gate::least_leap_px(task) / SURE
}

/// Deviation of the worst point by what is not known of the pattern's motion, in the time until
/// the command takes effect, px.
pub(crate) fn lead_px(task: &Task, at: &InitialState, drift: &Drift, seconds: f64) -> f64 {
    seconds * deviation_px(task, at, &drift.doubt(task))
}

/// Deviation of the worst coordinate by a motion of this covariance, px.
fn deviation_px(task: &Task, at: &InitialState, covariance: &Square) -> f64 {
    let variances = rows(task, at, &at.points).map(|(row, _)| row.dot(&(covariance * row)));
    libm::sqrt(variances.fold(0.0, f64::max))
}

/// Of each coordinate: its derivative by a small motion of the camera, and how far `points` are
/// from it, px.
fn rows(task: &Task, at: &InitialState, points: &Points) -> impl Iterator<Item = (Six, f64)> {
    let focal = [task.camera.fx, task.camera.fy];
    let pairs = at.points.clone().into_iter().zip(points.clone());
    pairs
        .zip(at.depths())
        .flat_map(move |((own, seen), depth)| {
            let rows = interaction::of_point(camera::normalise(&task.camera, own), depth);
            [0, 1].map(|c| (Six::from(rows[c]) * focal[c], seen[c] - own[c]))
        })
}
