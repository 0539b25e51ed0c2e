//! The drift: the pattern's own motion, learned from what the commands do not explain.
//!
//! A pattern on a conveyor or in a hand moves by itself. The law learns its twist d and predicts
//! with v - d instead of v. So the command follows without an error that stays, and following costs
//! nothing.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | d, d' | `twist`, `rate` | twist of the pattern, camera frame, and the rate of its velocity, m/s^2 |
//! | g | `gain` | share by which the camera moves more than commanded |
//! | e | `missed` | measured minus expected features, px |
//! | k | `kept` | share of e that the filtered features do not take over |
//! | L | `interaction` | interaction matrix of a point |
//!
//! From exposure to exposure e_j = k e_{j-1} + dt L (g v - (d - d_b)), where d_b was believed. A
//! Kalman filter of d, d' and g, of which d and d' may change by chance, learns from it. A wrong
//! gain shows in proportion to the command and an object does not, so that each takes its own part.
//! Noise alone leaves the drift exactly zero: d and d' are believed once they are beyond chance.
//!
//! Sources: Pannocchia and Rawlings, "Disturbance models for offset-free model-predictive control",
//! AIChE J. 49(2), 2003; Y. Bar-Shalom et al., "Estimation with Applications to Tracking and
//! Navigation" (2001), Sect. 6.3 (nearly constant acceleration).
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: indices run over the numbers of the estimate"
)]

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

use crate::motion::{Motion, Own};
use crate::prediction::InitialState;
use crate::task::Task;
use crate::{DOF, MAX_POINTS, Points, Twist, camera, interaction};

/// Numbers of the estimate: the twist, the rate of its velocity, the gain.
const COUNT: usize = 2 * DOF + 1;
const RATE: usize = DOF;
const GAIN: usize = 2 * DOF;
/// Deviations before any evidence: of d, as a share of the velocity limits; of d', as a share of
/// them in a second; of g.
const USUAL: f64 = 0.1;
const USUAL_RATE: f64 = 0.3;
const USUAL_GAIN: f64 = 0.3;
/// Deviations of what chance adds to each in a second, in the same units.
const CHANGE: f64 = 0.005;
const RATE_CHANGE: f64 = 0.1;
const GAIN_CHANGE: f64 = 0.02;
/// Most of the speed and of the turning rate that is believed, as a share of the limits: what
/// [`crate::follow`] takes for an object's motion.
const MOST: f64 = 0.4;
/// Least gain of an actuator, and the inverse of the greatest.
const LEAST_FOLLOWED: f64 = 0.5;
/// Time in which the belief may go from zero to that, s.
const RISE_S: f64 = 0.2;
/// Chi-squared, of six degrees of freedom, above which d is no chance, and d' where d is none: 22.5
/// would be 99.9 %; the noise of consecutive images is not independent, and there are many of them.
const CHANCE: f64 = 45.0;
const CHANCE_OF_RATE: f64 = 22.5;
/// Time in which the estimate of the noise follows, s.
const NOISE_S: f64 = 2.0;
/// Variance of a coordinate's noise at first, and at least, px^2.
const USUAL_NOISE: f64 = 0.3 * 0.3;
const LEAST_NOISE: f64 = 0.1 * 0.1;

/// What is known of the pattern's own motion. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// The motion that the law believes, in the camera frame of the last exposure.
    pub believed: Own,
    /// The same as estimated, and the gain: `COUNT` numbers.
    estimate: [f64; COUNT],
    /// Their covariance; zero before any evidence.
    covariance: [[f64; COUNT]; COUNT],
    /// Variance of a coordinate that the prediction misses, px^2.
    noise: f64,
    /// What the prediction missed of each point in the last exposure, px, and the share of it that
    /// the filtered features did not take over.
    missed: [[f64; 2]; MAX_POINTS],
    kept: f64,
}

/// What two exposures show.
pub(crate) struct Evidence<'a> {
    /// The later one, filtered.
    pub measured: &'a InitialState,
    /// Its points as they were measured, px.
    pub seen: &'a Points,
    /// Bit i is set if point i tells of the pattern's motion.
    pub visible: u32,
    /// Where they were expected, px.
    pub expected: &'a Points,
    /// Share of the difference that `measured` does not take over, in [0, 1).
    pub kept: f64,
    /// Time between the exposures, s.
    pub seconds: f64,
    /// Mean command in force between them.
    pub command: &'a Twist,
}

type Numbers = SVector<f64, COUNT>;
type Covariance = SMatrix<f64, COUNT, COUNT>;

