//! The drift: the pattern's own motion, learned from what the commands do not explain.
//!
//! A pattern on a conveyor or in a hand moves by itself. The law learns its twist d and predicts
//! with v - d instead of v. So the command follows without an error that stays, and following costs
//! nothing.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | x | `POSE` | the camera's true pose less that of the filtered features: a small motion |
//! | d, d' | `twist`, `rate` | twist of the pattern, camera frame, and the rate of its velocity, m/s^2 |
//! | g | `gain` | share by which the camera moves more than commanded |
//! | a | `lag` | how late the camera carries a command out, s |
//! | e | `missed` | measured minus expected features, px |
//! | k | `kept` | share of e that the filtered features do not take over |
//! | L | `interaction` | interaction matrix of a point |
//!
//! From exposure to exposure x grows by dt (g v - (d - d_b)) - a (v - v_before), where d_b was
//! believed; then e = L x + noise; then the features are filtered, and x falls by (1 - k) L^+ e. A
//! Kalman filter of all five learns from it. A wrong gain shows in proportion to the command, a lag
//! to its change, and an object to neither, so that each takes its own part. Noise alone leaves the
//! drift exactly zero: d and d' are believed once they are beyond chance.
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

/// Numbers of the estimate: the pose, the twist, the rate of its velocity, the gain, the lag.
const COUNT: usize = 3 * DOF + 2;
const TWIST: usize = DOF;
const RATE: usize = 2 * DOF;
const GAIN: usize = 3 * DOF;
const LAG: usize = GAIN + 1;
/// Deviations before any evidence: of d, as a share of the velocity limits; of d', as a share of
/// them in a second; of g and a, the latter in s.
const USUAL: f64 = 0.1;
const USUAL_RATE: f64 = 0.3;
const USUAL_GAIN: f64 = 0.3;
const USUAL_LAG_S: f64 = 0.05;
/// Deviations of what chance adds to each in a second, in the same units; to x as a share of the
/// limits times a second.
const POSE_CHANGE: f64 = 0.0002;
const CHANGE: f64 = 0.005;
const RATE_CHANGE: f64 = 0.1;
const GAIN_CHANGE: f64 = 0.02;
const LAG_CHANGE_S: f64 = 0.01;
/// Most of the speed and of the turning rate that is believed, as a share of the limits: more than
/// [`crate::follow`] takes for an object's motion, so that an image that sticks is noticed.
const MOST: f64 = 0.5;
/// Least gain of an actuator, and the inverse of the greatest.
const LEAST_FOLLOWED: f64 = 0.5;
/// Times in which the belief may go from zero to that, s: of the twist, and at the believed rate.
const RISE_S: f64 = 0.2;
const QUICKEST_S: f64 = 0.05;
/// Chi-squared, of six degrees of freedom, above which d is no chance, and d' where d is none: 22.5
/// is 99.9 %, and there are many images.
const CHANCE: f64 = 30.0;
const CHANCE_OF_RATE: f64 = 16.8;
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
    /// All numbers as they are estimated.
    estimate: [f64; COUNT],
    /// The lower half of their covariance, row after row; zero before any evidence.
    covariance: [[f64; COUNT]; COUNT / 2 + 1],
    /// Variance of a measured coordinate, px^2.
    noise: f64,
    /// Mean command in force before the last exposure.
    command: Twist,
}

/// What passed between two exposures.
pub(crate) struct Elapsed<'a> {
    /// The pose at the later one: where it was expected, or filtered.
    pub at: &'a InitialState,
    /// Time between them, s.
    pub seconds: f64,
    /// Mean command in force between them.
    pub command: &'a Twist,
}

/// What the later one shows.
pub(crate) struct Evidence<'a> {
    /// Its points, px; those that it does not show are where they are believed.
    pub seen: &'a Points,
    /// Where they were expected, px.
    pub expected: &'a Points,
    /// Bit i is set if point i was measured.
    pub visible: u32,
    /// Whether the motion since then is the pattern's own; a push is not.
    pub is_telling: bool,
    /// Share of what was missed that the filtered features do not take over, in [0, 1).
    pub kept: f64,
}

