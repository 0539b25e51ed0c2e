//! The camera on the flange, and what its motion is at the end effector, which is another place:
//! the flange is O_T_EE F_T_EE^-1.

use nalgebra::{Rotation3, Vector3};

use crate::kinematics::{Pose, Twist, join, split};

/// The hand-eye mounting: a camera (x right, y down, z forward) fixed to the flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// F_T_C, the camera in the flange.
    pub flange_from_camera: Pose,
}

impl Mount {
    /// O_T_C, the camera in the base, from the flange in the base.
    pub fn camera(&self, base_from_flange: &Pose) -> Pose {
        base_from_flange * self.flange_from_camera
    }

    /// The flange in the base that puts the camera at `base_from_camera`.
    pub fn flange(&self, base_from_camera: &Pose) -> Pose {
        base_from_camera * self.flange_from_camera.inverse()
    }

    /// Velocity of the end effector's origin along base axes while the camera's origin moves at
    /// `twist` along camera axes. The robot's state tells the rotation of O_T_EE, and F_T_EE.
    pub fn to_base(
        &self,
        base_from_ee: &Rotation3<f64>,
        flange_from_ee: &Pose,
        twist: &Twist,
    ) -> Twist {
        let (base_from_camera, lever) = self.at(base_from_ee, flange_from_ee);
        let (linear, angular) = split(twist);
        let angular = base_from_camera * angular;
        let linear = base_from_camera * linear - angular.cross(&lever);
        join(&linear, &angular)
    }

    /// The inverse of [`Self::to_base`]: the camera's velocity along camera axes.
    pub fn to_camera(
        &self,
        base_from_ee: &Rotation3<f64>,
        flange_from_ee: &Pose,
        twist: &Twist,
    ) -> Twist {
        let (base_from_camera, lever) = self.at(base_from_ee, flange_from_ee);
        let camera_from_base = base_from_camera.inverse();
        let (linear, angular) = split(twist);
        let linear = linear + angular.cross(&lever);
        join(&(camera_from_base * linear), &(camera_from_base * angular))
    }

    /// The camera's axes in the base, and where it is from the end effector, along base axes.
    fn at(
        &self,
        base_from_ee: &Rotation3<f64>,
        flange_from_ee: &Pose,
    ) -> (Rotation3<f64>, Vector3<f64>) {
        let camera = flange_from_ee.inverse() * self.flange_from_camera;
        let lever = base_from_ee * camera.translation.vector;
        (base_from_ee * camera.rotation, lever)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use crate::kinematics::{Chain, Joints};

    /// The Franka Hand: turned by -45 deg, its fingertips 103.4 mm from the flange.
    fn hand() -> Pose {
        Pose::from_parts(
            Translation3::new(0.0, 0.0, 0.1034),
            Rotation3::new(Vector3::z() * -std::f64::consts::FRAC_PI_4),
        )
    }

    fn mount() -> Mount {
        Mount {
            flange_from_camera: Pose::from_parts(
                Translation3::new(0.07, -0.04, 0.05),
                Rotation3::new(Vector3::new(0.1, -0.2, 0.8)),
            ),
        }
    }

    const POSITIONS: [f64; 7] = [0.4, -0.5, 0.2, -2.0, 0.3, 1.7, 0.6];

    #[test]
    fn the_camera_moves_as_told_when_the_joints_move_the_flange_so() {
        let (hand, mount) = (hand(), mount());
        let chain = Chain::FRANKA.with_ee(hand);
        let q = Joints::from(POSITIONS);
        let dq = Joints::from([0.3, -0.2, 0.5, 0.1, -0.4, 0.6, -0.7]);
        let ee = chain.pose(&q).rotation;
        let twist = mount.to_camera(&ee, &hand, &(chain.jacobian(&q) * dq));
        let h = 1e-6;
        let before = mount.camera(&chain.flange(&(q - dq * h)));
        let after = mount.camera(&chain.flange(&(q + dq * h)));
        let camera = mount.camera(&chain.flange(&q)).rotation;
        let linear = (after.translation.vector - before.translation.vector) / (2.0 * h);
        let turn = after.rotation * before.rotation.inverse();
        let angular = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis() / (2.0 * h);
        let numeric = join(&(camera.inverse() * linear), &(camera.inverse() * angular));
        assert!((numeric - twist).norm() < 1e-9);
    }

    #[test]
    fn there_and_back_is_the_same_motion_and_the_same_place() {
        let mount = mount();
        let flange = Chain::FRANKA.flange(&Joints::from(POSITIONS));
        let twist = Twist::new(0.1, -0.2, 0.3, 0.4, -0.5, 0.6);
        let hand = hand();
        let ee = flange.rotation * hand.rotation;
        let back = mount.to_camera(&ee, &hand, &mount.to_base(&ee, &hand, &twist));
        assert!((back - twist).norm() < 1e-14);
        let there = mount.flange(&mount.camera(&flange));
        assert!((there.to_homogeneous() - flange.to_homogeneous()).norm() < 1e-12);
    }
}