impl Drift {
    /// The pattern stands still.
    pub const NONE: Self = Self {
        believed: Own::NONE,
        estimate: [0.0; COUNT],
        covariance: [[0.0; COUNT]; COUNT],
        noise: USUAL_NOISE,
        missed: [[0.0; 2]; MAX_POINTS],
        kept: 0.0,
    };

    /// Learns from two exposures.
    pub(crate) fn learn(&mut self, task: &Task, evidence: &Evidence<'_>) {
        let seconds = evidence.seconds;
        let motion = Motion::of_camera(evidence.command, seconds);
        let (mut numbers, mut covariance) = self.carried(&motion, seconds);
        fade(task, &mut covariance, seconds);
        let missed = self.fit(task, evidence, &mut numbers, &mut covariance);
        let is_sound = (0..COUNT).all(|k| numbers[k].is_finite() && covariance[(k, k)] > 0.0);
        if !(is_sound && missed.is_finite()) {
            *self = Self::NONE;
            return;
        }
        let faded = libm::exp(-seconds / NOISE_S);
        self.noise = (missed + faded * (self.noise - missed)).max(LEAST_NOISE);
        self.estimate = numbers.into();
        self.covariance = core::array::from_fn(|i| core::array::from_fn(|j| covariance[(i, j)]));
        let believed = beyond_chance(&numbers, &covariance, &self.believed);
        let before = motion.carry(&self.believed.twist);
        self.believed = Own {
            twist: approach(task, &before, &believed.twist, seconds),
            ..believed
        };
    }

    /// Variance of a coordinate that the prediction misses, px^2.
    pub(crate) fn noise(&self) -> f64 {
        self.noise
    }

    /// Covariance of the twist between the pattern and a camera under this command.
    pub(crate) fn doubt(&self, task: &Task, command: &Twist) -> SMatrix<f64, DOF, DOF> {
        let mut covariance = Covariance::from_fn(|i, j| self.covariance[i][j]);
        fade(task, &mut covariance, 0.0);
        let command = SVector::<f64, DOF>::from(*command);
        let of_twist: SMatrix<f64, DOF, DOF> = covariance.fixed_view::<DOF, DOF>(0, 0).into();
        of_twist + command * command.transpose() * covariance[(GAIN, GAIN)]
    }

    /// The estimate in the frame of this exposure, before it is seen.
    fn carried(&self, motion: &Motion, seconds: f64) -> (Numbers, Covariance) {
        let own = Own {
            twist: core::array::from_fn(|k| self.estimate[k]),
            rate: core::array::from_fn(|k| self.estimate[RATE + k]),
        };
        let Own { twist, rate } = own.after(seconds).carried(motion);
        let mut numbers = Numbers::from(self.estimate);
        let places = numbers.iter_mut().zip(twist.into_iter().chain(rate));
        places.for_each(|(to, x)| *to = x);
        let mut covariance = Covariance::from_fn(|i, j| self.covariance[i][j]);
        for k in 0..DOF {
            let row = covariance.row(RATE + k) * seconds;
            let mut to = covariance.row_mut(k);
            to += row;
        }
        for k in 0..DOF {
            let column = covariance.column(RATE + k) * seconds;
            let mut to = covariance.column_mut(k);
            to += column;
        }
        (numbers, covariance)
    }

    /// One step of the filter; the mean square of what it leaves, px^2.
    fn fit(
        &mut self,
        task: &Task,
        evidence: &Evidence<'_>,
        numbers: &mut Numbers,
        covariance: &mut Covariance,
    ) -> f64 {
        let Evidence {
            measured,
            seen,
            visible,
            expected,
            kept,
            seconds,
            command,
        } = *evidence;
        let believed = self.believed.after(0.5 * seconds).twist;
        let focal = [task.camera.fx, task.camera.fy];
        // What an image misses by chance, the next one misses the other way.
        let noise = self.noise * (1.0 - self.kept * self.kept);
        let mut squares = 0.0;
        let points = measured.points.iter().zip(measured.depths());
        let points = points.zip(seen.iter().zip(expected)).zip(&mut self.missed);
        let mut count = 0.0;
        for (i, (((&at, depth), (seen, expected)), before)) in points.enumerate() {
            if visible >> i & 1 == 0 {
                *before = core::array::from_fn(|c| seen[c] - expected[c]);
                continue;
            }
            let rows = interaction::of_point(camera::normalise(&task.camera, at), depth);
            for (c, row) in rows.iter().enumerate() {
                let row = row.map(|x| focal[c] * seconds * x);
                let by = |twist: &Twist| row.iter().zip(twist).map(|(x, v)| x * v).sum::<f64>();
                let mut slope = Numbers::zeros();
                slope.iter_mut().zip(row).for_each(|(x, row)| *x = -row);
                slope[GAIN] = by(command);
                let missed = seen[c] - expected[c];
                let found = missed - self.kept * before[c] - by(&believed);
                before[c] = missed;
                let along = *covariance * slope;
                let variance = slope.dot(&along) + noise;
                let error = found - slope.dot(numbers);
                *numbers += along * (error / variance);
                *covariance -= along * along.transpose() / variance;
                squares += error * error * noise / variance;
                count += 1.0;
            }
        }
        let doubled = 1.0 + self.kept * self.kept;
        self.kept = kept;
        match count > 0.0 {
            true => squares / count / doubled,
            false => self.noise,
        }
    }
}