type Numbers = SVector<f64, COUNT>;
type Covariance = SMatrix<f64, COUNT, COUNT>;
pub(crate) type Six = SVector<f64, DOF>;
pub(crate) type Square = SMatrix<f64, DOF, DOF>;

impl Drift {
    /// The pattern stands still.
    pub const NONE: Self = Self {
        believed: Own::NONE,
        estimate: [0.0; COUNT],
        covariance: [[0.0; COUNT]; COUNT / 2 + 1],
        noise: USUAL_NOISE,
        command: [0.0; DOF],
    };

    /// Learns from two exposures.
    pub(crate) fn learn(&mut self, task: &Task, elapsed: &Elapsed<'_>, evidence: &Evidence<'_>) {
        let seconds = elapsed.seconds;
        let rows = Rows::of(task, elapsed.at, evidence.seen, evidence.expected);
        let carried = self.carried(task, elapsed);
        let (Some((mut numbers, mut covariance)), Some(inverse)) =
            (carried, rows.normal.try_inverse())
        else {
            return;
        };
        let mut missed = self.noise;
        if evidence.is_telling {
            missed = rows.fit(&mut numbers, &mut covariance, evidence.visible, self.noise);
            let mut pose = numbers.fixed_rows_mut::<DOF>(0);
            pose -= inverse * rows.right * (1.0 - evidence.kept);
        } else {
            // The filtered features are where the pattern is now.
            numbers.fixed_rows_mut::<DOF>(0).fill(0.0);
            covariance.fixed_rows_mut::<DOF>(0).fill(0.0);
            covariance.fixed_columns_mut::<DOF>(0).fill(0.0);
            let fresh = inverse * self.noise;
            covariance
                .fixed_view_mut::<DOF, DOF>(0, 0)
                .copy_from(&fresh);
        }
        let is_sound = (0..COUNT).all(|k| numbers[k].is_finite() && covariance[(k, k)] > 0.0);
        if !(is_sound && missed.is_finite()) {
            *self = Self::NONE;
            return;
        }
        let faded = libm::exp(-seconds / NOISE_S);
        self.noise = (missed + faded * (self.noise - missed)).max(LEAST_NOISE);
        self.command = *elapsed.command;
        self.estimate = numbers.into();
        let halves = (0..COUNT).flat_map(|i| (0..=i).map(move |j| (i, j)));
        let places = self.covariance.as_flattened_mut().iter_mut();
        places
            .zip(halves)
            .for_each(|(to, place)| *to = covariance[place]);
        let believed = beyond_chance(&numbers, &covariance, &self.believed);
        let motion = Motion::of_camera(elapsed.command, seconds);
        let before = motion.carry(&self.believed.twist);
        let mut rate = believed.rate;
        shorten(task, &mut rate, &[0.0; DOF], MOST / QUICKEST_S);
        self.believed = Own {
            twist: approach(task, &before, &believed.twist, seconds),
            rate,
        };
    }

    /// Forgets the belief: the law is not to follow.
    pub(crate) fn stand(&mut self) {
        self.believed = Own::NONE;
    }

    /// Whether nothing was learned yet.
    pub(crate) fn is_new(&self) -> bool {
        *self == Self::NONE
    }

    /// Variance of a measured coordinate, px^2.
    pub(crate) fn noise(&self) -> f64 {
        self.noise
    }

    fn covariance(&self) -> Covariance {
        let half = self.covariance.as_flattened();
        Covariance::from_fn(|i, j| {
            let (i, j) = (i.max(j), i.min(j));
            half[i * (i + 1) / 2 + j]
        })
    }

