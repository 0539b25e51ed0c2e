//! Forward kinematics and Jacobian by the product of exponentials: each joint is an axis through a
//! point, both as they are where all joints stand at zero.
//!
//! Frames: O the base; F the flange; EE the end effector, fixed to the flange. Source: R. Brockett,
//! "Robotic manipulators and the product of exponentials formula", 1984; lengths from Franka
//! Emika, "Robot and interface specifications". The emulator has kinematics of its own, by
//! Denavit-Hartenberg parameters: `hw-sim/panda/tests/twins.rs` compares the two.

use core::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::{
    IsometryMatrix3, Matrix3, Rotation3, SMatrix, SVector, Translation3, Unit, Vector3,
};

/// Joints of the arm.
pub const JOINTS: usize = 7;

/// One number a joint, base to flange: rad, rad/s, rad/s^2 or rad/s^3.
pub type Joints = SVector<f64, JOINTS>;

/// A velocity (vx vy vz in m/s, wx wy wz in rad/s) of a frame's origin, along the axes that the
/// context names; also its first two derivatives.
pub type Twist = SVector<f64, 6>;

/// Rows as a [`Twist`], a column for each joint.
pub type Jacobian = SMatrix<f64, 6, JOINTS>;

/// The pose of a frame in another: x_other = R x + t, m.
pub type Pose = IsometryMatrix3<f64>;

/// The axis of each joint, and a point on it, m, of the arm that stands straight up, its hand
/// forward and down.
const SCREWS: [([f64; 3], [f64; 3]); JOINTS] = [
    ([0.0, 0.0, 1.0], [0.0, 0.0, 0.333]),
    ([0.0, 1.0, 0.0], [0.0, 0.0, 0.333]),
    ([0.0, 0.0, 1.0], [0.0, 0.0, 0.649]),
    ([0.0, -1.0, 0.0], [0.0825, 0.0, 0.649]),
    ([0.0, 0.0, 1.0], [0.0, 0.0, 1.033]),
    ([0.0, -1.0, 0.0], [0.0, 0.0, 1.033]),
    ([0.0, 0.0, -1.0], [0.088, 0.0, 1.033]),
];

/// The flange of that arm: its origin, m, and its axes, the x axis forward and the z axis down.
const FLANGE: Vector3<f64> = Vector3::new(0.088, 0.0, 0.926);
const FLANGE_AXES: Matrix3<f64> = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);

/// The ready position that Franka's examples start from, rad.
pub const READY: [f64; JOINTS] = [
    0.0,
    -FRAC_PI_4,
    0.0,
    -3.0 * FRAC_PI_4,
    0.0,
    FRAC_PI_2,
    FRAC_PI_4,
];

/// The arm as a chain of joints from the base to the end effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    flange_from_ee: Pose,
}

impl Default for Chain {
    /// The end effector is the flange.
    fn default() -> Self {
        Self::new(Pose::identity())
    }
}

impl Chain {
    /// An arm with this end effector in its flange (F_T_EE).
    pub const fn new(flange_from_ee: Pose) -> Self {
        Self { flange_from_ee }
    }

    /// O_T_F, the flange in the base.
    pub fn flange(&self, q: &Joints) -> Pose {
        self.walk(q, |_, _, _| ())
    }

    /// O_T_EE, the end effector in the base.
    pub fn pose(&self, q: &Joints) -> Pose {
        self.flange(q) * self.flange_from_ee
    }

    /// The origins of base, joints 1 to 7 and flange in the base, m.
    pub fn places(&self, q: &Joints) -> [Vector3<f64>; JOINTS + 2] {
        let mut places = [Vector3::zeros(); JOINTS + 2];
        let flange = self.walk(q, |joint, _, point| places[joint + 1] = *point);
        places[JOINTS + 1] = flange.translation.vector;
        places
    }

    /// From joint velocities to the velocity of the end effector's origin along base axes.
    pub fn jacobian(&self, q: &Joints) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        let flange = self.walk(q, |joint, axis, point| {
            // The velocity of the base's origin, which the end effector's replaces below.
            let moment = point.cross(axis);
            jacobian.set_column(joint, &join(&moment, axis));
        });
        let origin = (flange * self.flange_from_ee).translation.vector;
        for mut column in jacobian.column_iter_mut() {
            let turn = Vector3::from(column.fixed_rows::<3>(3)).cross(&origin);
            let mut linear = column.fixed_rows_mut::<3>(0);
            linear += turn;
        }
        jacobian
    }

    /// Walks from the base to the flange, which it returns, and shows the axis and the point of
    /// each joint on the way, in the base.
    fn walk(&self, q: &Joints, mut show: impl FnMut(usize, &Vector3<f64>, &Vector3<f64>)) -> Pose {
        let mut rotation = Rotation3::identity();
        let mut shift = Vector3::zeros();
        for (joint, (axis, point)) in SCREWS.into_iter().enumerate() {
            let (axis, point) = (Vector3::from(axis), Vector3::from(point));
            let place = rotation * point + shift;
            show(joint, &(rotation * axis), &place);
            rotation *= Rotation3::from_axis_angle(&Unit::new_unchecked(axis), q[joint]);
            shift = place - rotation * point;
        }
        let origin = rotation * FLANGE + shift;
        let axes = rotation * Rotation3::from_matrix_unchecked(FLANGE_AXES);
        Pose::from_parts(Translation3::from(origin), axes)
    }
}

/// Linear and angular part.
pub(crate) fn split(twist: &Twist) -> (Vector3<f64>, Vector3<f64>) {
    (
        twist.fixed_rows::<3>(0).into(),
        twist.fixed_rows::<3>(3).into(),
    )
}

/// A twist of a linear and an angular part.
pub(crate) fn join(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Twist {
    Twist::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ready_position_is_that_of_the_data_sheet() {
        let flange = Chain::default().flange(&Joints::from(READY));
        let expected = Vector3::new(0.306_890_566, 0.0, 0.590_282_1);
        assert!((flange.translation.vector - expected).norm() < 1e-6);
        // The flange points down, its x axis forward.
        assert!((flange.rotation * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_pose() {
        let ee = Pose::from_parts(
            Translation3::new(0.05, -0.03, 0.1),
            Rotation3::new(Vector3::new(0.3, -0.2, 0.5)),
        );
        let chain = Chain::new(ee);
        let q = Joints::from([0.3, -0.6, 0.4, -1.9, 0.7, 1.4, -0.9]);
        let jacobian = chain.jacobian(&q);
        let h = 1e-6;
        for joint in 0..JOINTS {
            let mut step = Joints::zeros();
            step[joint] = h;
            let (after, before) = (chain.pose(&(q + step)), chain.pose(&(q - step)));
            let linear = (after.translation.vector - before.translation.vector) / (2.0 * h);
            let turn = (after.rotation.matrix() - before.rotation.matrix()) / (2.0 * h)
                * chain.pose(&q).rotation.matrix().transpose();
            let angular = Vector3::new(turn[(2, 1)], turn[(0, 2)], turn[(1, 0)]);
            assert!((join(&linear, &angular) - jacobian.column(joint)).norm() < 1e-9);
        }
    }
}
