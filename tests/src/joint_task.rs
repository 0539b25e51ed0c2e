//! ViSP's joint-limit task, for comparison: classic visual servoing in joint space, with a
//! secondary task that turns joints away from the ends of their ranges. Its motion of the joints
//! is more than that of the camera, and an interface for the camera's twist would drop it: so the
//! joints of the emulated robot are commanded themselves.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | e | `error` | features less those at the goal, normalized coordinates |
//! | J | `jacobian` | interaction matrix times the camera's Jacobian: de/dt = J dq |
//! | dq1 = -lambda J^+ e | `first` | the visual task, rad/s |
//! | P | `projector` | the large projection operator |
//! | dq2 | | the secondary task, a part for each joint near an end |
//! | rho, rho1, lambda_i | `RHO`, `RHO_1`, `MORE` | zones and push, ViSP's defaults |
//!
//! Source: M. Marey and F. Chaumette, "A new large projection operator for the redundancy
//! framework", ICRA 2010, Eq. 24; "New strategies for avoiding robot joint limits: application to
//! visual servoing using a large projection operator", IROS 2010, Eq. 16; as ViSP has them in
//! `vpServo::secondaryTaskJointLimitAvoidance`. Our own code.

use std::collections::VecDeque;

use arm::{Chain, Jacobian, Joints, Limits, Ramp, Setpoint};
use hw_sim::camera::project;
use hw_sim::pose::RigidPose;
use hw_sim::recording::ArmRecord;
use hw_sim::referee::{End, Referee};
use hw_sim::rig::RigSettings;
use hw_sim::robot::arm::base_from_object;
use hw_sim::robot::inspector::Inspector;
use hw_sim::robot::sequence::TaskStep;
use nalgebra::{DMatrix, DVector, Point3};
use panda::{Command, Mode, Motion, MotionKind, Robot};
use scene::Scene;

use crate::edge::Start;
use crate::robot::{Reason, RobotRun, Sample};

/// Gain at zero, at infinity, and its slope at zero, 1/s, as in the documentation of ViSP's
/// `vpAdaptiveGain`.
const GAIN: [f64; 3] = [4.0, 0.4, 30.0];
/// Norms of e between which one operator gives way to the other.
const NORMS: [f64; 2] = [0.1, 0.7];
/// Share of a range, at each end, in which the task acts.
const RHO: f64 = 0.1;
/// Share of that zone in which it comes up.
const RHO_1: f64 = 0.3;
/// By how much it pushes more than the visual task does.
const MORE: f64 = 0.7;
/// Singular values below this share of the largest are none.
const LEAST: f64 = 1e-6;
/// Share of the joints' bounds on acceleration and jerk that the ramps take, as vpc-panda's.
const RAMPS: f64 = 0.8;
/// Time at the goal after which a run has arrived, s.
const DWELL: f64 = 0.3;
const TICK: f64 = 1e-3;

/// The law, of one scene and its arm.
#[derive(Clone, Debug)]
pub struct JointTask {
    scene: Scene,
    chain: Chain,
    limits: Limits,
    /// Greatest share of the joints' speeds.
    speed: f64,
    goal: Vec<[f64; 2]>,
}

/// What it sees.
struct Seen {
    /// px.
    points: Vec<[f64; 2]>,
    /// Depths of the points, m; true ones.
    depths: Vec<f64>,
}

impl JointTask {
    /// For the arm of a scene; `None` where it names none.
    pub fn new(scene: &Scene) -> Option<Self> {
        let arm = arm::Arm::from(scene.arm.as_ref()?);
        Some(Self {
            chain: arm.chain,
            limits: arm.limits,
            speed: arm.speed,
            goal: Referee::new(scene).goal().to_vec(),
            scene: scene.clone(),
        })
    }

