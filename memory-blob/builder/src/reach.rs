//! Which starts an arm can reach from the goal, with its elbow held, as the law moves it.

use arm::{Arm, Dampers, Joints};
use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};
use scene::{Pose, Scene};

/// Steps of the way to a start.
const STEPS: u32 = 50;
/// How near a start the arm must come, m and rad.
const NEAR: f64 = 1e-3;

/// What an arm can reach of the scene whose goal it shows.
pub struct Reach {
    arm: Arm,
    /// Joints at the goal.
    goal: Joints,
    /// The object in the base.
    base_from_object: arm::Pose,
    /// The camera's, m/s^2 and rad/s^2.
    accelerations: [f64; 6],
    period_s: f64,
}

impl Reach {
    /// Of the scene's arm; `None` where the scene names none, or where its file does not tell the
    /// joints at the goal.
    pub fn of(scene: &Scene) -> Option<Self> {
        let described = scene.arm.as_ref().filter(|arm| !arm.goal.is_empty())?;
        let arm = Arm::from(described);
        let goal = arm::joints(&described.goal);
        Some(Self {
            base_from_object: arm.chain.pose(&goal) * rigid(&scene.goal),
            goal,
            accelerations: scene.limits.acceleration(),
            period_s: scene.sampling_time(),
            arm,
        })
    }

    /// The object in the base.
    pub fn object(&self) -> &arm::Pose {
        &self.base_from_object
    }

    /// The arm at the goal: origins of base, joints and camera in the base, m.
    pub fn places(&self) -> impl Iterator<Item = Vector3<f64>> {
        let [joints @ .., camera] = self.arm.chain.places(&self.goal);
        let count = self.arm.chain.count();
        joints.into_iter().take(count + 1).chain([camera])
    }

    /// The camera in the base where it sees the object at this pose.
    pub fn camera(&self, start: &Pose) -> arm::Pose {
        self.base_from_object * rigid(start).inverse()
    }

    /// The start, if the camera can be where it sees the object at this pose: on a straight way
    /// there, at an even turn, no joint comes into the margin of its range, no point behind a wall,
    /// no link into its clearance, and the arm near no singular posture. Of an arm with fewer than
    /// six joints, the nearest that such a way leads to.
    pub fn nearest(&self, start: &Pose) -> Option<Pose> {
        let wanted = self.camera(start);
        let q = self.way(&wanted)?;
        if !self.arm.chain.has_few_joints() {
            return self.is_near(&q, &wanted, 6).then_some(*start);
        }
        let object = self.arm.chain.pose(&q).inverse() * self.base_from_object;
        let turn = UnitQuaternion::from_rotation_matrix(&object.rotation);
        Some(Pose {
            translation: object.translation.vector.into(),
            rotation: turn.scaled_axis().into(),
        })
    }

    /// Whether such a way leads the camera to a pose in the base; with fewer than six joints to its
    /// place alone.
    pub fn includes_camera(&self, wanted: &arm::Pose) -> bool {
        let numbers = if self.arm.chain.has_few_joints() {
            3
        } else {
            6
        };
        let end = self.way(wanted);
        end.is_some_and(|q| self.is_near(&q, wanted, numbers))
    }

    /// The joints at the end of a straight way of the camera, if all of it is allowed.
    fn way(&self, wanted: &arm::Pose) -> Option<Joints> {
        let mut q = self.goal;
        for left in (1..=STEPS).rev() {
            let step = self.to(&q, wanted).map(|x| x / f64::from(left));
            q = self.arm.moved(&q, &step, 0.0, 1.0);
            let dampers = Dampers::at(&self.arm, &q, &self.accelerations, self.period_s);
            // Where nothing is left, nothing is allowed.
            if dampers.bounds.iter().any(|bound| bound.most <= 0.0) {
                return None;
            }
        }
        Some(q)
    }

    /// Whether so many numbers of a pose, of its place first, are met.
    fn is_near(&self, q: &Joints, wanted: &arm::Pose, numbers: usize) -> bool {
        let way = self.to(q, wanted);
        way.iter().take(numbers).all(|x| x.abs() < NEAR)
    }

    /// The camera's motion to a pose, along its axes, m and rad.
    fn to(&self, q: &Joints, wanted: &arm::Pose) -> [f64; 6] {
        let camera = self.arm.chain.pose(q);
        let apart = camera.inverse() * wanted;
        // The angle of a rotation matrix is NaN where rounding takes its trace past 3.
        let turn = UnitQuaternion::from_rotation_matrix(&apart.rotation);
        let (linear, angular) = (apart.translation.vector, turn.scaled_axis());
        [
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
        ]
    }
}

fn rigid(pose: &Pose) -> arm::Pose {
    arm::Pose::from_parts(
        Translation3::from(pose.translation),
        Rotation3::new(Vector3::from(pose.rotation)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's robot scene, with the shipped Panda ready at the goal, and a table under it.
    fn scene(table_m: f64) -> Scene {
        let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = \"panda.toml\"\n{}", scene::PAPER_ROBOT);
        let mut scene = Scene::parse(&text, beside).unwrap();
        let arm = scene.arm.as_mut().unwrap();
        arm.goal.extend(arm::READY);
        let wall = scene::Wall {
            normal: [0.0, 0.0, 1.0],
            offset: table_m,
        };
        arm.walls.push(wall).unwrap();
        scene
    }

    /// The goal, with the camera that much along its axes.
    fn moved(scene: &Scene, [x, y, z]: [f64; 3], roll: f64) -> Pose {
        let [a, b, c] = scene.goal.translation;
        Pose {
            translation: [a - x, b - y, c - z],
            rotation: [0.0, 0.0, roll],
        }
    }

    #[test]
    fn an_arm_reaches_what_is_near_and_neither_beyond_its_range_nor_below_a_table() {
        let scene = scene(0.2);
        let reach = Reach::of(&scene).unwrap();
        let includes = |way, roll| reach.nearest(&moved(&scene, way, roll)).is_some();
        assert!(includes([0.0; 3], 0.0));
        assert!(includes([0.1, 0.05, -0.1], 0.4));
        let near = (1..200).map(|k| [0.1, 0.02, -0.05].map(|x| x * f64::from(k) / 200.0));
        let all: Vec<_> = near.filter(|way| !includes(*way, 0.0)).collect();
        assert!(all.is_empty(), "{all:?}");
        // Far away; up to where the arm is stretched; joint 7 to its end.
        assert!(!includes([0.0, -1.0, 0.0], 0.0));
        assert!(!includes([0.0, 0.0, -0.7], 0.0));
        assert!(includes([0.0; 3], 2.6) && !includes([0.0; 3], -2.6));
        // The camera is some 0.55 m up, and looks down.
        let high = self::scene(0.4);
        let below = moved(&high, [0.0, 0.0, 0.2], 0.0);
        assert_eq!(reach.nearest(&below), Some(below));
        assert_eq!(Reach::of(&high).unwrap().nearest(&below), None);
    }

    #[test]
    fn without_joints_at_the_goal_nothing_is_known() {
        let mut scene = scene(0.2);
        scene.arm.as_mut().unwrap().goal.clear();
        assert!(Reach::of(&scene).is_none());
        scene.arm = None;
        assert!(Reach::of(&scene).is_none());
    }
}