/// Lets evidence fade: what was true before may have changed since.
fn fade(task: &Task, covariance: &mut Covariance, seconds: f64) {
    for k in 0..COUNT {
        let limit = task.limits.get(k % DOF).copied().unwrap_or(1.0);
        let (usual, change) = match k {
            GAIN => (USUAL_GAIN, GAIN_CHANGE),
            RATE.. => (USUAL_RATE * limit, RATE_CHANGE * limit),
            _ => (USUAL * limit, CHANGE * limit),
        };
        let variance = covariance[(k, k)];
        if variance == 0.0 {
            covariance[(k, k)] = usual * usual;
        } else {
            covariance[(k, k)] += seconds * change * change;
        }
    }
}

/// What an estimate says beyond chance: first of the rate, then of the twist with or without it.
/// What was believed before stays until it is no more than usual noise. It is the command that
/// follows the pattern, by an actuator of the estimated gain.
fn beyond_chance(numbers: &Numbers, covariance: &Covariance, before: &Own) -> Own {
    let follows = (1.0 + numbers[GAIN]).clamp(LEAST_FOLLOWED, 1.0 / LEAST_FOLLOWED);
    type Six = SVector<f64, DOF>;
    type Square = SMatrix<f64, DOF, DOF>;
    let block = |i, j| -> Square { covariance.fixed_view::<DOF, DOF>(i, j).into() };
    let rate: Six = numbers.fixed_rows::<DOF>(RATE).into();
    let Some(factor) = block(RATE, RATE).cholesky() else {
        return Own::NONE;
    };
    let weighted = factor.solve(&rate);
    let is_sure = |evidence: f64, chance: f64, was_sure: bool| {
        evidence > if was_sure { DOF as f64 } else { chance }
    };
    let has_rate = is_sure(
        rate.dot(&weighted),
        CHANCE_OF_RATE,
        before.rate != [0.0; DOF],
    );
    let mut twist: Six = numbers.fixed_rows::<DOF>(0).into();
    let mut of_twist = block(0, 0);
    if !has_rate {
        let shared = block(0, RATE);
        twist -= shared * weighted;
        of_twist -= shared * factor.solve(&shared.transpose());
    }
    let Some(factor) = of_twist.cholesky() else {
        return Own::NONE;
    };
    let evidence = twist.dot(&factor.solve(&twist));
    if !is_sure(evidence, CHANCE, before.twist != [0.0; DOF]) {
        return Own::NONE;
    }
    Own {
        twist: (twist / follows).into(),
        rate: (rate * (f64::from(u8::from(has_rate)) / follows)).into(),
    }
}

/// The belief, brought nearer to `wanted` as quickly as an object may change its motion.
fn approach(task: &Task, standing: &Twist, wanted: &Twist, seconds: f64) -> Twist {
    let mut next = *wanted;
    let pairs = next.chunks_mut(3).zip(standing.chunks(3));
    for ((next, before), limits) in pairs.zip(task.limits.chunks(3)) {
        let most = MOST * limits.iter().copied().fold(f64::INFINITY, f64::min);
        shorten(next, &[0.0; 3], most);
        shorten(next, before, most * seconds / RISE_S);
    }
    next
}

/// Brings a vector as near to another one as `most`.
fn shorten(vector: &mut [f64], to: &[f64], most: f64) {
    let pairs = vector.iter().zip(to);
    let length = libm::sqrt(pairs.map(|(x, y)| (x - y) * (x - y)).sum());
    if length > most {
        let pairs = vector.iter_mut().zip(to);
        pairs.for_each(|(x, y)| *x = y + (*x - y) * most / length);
    }
}
