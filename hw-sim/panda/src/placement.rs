//! Joint positions for a given pose, from which an experiment starts.
//!
//! [`place`]: Levenberg-Marquardt from a fixed list of postures, so that the answer is the same in
//! every run. Of the solutions, the one furthest from the joints' limits is taken. [`drive`]: along a
//! path from where the arm stands, as a robot gets there.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Cholesky, Matrix6, Rotation3};
use thiserror::Error;

use crate::ik::{ELBOW_FADE, LEAST_DAMPING, has_few_joints, manipulability};
use crate::kinematics::{Chain, JOINTS, Joints, Pose, READY, difference, rotation_vector};
use crate::limits::Limits;

/// Most iterations from one posture; a good one needs about ten.
const ITERATIONS: usize = 80;
/// The error at which a posture counts as found, m and rad.
const FOUND: f64 = 1e-10;
/// The greatest change of a joint in an iteration, rad.
const STRIDE: f64 = 0.4;
/// Room that a solution keeps from the ends of the joints' ranges, rad.
const ROOM: f64 = 0.05;

/// Postures that iterations begin from for an arm that is not Franka's.
const SPREAD: u32 = 64;

/// The longest step of a path, m and rad.
const STEP: f64 = 0.01;

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
/// at least 0.05 rad inside its range.
///
/// # Errors
/// None of the starting postures leads there.
pub fn place(chain: &Chain, limits: &Limits, wanted: &Pose) -> Result<Joints, PlacementError> {
    let mut best: Option<(f64, Joints)> = None;
    let mut nearest = f64::INFINITY;
    let seeds: Vec<Joints> = match chain.is_franka() {
        true => seeds(wanted).collect(),
        false => spread(chain, limits).collect(),
    };
    for seed in seeds {
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

/// Why an arm cannot be driven to a pose.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum DriveError {
    /// A joint would come too near to an end of its range.
    #[error("joint {joint} would turn to {position:.2} rad, of {lower:.2} to {upper:.2}")]
    Range {
        /// Its number, from 1.
        joint: usize,
        /// Where it would be, rad.
        position: f64,
        /// Its range, less 0.05 rad of room at either end, rad.
        lower: f64,
        /// Its range, rad.
        upper: f64,
    },
    /// A pose on the way is out of reach.
    #[error("the straight way there leads out of reach")]
    Reach,
}

/// Joint positions to which an arm at `from` comes if its end effector is driven to `wanted` along a
/// straight line at an even rate of turn, while joint 3, the elbow, stays where it is.
///
/// # Errors
/// A joint comes within 0.05 rad of an end of its range, or the way leads out of reach.
pub fn drive(
    chain: &Chain,
    limits: &Limits,
    from: &Joints,
    wanted: &Pose,
) -> Result<Joints, DriveError> {
    let begin = chain.pose(from);
    let line = wanted.translation.vector - begin.translation.vector;
    let turn = rotation_vector(&(wanted.rotation * begin.rotation.inverse()));
    let steps = (line.norm().max(turn.norm()) / STEP).ceil().max(1.0);
    let mut q = *from;
    for step in 1..=steps as usize {
        let share = step as f64 / steps;
        let pose = match step as f64 == steps {
            true => *wanted,
            false => Pose::from_parts(
                (begin.translation.vector + line * share).into(),
                Rotation3::new(turn * share) * begin.rotation,
            ),
        };
        q = follow(chain, &q, from[2], &pose).ok_or(DriveError::Reach)?;
        for (k, bound) in limits.joints.iter().enumerate() {
            let (lower, upper) = (bound.lower + ROOM, bound.upper - ROOM);
            if !(lower..=upper).contains(&q[k]) {
                return Err(DriveError::Range {
                    joint: k + 1,
                    position: q[k],
                    lower,
                    upper,
                });
            }
        }
    }
    Ok(q)
}

/// The joint positions near `q` at a pose near theirs, with joint 3 at `elbow` as far as it can be.
fn follow(chain: &Chain, q: &Joints, elbow: f64, pose: &Pose) -> Option<Joints> {
    let mut q = *q;
    for _ in 0..ITERATIONS {
        let posture = chain.posture(&q);
        let error = difference(pose, &posture.pose);
        let j = &posture.jacobian;
        let inverse = j.transpose() * Cholesky::new(j * j.transpose())?.inverse();
        let task = inverse * error;
        // The motion of the joints without the end effector that turns joint 3.
        let mut free = -inverse * j.column(2);
        free[2] += 1.0;
        let away = elbow - q[2] - task[2];
        let is_held = free[2] > ELBOW_FADE;
        if error.norm() < FOUND && (!is_held || away.abs() < 1e-6) {
            return Some(q);
        }
        let step = task + free * if is_held { away / free[2] } else { 0.0 };
        q += step * (STRIDE / step.amax().max(STRIDE));
    }
    None
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

/// Postures of any arm: within half a turn of the middles of its ranges, spread evenly (R. Roberts'
/// additive recurrence).
fn spread(chain: &Chain, limits: &Limits) -> impl Iterator<Item = Joints> {
    // The root of x^8 = x + 1.
    const ROOT: f64 = 1.096_981_557_798_559_8;
    let count = chain.count();
    (1..=SPREAD).map(move |number| {
        Joints::from_fn(|k, _| {
            if k >= count {
                return 0.0;
            }
            let bound = &limits.joints[k];
            let share = (f64::from(number) / ROOT.powi(k as i32 + 1)).fract() - 0.5;
            let width = (bound.upper - bound.lower).min(2.0 * PI);
            0.5 * (bound.lower + bound.upper) + share * width
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
        let least = match has_few_joints(j) {
            true => LEAST_DAMPING.powi(2),
            false => 1e-14,
        };
        if next_error.norm() < error.norm() {
            (q, posture, error) = (next, next_posture, next_error);
            damping = (damping * 0.1).max(least);
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
    tightest * manipulability(&chain.posture(q).jacobian)
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

    #[test]
    fn an_arm_is_driven_along_a_line_with_its_elbow_where_it_was() {
        let (chain, limits) = (Chain::default(), Model::Panda.limits());
        let down = Rotation3::new(Vector3::x() * std::f64::consts::PI);
        let pose = |x: f64, y: f64, z: f64, turn: f64| {
            let turn = Rotation3::new(Vector3::z() * turn);
            Pose::from_parts(Translation3::new(x, y, z), down * turn)
        };
        let mut q = place(&chain, limits, &pose(0.45, 0.0, 0.4, 0.0)).unwrap();
        q[2] += 0.3;
        q = follow(&chain, &q, q[2], &pose(0.45, 0.0, 0.4, 0.0)).unwrap();
        let elbow = q[2];
        for (x, y, z, turn) in [
            (0.55, 0.1, 0.3, 0.5),
            (0.4, -0.15, 0.5, -0.5),
            (0.45, 0.0, 0.4, 0.0),
        ] {
            let wanted = pose(x, y, z, turn);
            let there = drive(&chain, limits, &q, &wanted).unwrap();
            assert!(difference(&wanted, &chain.pose(&there)).norm() < 1e-9);
            assert!((there[2] - elbow).abs() < 1e-5);
            q = there;
        }
        // Back where it began, which is not where it would be placed.
        let placed = place(&chain, limits, &pose(0.45, 0.0, 0.4, 0.0)).unwrap();
        assert!((q - placed).amax() > 0.2);
    }

    #[test]
    fn joints_out_of_range_and_poses_out_of_reach_are_told() {
        let (chain, limits) = (Chain::default(), Model::Panda.limits());
        let down = Rotation3::new(Vector3::x() * std::f64::consts::PI);
        let pose = Pose::from_parts(Translation3::new(0.45, 0.0, 0.4), down);
        let q = place(&chain, limits, &pose).unwrap();
        // Half a turn from here, and half a turn more.
        let turned = |angle: f64| {
            let turn = Rotation3::new(Vector3::z() * angle);
            Pose::from_parts(pose.translation, pose.rotation * turn)
        };
        let mut at = q;
        let mut last = Ok(q);
        for k in 1..=4 {
            last = drive(&chain, limits, &at, &turned(1.5 * f64::from(k)));
            match last {
                Ok(there) => at = there,
                Err(_) => break,
            }
        }
        assert!(
            matches!(last, Err(DriveError::Range { joint: 7, .. })),
            "{last:?}"
        );
        let far = Pose::from_parts(Translation3::new(1.5, 0.0, 0.5), down);
        let error = drive(&chain, limits, &q, &far).unwrap_err();
        assert!(matches!(
            error,
            DriveError::Reach | DriveError::Range { .. }
        ));
    }
}