    /// Velocities of the joints, rad/s, in answer to what is seen in a posture: as a whole within
    /// the scene's limits for the camera, and the arm file's for the joints.
    fn command(&self, q: &Joints, seen: &Seen) -> Joints {
        let camera = &self.scene.camera;
        let normal = |[u, v]: [f64; 2]| [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy];
        let along = self.along(q);
        let along = DMatrix::from_column_slice(6, arm::JOINTS, along.as_slice());
        let count = self.goal.len();
        let mut error = DVector::zeros(2 * count);
        let mut interaction = DMatrix::zeros(2 * count, 6);
        for (i, (point, goal)) in seen.points.iter().zip(&self.goal).enumerate() {
            let ([x, y], [a, b], z) = (normal(*point), normal(*goal), seen.depths[i]);
            (error[2 * i], error[2 * i + 1]) = (x - a, y - b);
            let rows = [
                [-1.0 / z, 0.0, x / z, x * y, -(1.0 + x * x), y],
                [0.0, -1.0 / z, y / z, 1.0 + y * y, -x * y, -x],
            ];
            for (j, row) in rows.iter().enumerate() {
                (0..6).for_each(|k| interaction[(2 * i + j, k)] = row[k]);
            }
        }
        let jacobian = interaction * &along;
        let [zero, infinity, slope] = GAIN;
        let gain = (zero - infinity) * (-slope / (zero - infinity) * error.amax()).exp() + infinity;
        let least = LEAST * jacobian.singular_values().max();
        let Ok(inverse) = jacobian.clone().pseudo_inverse(least) else {
            return Joints::zeros();
        };
        let first = -gain * &inverse * &error;
        let projector = projector(&jacobian, &inverse, &error);
        let mut both = first.clone();
        for k in 0..self.chain.count() {
            if let Some((sign, rises)) = near(self.limits.0[k].range, q[k]) {
                let push = sign * projector.column(k);
                if push[k].abs() > f64::EPSILON {
                    both -= rises * (1.0 + MORE) * first[k].abs() / push[k].abs() * push;
                }
            }
        }
        let twist = along * &both;
        let cuts = (twist.iter().zip(self.scene.limits.velocity())).map(|(v, most)| most / v.abs());
        let joints = both.iter().zip(&self.limits.0);
        let joints = joints.map(|(dq, joint)| self.speed * joint.velocity / dq.abs());
        let share = cuts.chain(joints).fold(1.0, f64::min);
        Joints::from_fn(|k, _| share * both[k])
    }

    /// From velocities of the joints to the camera's twist along its axes.
    fn along(&self, q: &Joints) -> Jacobian {
        let (camera, mut jacobian) = self.chain.at(q);
        for mut column in jacobian.column_iter_mut() {
            for at in [0, 3] {
                let turned = camera.rotation.inverse() * column.fixed_rows::<3>(at);
                column.fixed_rows_mut::<3>(at).copy_from(&turned);
            }
        }
        jacobian
    }

