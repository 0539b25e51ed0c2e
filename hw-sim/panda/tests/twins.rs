//! The emulated arm against `arm`, the model that bridges use: two independent derivations of the
//! same robot.

use arm::ik::inverse;
use nalgebra::{Rotation3, Translation3, Vector3};
use panda::kinematics::difference;
use panda::limits::{Exceeded, Setpoint};
use panda::{Chain, Joints, Model, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MODELS: [(Model, arm::Model); 2] = [
    (Model::Panda, arm::Model::Panda),
    (Model::Fr3, arm::Model::Fr3),
];

/// An end effector that is askew in its flange.
fn hand() -> Pose {
    Pose::from_parts(
        Translation3::new(0.05, -0.03, 0.1),
        Rotation3::new(Vector3::new(0.3, -0.2, 0.5)),
    )
}

fn postures() -> impl Iterator<Item = Joints> {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    (0..2000).map(move |_| Joints::from_fn(|_, _| random.random_range(-3.0..3.0)))
}

#[test]
fn poses_and_jacobians_are_the_same() {
    let (ours, theirs) = (Chain::new(hand()), arm::Chain::FRANKA.with_ee(hand()));
    for q in postures() {
        let posture = ours.posture(&q);
        assert!(difference(&posture.pose, &theirs.pose(&q)).norm() < 1e-9);
        assert!((posture.jacobian - theirs.jacobian(&q)).norm() < 1e-9);
        let flange = theirs.places(&q)[8] - ours.flange(&q).translation.vector;
        assert!(flange.norm() < 1e-9);
    }
}

#[test]
fn joint_limits_are_the_same() {
    for (ours, theirs) in MODELS {
        for (ours, theirs) in ours.limits().joints.iter().zip(&theirs.limits().0) {
            assert_eq!([ours.lower, ours.upper], theirs.range);
            assert_eq!(ours.velocity, theirs.velocity);
            assert_eq!(
                (ours.acceleration, ours.jerk),
                (theirs.acceleration, theirs.jerk)
            );
            for step in 0..=100 {
                let q = ours.lower + 0.01 * f64::from(step) * (ours.upper - ours.lower);
                let (least, most) = ours.velocities(q);
                let [down, up] = theirs.speeds(q);
                assert!((least + down).abs() < 1e-9 && (most - up).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_step_is_allowed_where_the_robot_accepts_it() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut counts = [0; 2];
    for (ours, theirs) in MODELS {
        let bounds = &ours.limits().joints;
        for _ in 0..20_000 {
            // In each draw mostly one joint is at a limit.
            let mut draw = |most: f64| most * random.random_range(-1.0_f64..1.0).powi(9) * 1.2;
            let middle = |k: usize| 0.5 * (bounds[k].lower + bounds[k].upper);
            let half = |k: usize| 0.5 * (bounds[k].upper - bounds[k].lower);
            let mut from = Setpoint {
                q: Joints::from_fn(|k, _| middle(k) + draw(half(k))),
                dq: Joints::from_fn(|k, _| draw(bounds[k].velocity)),
                ddq: Joints::from_fn(|k, _| draw(bounds[k].acceleration)),
            };
            let jump = Joints::from_fn(|k, _| draw(bounds[k].jerk) * 1e-6);
            // In every second draw a joint is near an end of its range.
            if random.random() {
                let k = random.random_range(0..7);
                from.dq[k] = random.random_range(-1.0..1.0);
                let room = random.random_range(0.0..0.1);
                from.q[k] = match from.dq[k] > 0.0 {
                    true => bounds[k].upper - room,
                    false => bounds[k].lower + room,
                };
            }
            let dq = from.dq + from.ddq * 1e-3 + jump;
            let accepted = ours.limits().joints(&from, &from.after(&dq)) == Exceeded::default();
            let known = arm::Setpoint {
                q: from.q,
                dq: from.dq,
                ddq: from.ddq,
            };
            assert_eq!(
                accepted,
                theirs.limits().allow(&known, &dq),
                "{from:?} {dq}"
            );
            counts[usize::from(accepted)] += 1;
        }
    }
    assert!(counts.iter().all(|&count| count > 4000), "{counts:?}");
}

#[test]
fn joints_move_the_end_effector_the_same_way() {
    let chain = Chain::new(hand());
    let twist = panda::Twist::new(0.05, -0.08, 0.03, 0.1, 0.2, -0.15);
    for q in postures() {
        let jacobian = arm::Chain::FRANKA.with_ee(hand()).jacobian(&q);
        let dq = inverse(&jacobian) * twist;
        let is_clear = (jacobian * jacobian.transpose()).determinant().sqrt() > 0.01;
        let moved = chain.posture(&q).jacobian * dq;
        assert!(!is_clear || (moved - twist).norm() < 1e-9, "{moved}");
    }
}
