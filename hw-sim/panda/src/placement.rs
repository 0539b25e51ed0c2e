//! Joint positions for a given pose, from which an experiment starts.
//!
//! Levenberg-Marquardt from a fixed list of postures, so that the answer is the same in every run.
//! Of the solutions, the one furthest from the joints' limits is taken.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Cholesky, Matrix6};
use thiserror::Error;

use crate::ik::manipulability;
use crate::kinematics::{Chain, JOINTS, Joints, Pose, READY, difference};
use crate::limits::Limits;

/// Most iterations from one posture; a good one needs about ten.
const ITERATIONS: usize = 80;
/// The error at which a posture counts as found, m and rad.
const FOUND: f64 = 1e-10;
/// The greatest change of a joint in an iteration, rad.
const STRIDE: f64 = 0.4;
/// Room that a solution keeps from the ends of the joints' ranges, rad.
const ROOM: f64 = 0.05;

/// No joint positions were found.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error(
    "no joint positions put the end effector at ({x:.3}, {y:.3}, {z:.3}) m with its wanted orientation; \
     the nearest try is {error:.3} (m and rad) away"
)]
pub struct PlacementError {
    /// Wanted position in the base, m.
    pub x: f64,
    /// Wanted position in the base, m.
    pub y: f64,
    /// Wanted position in the base, m.
    pub z: f64,
    /// Distance of the nearest posture, m and rad together.
    pub error: f64,
}

/// Joint positions that put the end effector of `chain` at `wanted` to 1e-10 m and rad, every joint
/// at least 0.05 rad inside its range. For a wanted pose of the camera see
/// [`Mount::flange`](crate::Mount::flange).
///
/// # Errors
/// None of the starting postures leads there.
pub fn place(chain: &Chain, limits: &Limits, wanted: &Pose) -> Result<Joints, PlacementError> {
    let mut best: Option<(f64, Joints)> = None;
    let mut nearest = f64::INFINITY;
    for seed in seeds(wanted) {
        let (q, error) = descend(chain, limits, wanted, inside(&seed, limits));
        nearest = nearest.min(error);
        if error < FOUND {
            let score = score(chain, limits, &q);
            if best.is_none_or(|(s, _)| score > s) {
                best = Some((score, q));
            }
        }
    }
    best.map(|(_, q)| q).ok_or(PlacementError {
        x: wanted.translation.x,
        y: wanted.translation.y,
        z: wanted.translation.z,
        error: nearest,
    })
}

/// Ready positions turned towards the goal, with several elbows and wrists.
fn seeds(wanted: &Pose) -> impl Iterator<Item = Joints> {
    let towards = wanted.translation.y.atan2(wanted.translation.x);
    let elbows = [0.0, 0.6, -0.6];
    let wrists = [0.0, FRAC_PI_2, -FRAC_PI_2];
    elbows.into_iter().flat_map(move |elbow| {
        wrists.into_iter().map(move |wrist| {
            let mut q = Joints::from(READY);
            q[0] = towards - 0.5 * elbow;
            q[2] = elbow;
            q[6] += wrist;
            q
        })
    })
}

fn inside(q: &Joints, limits: &Limits) -> Joints {
    let bound = |k: usize| &limits.joints[k];
    Joints::from_fn(|k, _| q[k].clamp(bound(k).lower + ROOM, bound(k).upper - ROOM))
}

/// Where the iterations from `q` end, and the error there.
fn descend(chain: &Chain, limits: &Limits, wanted: &Pose, mut q: Joints) -> (Joints, f64) {
    let mut damping = 1e-3;
    let mut posture = chain.posture(&q);
    let mut error = difference(wanted, &posture.pose);
    for _ in 0..ITERATIONS {
        if error.norm() < FOUND {
            break;
        }
        let j = &posture.jacobian;
        let square = j * j.transpose() + Matrix6::identity() * damping;
        let Some(factor) = Cholesky::new(square) else {
            break;
        };
        let step = j.transpose() * factor.solve(&error);
        let step = step * (STRIDE / step.amax().max(STRIDE));
        let next = inside(&(q + step), limits);
        let next_posture = chain.posture(&next);
        let next_error = difference(wanted, &next_posture.pose);
        if next_error.norm() < error.norm() {
            (q, posture, error) = (next, next_posture, next_error);
            damping = (damping * 0.1).max(1e-14);
        } else {
            damping = (damping * 10.0).min(1.0);
        }
    }
    (q, error.norm())
}

/// Room of the tightest joint, as a share of half its range, times manipulability.
fn score(chain: &Chain, limits: &Limits, q: &Joints) -> f64 {
    let room = |k: usize| {
        let b = &limits.joints[k];
        2.0 * (q[k] - b.lower).min(b.upper - q[k]) / (b.upper - b.lower)
    };
    let tightest = (0..JOINTS).map(room).fold(f64::INFINITY, f64::min);
    let jacobian = chain.posture(q).jacobian;
    let measure = Cholesky::new(jacobian * jacobian.transpose());
    tightest * measure.as_ref().map_or(0.0, manipulability)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Translation3, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::limits::Model;

    #[test]
    fn what_the_arm_can_do_in_front_of_it_is_found() {
        // Cameras that look down within 30 degrees, turned any way within 60, over a table in front
        // of the robot.
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let chain = Chain::default();
        let mut draw = |a: f64, b: f64| random.random_range(a..b);
        for _ in 0..300 {
            let down = Rotation3::new(Vector3::x() * std::f64::consts::PI);
            let tilt = Rotation3::new(Vector3::new(draw(-0.5, 0.5), draw(-0.5, 0.5), 0.0));
            let turn = Rotation3::new(Vector3::z() * draw(-1.0, 1.0));
            let place_at = Translation3::new(draw(0.35, 0.6), draw(-0.25, 0.25), draw(0.25, 0.6));
            let wanted = Pose::from_parts(place_at, down * tilt * turn);
            for model in [Model::Panda, Model::Fr3] {
                let q = place(&chain, model.limits(), &wanted).unwrap();
                assert!(difference(&wanted, &chain.pose(&q)).norm() < 1e-9);
                assert!(model.limits().outside(&q).is_none());
            }
        }
    }

    #[test]
    fn what_is_out_of_reach_is_said_to_be() {
        let far = Pose::from_parts(Translation3::new(1.5, 0.0, 0.5), Rotation3::identity());
        let error = place(&Chain::default(), Model::Panda.limits(), &far).unwrap_err();
        assert!(error.error > 0.3 && error.to_string().contains("1.500"));
    }
}
