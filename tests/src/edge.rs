//! Starts at the edge of what an arm can do: near the ends of its joints' ranges, and near singular
//! postures.

use arm::ik::{ELBOW, posture};
use arm::{Arm, Chain, Joints, Slack};
use hw_sim::camera::project;
use hw_sim::pose::{from_scene, to_scene};
use hw_sim::referee::Referee;
use hw_sim::robot::arm::{ArmSettings, base_from_object};
use nalgebra::Vector3;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use serde::Serialize;

/// A joint of a start at an end is no further from it, rad.
const END: f64 = 0.2;
/// The least singular value of the Jacobian at a singular start; 0.24 in the ready position.
const SINGULAR: f64 = 0.1;
/// How clear of every border the points are, px.
const CLEARANCE: f64 = 8.0;

/// What a posture is near to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// The end of a joint's range.
    End,
    /// A singular posture: elbow, wrist or shoulder.
    Singular,
}

/// Most steps of a try.
const STEPS: usize = 60;
/// What a posture at the goal leaves at least: nothing.
const NOTHING: Slack = Slack {
    joints: 0.0,
    strain: 0.0,
    space: 0.0,
};

/// A posture, and the object in its camera.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// Base to flange, rad.
    pub q: Joints,
    /// The object in the camera frame.
    pub pose: Pose,
    /// What the posture is near to.
    pub edge: Edge,
}

/// Tries of the search for a posture at the goal.
const TRIES: usize = 100;

/// Whether some posture of an arm, within its margins, shows the goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Goal {
    /// One with joint 3 where it is at the start: the law and its bridges hold the elbow.
    ElbowHeld,
    /// Only others.
    ElbowMoved,
    /// The search found none.
    Nowhere,
}

impl Goal {
    /// By Newton steps from random postures, with joint 3 at `elbow`, rad, and without.
    pub fn search(scene: &Scene, arm: &Arm, elbow: f64, random: &mut impl Rng) -> Self {
        let camera = base_from_object() * from_scene(&scene.goal).inverse();
        let accelerations = scene.limits.acceleration();
        let mut finds = |elbow: Option<f64>| {
            (0..TRIES).any(|_| {
                let mut q = Joints::from_fn(|k, _| {
                    let [least, most] = arm.limits.0[k].range;
                    random.random_range(least..most)
                });
                q[ELBOW] = elbow.unwrap_or(q[ELBOW]);
                let (found, _) = posture(&arm.chain, q, &camera, elbow.is_some(), STEPS);
                found.is_some_and(|q| Slack::at(arm, &q, &accelerations).is_at_least(&NOTHING))
            })
        };
        if finds(Some(elbow)) {
            Self::ElbowHeld
        } else if finds(None) {
            Self::ElbowMoved
        } else {
            Self::Nowhere
        }
    }
}

/// Postures from which the camera sees every point, near an end and near a singular posture in
/// turn.
pub fn starts(scene: &Scene, count: usize, seed: u64) -> Vec<Start> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let settings = ArmSettings::default();
    let mut starts = Vec::new();
    while starts.len() < count {
        let wanted = [Edge::End, Edge::Singular][starts.len() % 2];
        let mut between = |least: f64, most: f64| random.random_range(least..most);
        let pose = Pose {
            translation: [between(-0.3, 0.3), between(-0.3, 0.3), between(0.25, 0.9)],
            rotation: [between(-0.6, 0.6), between(-0.6, 0.6), between(-2.8, 2.8)],
        };
        let object = from_scene(&pose);
        let Ok(points) = project(scene, &object) else {
            continue;
        };
        let mut referee = Referee::new(scene);
        if referee.judge(&points).is_some() || referee.least_clearance() < CLEARANCE {
            continue;
        }
        // Some posture of the many that show this.
        let limits = settings.robot.model.limits();
        let from = Joints::from_fn(|k, _| {
            let bound = limits.joints[k];
            between(bound.lower + 0.3, bound.upper - 0.3)
        });
        let Ok(q) = settings.driven(&from, &pose) else {
            continue;
        };
        if edges(&q, &settings).contains(&wanted) {
            starts.push(Start {
                q,
                pose: to_scene(&object),
                edge: wanted,
            });
        }
    }
    starts
}

/// What a posture is near to.
fn edges(q: &Joints, settings: &ArmSettings) -> Vec<Edge> {
    let limits = settings.robot.model.limits();
    let ends = q.iter().zip(&limits.joints);
    let is_end = ends
        .map(|(q, bound)| (q - bound.lower).min(bound.upper - q))
        .any(|room| room < END);
    let camera = settings.hand_eye.flange_from_camera();
    let chain = Chain::FRANKA.with_ee(camera);
    let is_singular = least_singular_value(&chain, q) < SINGULAR;
    let all = [(Edge::End, is_end), (Edge::Singular, is_singular)];
    let near = all.into_iter().filter(|(_, is_near)| *is_near);
    near.map(|(edge, _)| edge).collect()
}