    /// Covariance of the pattern's own twist.
    pub(crate) fn doubt(&self, task: &Task) -> Square {
        let mut covariance = self.covariance();
        fade(task, &mut covariance, 0.0);
        covariance.fixed_view::<DOF, DOF>(TWIST, TWIST).into()
    }

    /// Where the true pose is from the expected one before this exposure is seen, as a small motion
    /// of the camera, and its covariance; `None` where no image tells.
    pub(crate) fn pose(&self, task: &Task, elapsed: &Elapsed<'_>) -> Option<(Six, Square)> {
        let (numbers, covariance) = self.carried(task, elapsed)?;
        let pose = numbers.fixed_rows::<DOF>(0).into();
        Some((pose, covariance.fixed_view::<DOF, DOF>(0, 0).into()))
    }

    /// The estimate at this exposure, before it is seen.
    fn carried(&self, task: &Task, elapsed: &Elapsed<'_>) -> Option<(Numbers, Covariance)> {
        let Elapsed {
            at,
            seconds,
            command,
        } = *elapsed;
        let mut numbers = Numbers::from(self.estimate);
        let mut covariance = self.covariance();
        if covariance[(0, 0)] == 0.0 {
            let normal = Rows::of(task, at, &at.points, &at.points).normal;
            let fresh = normal.try_inverse()? * self.noise;
            covariance
                .fixed_view_mut::<DOF, DOF>(0, 0)
                .copy_from(&fresh);
        }
        fade(task, &mut covariance, seconds);
        let motion = Motion::of_camera(command, seconds);
        let part = |from: usize| -> Twist { core::array::from_fn(|k| numbers[from + k]) };
        let own = Own {
            twist: part(TWIST),
            rate: core::array::from_fn(|k| numbers[RATE + k]),
        };
        let (middle, believed) = (own.after(0.5 * seconds).twist, self.believed);
        let believed = believed.after(0.5 * seconds).twist;
        let moved = |k: usize| numbers[GAIN] * command[k] - (middle[k] - believed[k]);
        let pose = part(0);
        let change: Twist = core::array::from_fn(|k| command[k] - self.command[k]);
        let late = |k: usize| numbers[LAG] * change[k];
        let pose = core::array::from_fn(|k| pose[k] + seconds * moved(k) - late(k));
        let pose = motion.carry(&pose);
        let Own { twist, rate } = own.after(seconds).carried(&motion);
        let places = numbers.iter_mut();
        let next = pose.into_iter().chain(twist).chain(rate);
        places.zip(next).for_each(|(to, x)| *to = x);
        // F P F': first the rows of F P, then its columns by the same sums.
        let half = -0.5 * seconds * seconds;
        for k in 0..DOF {
            let row = covariance.row(TWIST + k) * -seconds
                + covariance.row(RATE + k) * half
                + covariance.row(GAIN) * (seconds * command[k])
                - covariance.row(LAG) * change[k];
            let mut to = covariance.row_mut(k);
            to += row;
            let row = covariance.row(RATE + k) * seconds;
            let mut to = covariance.row_mut(TWIST + k);
            to += row;
        }
        for k in 0..DOF {
            let column = covariance.column(TWIST + k) * -seconds
                + covariance.column(RATE + k) * half
                + covariance.column(GAIN) * (seconds * command[k])
                - covariance.column(LAG) * change[k];
            let mut to = covariance.column_mut(k);
            to += column;
            let column = covariance.column(RATE + k) * seconds;
            let mut to = covariance.column_mut(TWIST + k);
            to += column;
        }
        Some((numbers, covariance))
    }
}

/// What the coordinates of an image say of the pose.
struct Rows {
    /// Of each coordinate: its derivative by a small motion of the camera, px, and what was missed.
    each: heapless::Vec<(Six, f64), { 2 * MAX_POINTS }>,
    /// J'J and J'e.
    normal: Square,
    right: Six,
}