    /// A run from a posture, by the robot and camera of a cell; they are as the law believes, and
    /// features come as late as the cell's. It may cross what hides points, which is a violation,
    /// and go on: its `arrived_s` tells then that the arm got there.
    ///
    /// # Errors
    /// The robot refuses the posture or the motion.
    pub fn run(&self, cell: &RigSettings, start: &Start) -> anyhow::Result<RobotRun> {
        let mut robot = Robot::new(cell.arm.robot, start.q)?;
        robot.start(MotionKind::Joint)?;
        let mut inspector = Inspector::new(robot.state(), robot.limits());
        let flange_from_camera = cell.arm.hand_eye.flange_from_camera();
        let (mut referee, mut frames) = (Referee::new(&self.scene), VecDeque::new());
        let (mut reason, mut arrived, mut since) = (Some(Reason::TimeOut), None, None);
        let (mut wanted, mut newest, mut hides) = (Joints::zeros(), None, false);
        let period_ms = 1e3 / self.scene.camera.rate_hz;
        let delay_ms = cell.eye.latency.latency_ns / 1_000_000;
        let (mut count, mut error_px, mut ms) = (0.0, f64::INFINITY, 0);
        let mut history = Vec::new();
        let end_ms = (1e3 * self.scene.success.time_s) as u64;
        while ms < end_ms && arrived.is_none() {
            if ms as f64 >= (count * period_ms).round() {
                count += 1.0;
                let camera = robot.state().flange() * flange_from_camera;
                let object: RigidPose = camera.inverse() * base_from_object();
                let Ok(points) = project(&self.scene, &object) else {
                    reason = Some(Reason::Violation);
                    break;
                };
                hides |= matches!(referee.judge(&points), Some(End::Violation(_)));
                error_px = referee.error(&points);
                match error_px <= self.scene.success.convergence_px {
                    true if ms - *since.get_or_insert(ms) >= (1e3 * DWELL) as u64 => {
                        arrived = since
                    }
                    true => (),
                    false => since = None,
                }
                let depth = |point: &[f64; 3]| (object * Point3::from(*point)).z;
                let depths = self.scene.pattern.iter().map(depth).collect();
                let features = points.to_vec();
                let points = features.clone();
                frames.push_back((ms + delay_ms, Seen { points, depths }));
                while frames.front().is_some_and(|(at, _)| *at <= ms) {
                    newest = frames.pop_front();
                }
                let state = robot.state();
                if let Some((_, seen)) = &newest {
                    wanted = self.command(&state.q, seen);
                }
                history.push(Sample {
                    time_s: TICK * ms as f64,
                    features,
                    twist: std::array::from_fn(|k| (self.along(&state.q) * wanted)[k]),
                    way_point: None,
                    arm: ArmRecord {
                        q: state.q.into(),
                        dq: state.dq.into(),
                        phase: TaskStep::Approach,
                        mode: state.robot_mode.name().to_owned(),
                        visible: u32::MAX,
                    },
                });
            }
            let state = robot.state();
            let desired = Setpoint {
                q: state.q_d,
                dq: state.dq_d,
                ddq: state.ddq_d,
            };
            let command = Command {
                id: state.id,
                motion: Motion::Joint(self.ramped(&desired, &wanted)),
                elbow: None,
                finished: false,
            };
            robot.step(&[command]);
            inspector.look(robot.state());
            inspector.steered(false);
            ms += 1;
            if robot.state().robot_mode == Mode::Reflex {
                reason = Some(Reason::Reflex);
                break;
            }
        }
        if arrived.is_some() {
            reason = hides.then_some(Reason::Violation);
        }
        let arm = inspector.report().clone();
        Ok(RobotRun {
            success: reason.is_none() && arm.is_clean(),
            reason,
            time_s: 1e-3 * ms as f64,
            arrived_s: arrived.map(|ms| 1e-3 * ms as f64),
            least_clearance_px: referee.least_clearance(),
            least_between_px: referee.least_clearance(),
            error_px,
            cost: f64::NAN,
            arm,
            goal: None,
            hold: None,
            least_edge_px: None,
            hidden: 0,
            following: None,
            release: None,
            history,
        })
    }

    /// The velocities of the next millisecond, each joint on a ramp; braking, in place of what the
    /// robot would refuse, as `vpc-panda` does.
    fn ramped(&self, desired: &Setpoint, wanted: &Joints) -> Joints {
        let limits = arm::Model::Panda.limits();
        let towards = |target: &Joints| {
            Joints::from_fn(|k, _| {
                let joint = &limits.0[k];
                let ramp = Ramp {
                    acceleration: RAMPS * joint.acceleration,
                    jerk: RAMPS * joint.jerk,
                };
                ramp.step(desired.dq[k], desired.ddq[k], target[k], TICK).0
            })
        };
        let next = towards(wanted);
        match limits.allow(desired, &next) {
            true => next,
            false => towards(&Joints::zeros()),
        }
    }
}

/// The side on which a joint is near an end of its range, -1 or 1, and how far the task has come up
/// there, 0 to 1.
fn near([least, most]: [f64; 2], q: f64) -> Option<(f64, f64)> {
    let zone = RHO * (most - least);
    let (sign, deep) = match q - least < most - q {
        true => (-1.0, zone - (q - least)),
        false => (1.0, zone - (most - q)),
    };
    let share = deep / (RHO_1 * zone);
    let rises = match share >= 1.0 {
        true => 1.0,
        false => 1.0 / (1.0 + (6.0 - 12.0 * share).exp()),
    };
    (deep > 0.0).then_some((sign, rises))
}