/// The least singular value of the Jacobian, m and rad as they are.
fn least_singular_value(chain: &Chain, q: &Joints) -> f64 {
    let values = chain.jacobian(q).singular_values();
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// MoveIt Servo's rule, for comparison: it slows a command down that leads towards a singular
/// posture as the Jacobian's condition number grows, and stops it at a hard limit or before a
/// joint's end.
///
/// Source: MoveIt 2, `moveit_servo`, `velocityScalingFactorForSingularity`, with its default
/// parameters.
#[derive(Clone, Debug)]
pub struct ServoRule {
    chain: Chain,
    limits: &'static arm::Limits,
}

/// Condition numbers at which it begins to slow down, and stops; how much faster a way out is.
const SLOWS: f64 = 17.0;
const STOPS: f64 = 30.0;
const LEAVES: f64 = 2.0;
/// Distance from the ends of the joints' ranges at which it stops, rad.
const MARGIN: f64 = 0.1;
/// How far it looks along a direction, m and rad.
const AHEAD: f64 = 0.01;

impl ServoRule {
    /// For the emulated Panda.
    pub fn new() -> Self {
        let camera = ArmSettings::default().hand_eye.flange_from_camera();
        Self {
            chain: Chain::FRANKA.with_ee(camera),
            limits: arm::Model::Panda.limits(),
        }
    }

    /// What it leaves of a command along camera axes.
    pub fn scale(&self, q: &Joints, twist: &[f64; 6]) -> [f64; 6] {
        let (camera, jacobian) = self.chain.at(q);
        let rotate = |v: Vector3<f64>| camera.rotation * v;
        let [x, y, z, a, b, c] = *twist;
        let (linear, angular) = (rotate(Vector3::new(x, y, z)), rotate(Vector3::new(a, b, c)));
        let along = arm::Twist::new(
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
        );
        let svd = jacobian.svd(true, true);
        let Some(u) = svd.u else { return [0.0; 6] };
        let last = svd.singular_values.imin();
        let condition = |q: &Joints| {
            let values = self.chain.jacobian(q).singular_values();
            values.max() / values.min()
        };
        let now = condition(q);
        // The direction of the least singular value, signed towards the singular posture.
        let mut towards: arm::Twist = u.column(last).into();
        let inverse = arm::ik::inverse(&jacobian);
        if condition(&(q + inverse * towards * AHEAD)) < now {
            towards = -towards;
        }
        let is_towards = towards.dot(&along) > 0.0;
        let slowed = if now > STOPS && is_towards {
            0.0
        } else if now > SLOWS {
            let most = if is_towards { STOPS } else { LEAVES * STOPS };
            (1.0 - (now - SLOWS) / (most - SLOWS)).max(0.0)
        } else {
            1.0
        };
        let dq = inverse * along;
        let ends = (0..arm::JOINTS).any(|k| {
            let [below, above] = self.limits.0[k].room(q[k]);
            (below < MARGIN && dq[k] < 0.0) || (above < MARGIN && dq[k] > 0.0)
        });
        twist.map(|v| if ends { 0.0 } else { slowed * v })
    }
}

impl Default for ServoRule {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn starts_are_what_they_are_said_to_be() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let settings = ArmSettings::default();
        let all = starts(&scene, 6, 3);
        for (k, start) in all.iter().enumerate() {
            assert_eq!(start.edge, [Edge::End, Edge::Singular][k % 2]);
            assert!(edges(&start.q, &settings).contains(&start.edge));
            // The camera of this posture sees the object there.
            let chain = panda_chain(&settings);
            let camera = chain.pose(&start.q);
            let object = camera.inverse() * base_from_object();
            let apart = object.translation.vector - Vector3::from(start.pose.translation);
            let turn =
                object.rotation.inverse() * Rotation3::new(Vector3::from(start.pose.rotation));
            assert!(apart.norm() < 1e-6 && turn.angle() < 1e-6);
        }
    }

    fn panda_chain(settings: &ArmSettings) -> Chain {
        Chain::FRANKA.with_ee(settings.hand_eye.flange_from_camera())
    }

    #[test]
    fn a_goal_is_found_where_an_arm_reaches_it() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let path = testkit::root().join("tests/scenes/reach.toml");
        let scene = Scene::read(&path).unwrap();
        let mut arm = Arm::from(scene.arm.as_ref().unwrap());
        let mut search = |arm: &Arm, elbow| Goal::search(&scene, arm, elbow, &mut random);
        assert_eq!(search(&arm, 0.0), Goal::ElbowHeld);
        assert_eq!(search(&arm, 1.3), Goal::ElbowMoved);
        // Joint 4 as short of bending as the elbow's singular posture.
        arm.limits.0[3].range[0] = -1.5;
        assert_eq!(search(&arm, 0.0), Goal::Nowhere);
    }

    #[test]
    fn servo_stops_before_an_end_and_slows_towards_a_singular_posture() {
        let rule = ServoRule::new();
        let ready = Joints::from(arm::READY);
        let twist = [0.05, 0.0, 0.0, 0.0, 0.0, 0.1];
        assert_eq!(rule.scale(&ready, &twist), twist);
        let mut stretched = Joints::from([0.0, 0.9, 0.0, -0.5, 0.0, 1.4, 0.8]);
        stretched[3] = -0.35;
        let least = [-1.0, 1.0].map(|sign| {
            let ways = (0..6).map(|k| {
                let mut way = [0.0; 6];
                way[k] = 0.05 * sign;
                rule.scale(&stretched, &way)[k] / way[k]
            });
            ways.fold(f64::INFINITY, f64::min)
        });
        assert!(least.iter().any(|share| *share < 0.8), "{least:?}");
    }
}