impl Rows {
    fn of(task: &Task, at: &InitialState, seen: &Points, expected: &Points) -> Self {
        let focal = [task.camera.fx, task.camera.fy];
        let mut rows = Self {
            each: heapless::Vec::new(),
            normal: Square::zeros(),
            right: Six::zeros(),
        };
        let points = at.points.iter().zip(at.depths());
        for ((&at, depth), (seen, expected)) in points.zip(seen.iter().zip(expected)) {
            let derivative = interaction::of_point(camera::normalise(&task.camera, at), depth);
            for c in [0, 1] {
                let row = Six::from(derivative[c]) * focal[c];
                let missed = seen[c] - expected[c];
                rows.normal += row * row.transpose();
                rows.right += row * missed;
                let has_room = rows.each.push((row, missed)).is_ok();
                debug_assert!(has_room, "more than {MAX_POINTS} points");
            }
        }
        rows
    }

    /// One step of the filter by the points of these bits; the mean square of what it leaves, px^2.
    fn fit(
        &self,
        numbers: &mut Numbers,
        covariance: &mut Covariance,
        visible: u32,
        noise: f64,
    ) -> f64 {
        let (mut squares, mut count) = (0.0, 0.0);
        for (place, (row, missed)) in self.each.iter().enumerate() {
            if visible >> (place / 2) & 1 == 0 {
                continue;
            }
            let along = covariance.fixed_columns::<DOF>(0) * row;
            let variance = row.dot(&along.fixed_rows::<DOF>(0)) + noise;
            let error = missed - row.dot(&numbers.fixed_rows::<DOF>(0));
            numbers.axpy(error / variance, &along, 1.0);
            covariance.ger(-1.0 / variance, &along, &along, 1.0);
            squares += error * error * noise / variance;
            count += 1.0;
        }
        if count > 0.0 { squares / count } else { noise }
    }
}

/// Lets evidence fade: what was true before may have changed since.
fn fade(task: &Task, covariance: &mut Covariance, seconds: f64) {
    for k in 0..COUNT {
        let limit = task.limits.get(k % DOF).copied().unwrap_or(1.0);
        let (usual, change) = match k {
            ..TWIST => (0.0, POSE_CHANGE * limit),
            GAIN => (USUAL_GAIN, GAIN_CHANGE),
            LAG => (USUAL_LAG_S, LAG_CHANGE_S),
            RATE.. => (USUAL_RATE * limit, RATE_CHANGE * limit),
            _ => (USUAL * limit, CHANGE * limit),
        };
        let variance = covariance[(k, k)];
        if variance == 0.0 && k >= TWIST {
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
    let mut twist: Six = numbers.fixed_rows::<DOF>(TWIST).into();
    let mut of_twist = block(TWIST, TWIST);
    if !has_rate {
        let shared = block(TWIST, RATE);
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

/// The belief, brought nearer to `wanted` as quickly as an object may change its motion. Turn and
/// translation are shortened by one factor: an image tells their sum better than their parts.
fn approach(task: &Task, standing: &Twist, wanted: &Twist, seconds: f64) -> Twist {
    let mut next = *wanted;
    shorten(task, &mut next, &[0.0; DOF], MOST);
    shorten(task, &mut next, standing, MOST * seconds / RISE_S);
    next
}

/// Brings a twist as near to another one as this share of the limits, in speed and in turn rate.
fn shorten(task: &Task, twist: &mut Twist, to: &Twist, most: f64) {
    let mut factor: f64 = 1.0;
    let away: Twist = core::array::from_fn(|k| twist[k] - to[k]);
    for (away, limits) in away.chunks(3).zip(task.limits.chunks(3)) {
        let length = libm::sqrt(away.iter().map(|x| x * x).sum());
        let most = most * limits.iter().copied().fold(f64::INFINITY, f64::min);
        if length > most {
            factor = factor.min(most / length);
        }
    }
    *twist = core::array::from_fn(|k| to[k] + factor * away[k]);
}