/// P: motions that keep |e| as the visual task has it, far from the goal; near it, those that keep
/// e.
fn projector(
    jacobian: &DMatrix<f64>,
    inverse: &DMatrix<f64>,
    error: &DVector<f64>,
) -> DMatrix<f64> {
    let one = DMatrix::identity(jacobian.ncols(), jacobian.ncols());
    let classic = &one - inverse * jacobian;
    let [near, far] = NORMS;
    let norm = error.norm();
    let share = match norm {
        norm if norm > far => 1.0,
        norm if norm < near => 0.0,
        norm => 1.0 / (1.0 + (6.0 - 12.0 * (norm - near) / (far - near)).exp()),
    };
    let along = jacobian.transpose() * error;
    let length = along.norm_squared();
    if share == 0.0 || length == 0.0 {
        return classic;
    }
    let large = one - &along * along.transpose() / length;
    large * share + classic * (1.0 - share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task() -> JointTask {
        let path = crate::root().join("tests/scenes/reach.toml");
        JointTask::new(&Scene::read(&path).unwrap()).unwrap()
    }

    /// The goal's pattern, drawn larger by a factor about the image's center.
    fn seen(task: &JointTask, factor: f64) -> Seen {
        let camera = &task.scene.camera;
        let larger =
            |[u, v]: &[f64; 2]| [(u, camera.cx), (v, camera.cy)].map(|(x, c)| c + factor * (x - c));
        Seen {
            points: task.goal.iter().map(larger).collect(),
            depths: vec![task.scene.goal.translation[2]; task.goal.len()],
        }
    }

    #[test]
    fn far_from_all_ends_it_is_the_classic_law() {
        let task = task();
        let q = Joints::from(arm::READY);
        assert_eq!(task.command(&q, &seen(&task, 1.0)).amax(), 0.0);
        // Too near: the camera backs away along its axis.
        let dq = task.command(&q, &seen(&task, 1.1));
        let (camera, jacobian) = task.chain.at(&q);
        let velocity: arm::Twist = jacobian * dq;
        let velocity = camera.rotation.inverse() * velocity.fixed_rows::<3>(0);
        assert!(velocity.z < -0.005 && velocity.xy().norm() < 0.3 * velocity.z.abs());
    }

    #[test]
    fn a_joint_in_the_zone_of_its_end_is_turned_away_from_it() {
        let task = task();
        let mut q = Joints::from(arm::READY);
        let without = task.command(&q, &seen(&task, 1.3));
        for (joint, end, sign) in [(2, 1, 1.0), (2, 0, -1.0), (4, 1, 1.0)] {
            q = Joints::from(arm::READY);
            q[joint] = task.limits.0[joint].range[end] - sign * 0.05;
            let dq = task.command(&q, &seen(&task, 1.3));
            assert!(sign * dq[joint] < 0.0, "{joint} {end}: {dq}");
        }
        assert!(without.amax() > 0.0);
    }

    #[test]
    fn the_operators_keep_what_they_promise() {
        let jacobian = DMatrix::from_fn(8, 7, |i, j| ((3 * i + 5 * j) as f64).sin());
        let inverse = jacobian.clone().pseudo_inverse(1e-9).unwrap();
        let any = DVector::from_fn(7, |i, _| (i as f64).cos());
        for size in [0.01, 1.0] {
            let error = DVector::from_fn(8, |i, _| (1.0 + i as f64).sin()).normalize() * size;
            let change = &jacobian * projector(&jacobian, &inverse, &error) * &any;
            // The norm's derivative; near the goal, each component's.
            assert!(error.dot(&change).abs() < 1e-9 * (1.0 + size));
            assert_eq!(change.amax() < 1e-9, size < NORMS[0]);
        }
    }
}
