//! Blind: where the points are that an image does not show.
//!
//! The commands and the pattern's own motion carry the last pose on; the points that are seen
//! correct it, as far as they say more than the prediction. The points that are not seen are those
//! of the corrected pose.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | P | `covariance` | of the pose: a small motion of the camera, m and rad |
//! | P_v | [`Drift::doubt`] | of the twist between camera and pattern |
//! | J | `rows` | derivative of a pixel by that motion |
//!
//! P begins as (sum J'J / noise)^-1 of the last image that showed all points, and grows by P_v t^2
//! in the time t since then: an error of the twist stays what it is. The law goes on while three
//! deviations of the worst point, sqrt(J P J'), are below what the gate takes for a leap, and no
//! longer than the settings say.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: from_fn gives indices inside the matrices"
)]

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

use crate::drift::Drift;
use crate::measurement::Measurement;
use crate::prediction::{InitialState, Model};
use crate::task::Task;
use crate::{DOF, Points, Twist, camera, interaction};

type Six = SVector<f64, DOF>;
type Covariance = SMatrix<f64, DOF, DOF>;

/// Gauss-Newton steps of a correction.
const STEPS: usize = 3;

/// How well the pose is known while points are hidden. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Blind {
    /// P; zero where the last image showed all points.
    covariance: [[f64; DOF]; DOF],
    /// The exposure of the last image that showed all points, ns.
    pub whole_ns: u64,
    /// Deviation of the worst point, px; 0 where the last image showed all points.
    pub deviation_px: f64,
}

impl Blind {
    /// An image that shows all points.
    pub const fn whole(exposed_ns: u64) -> Self {
        Self {
            covariance: [[0.0; DOF]; DOF],
            whole_ns: exposed_ns,
            deviation_px: 0.0,
        }
    }

    /// Lets the time since the last image pass, to where `expected` is.
    pub(crate) fn grow(
        &mut self,
        task: &Task,
        expected: &InitialState,
        drift: &Drift,
        command: &Twist,
        [from_ns, to_ns]: [u64; 2],
    ) {
        let mut covariance = Covariance::from_fn(|i, j| self.covariance[i][j]);
        if self.covariance == [[0.0; DOF]; DOF] {
            let mut information = Covariance::zeros();
            for (row, _) in rows(task, expected, &expected.points) {
                information += row * row.transpose() / drift.noise();
            }
            covariance = information.try_inverse().unwrap_or_else(Covariance::zeros);
        }
        let [before, now] =
            [from_ns, to_ns].map(|ns| ns.saturating_sub(self.whole_ns) as f64 * 1e-9);
        covariance += drift.doubt(task, command) * (now * now - before * before);
        self.keep(task, expected, &covariance);
    }

    fn keep(&mut self, task: &Task, at: &InitialState, covariance: &Covariance) {
        self.covariance = core::array::from_fn(|i| core::array::from_fn(|j| covariance[(i, j)]));
        self.deviation_px = deviation_px(task, at, covariance);
    }

    /// The points of an image that shows some, or none, where `expected` is the prediction for it.
    pub(crate) fn complete(
        &mut self,
        task: &Task,
        model: Model,
        expected: &InitialState,
        measurement: &Measurement,
        noise: f64,
    ) -> Option<Points> {
        let mut refined = expected.clone();
        if measurement.visible != 0 {
            let prior = Covariance::from_fn(|i, j| self.covariance[i][j]).try_inverse()?;
            let mut moved = Six::zeros();
            let mut information = prior;
            for _ in 0..STEPS {
                information = prior;
                let mut right = prior * -moved;
                let seen = rows(task, &refined, &measurement.points).enumerate();
                for (_, (row, error)) in seen.filter(|(k, _)| measurement.sees(k / 2)) {
                    information += row * row.transpose() / noise;
                    right += row * (error / noise);
                }
                let step = information.cholesky()?.solve(&right);
                refined = refined
                    .without_drift()
                    .moved(task, model, &step.into(), 1.0)?;
                moved += step;
            }
            self.keep(task, &refined, &information.try_inverse()?);
        }
        let points = refined.points.iter().zip(&measurement.points).enumerate();
        let points = points.map(|(i, (&own, &seen))| if measurement.sees(i) { seen } else { own });
        Some(points.collect())
    }
}

/// Deviation of the worst point by what is not known of the pattern's motion, in the time until
/// the command takes effect, px.
pub(crate) fn lead_px(task: &Task, at: &InitialState, drift: &Drift, seconds: f64) -> f64 {
    seconds * deviation_px(task, at, &drift.doubt(task, &[0.0; DOF]))
}

/// Deviation of the worst coordinate by a motion of this covariance, px.
fn deviation_px(task: &Task, at: &InitialState, covariance: &Covariance) -> f64 {
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
