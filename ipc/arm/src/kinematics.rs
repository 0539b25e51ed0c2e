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

/// Most joints of an arm.
pub const JOINTS: usize = 7;

/// One number a joint, base to flange: rad, rad/s, rad/s^2 or rad/s^3 of one that turns, m and so
/// on of one that slides.
pub type Joints = SVector<f64, JOINTS>;

/// The numbers of an arm's joints, at most seven; further entries are zero.
pub fn joints(numbers: &[f64]) -> Joints {
    let all = numbers.iter().copied().chain(core::iter::repeat(0.0));
    Joints::from_iterator(all.take(JOINTS))
}

/// A velocity (vx vy vz in m/s, wx wy wz in rad/s) of a frame's origin, along the axes that the
/// context names; also its first two derivatives.
pub type Twist = SVector<f64, 6>;

/// Rows as a [`Twist`], a column for each joint.
pub type Jacobian = SMatrix<f64, 6, JOINTS>;

/// The pose of a frame in another: x_other = R x + t, m.
pub type Pose = IsometryMatrix3<f64>;

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

/// A joint of a chain, as it is where all joints stand at zero; base axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screw {
    /// The direction about which it turns, or along which it slides, of length 1.
    pub axis: Vector3<f64>,
    /// A point on the axis, m.
    pub point: Vector3<f64>,
    /// Whether it slides; its position and its limits are in m then.
    pub slides: bool,
}

impl Screw {
    /// The place of a joint that a chain does not have.
    const NONE: Self = Self::turning([0.0; 3], [0.0; 3]);

    /// A joint that turns.
    const fn turning([x, y, z]: [f64; 3], [a, b, c]: [f64; 3]) -> Self {
        Self {
            axis: Vector3::new(x, y, z),
            point: Vector3::new(a, b, c),
            slides: false,
        }
    }
}

/// An arm as a chain of 1 to 7 joints from the base to the flange, and an end effector on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    screws: [Screw; JOINTS],
    count: usize,
    /// Where all joints stand at zero.
    flange: Pose,
    flange_from_ee: Pose,
}

impl Chain {
    /// A Franka Panda or Research 3; its end effector is the flange. At zero it stands straight up,
    /// its hand forward and down.
    pub const FRANKA: Self = Self {
        screws: [
            Screw::turning([0.0, 0.0, 1.0], [0.0, 0.0, 0.333]),
            Screw::turning([0.0, 1.0, 0.0], [0.0, 0.0, 0.333]),
            Screw::turning([0.0, 0.0, 1.0], [0.0, 0.0, 0.649]),
            Screw::turning([0.0, -1.0, 0.0], [0.0825, 0.0, 0.649]),
            Screw::turning([0.0, 0.0, 1.0], [0.0, 0.0, 1.033]),
            Screw::turning([0.0, -1.0, 0.0], [0.0, 0.0, 1.033]),
            Screw::turning([0.0, 0.0, -1.0], [0.088, 0.0, 1.033]),
        ],
        count: JOINTS,
        flange: placed([0.088, 0.0, 0.926], [1.0, -1.0, -1.0]),
        flange_from_ee: placed([0.0; 3], [1.0; 3]),
    };

    /// A chain of these joints, of which the first seven count, with the flange where all stand at
    /// zero; the end effector is the flange.
    pub fn new(joints: &[Screw], flange: Pose) -> Self {
        let mut screws = [Screw::NONE; JOINTS];
        let pairs = screws.iter_mut().zip(joints);
        pairs.for_each(|(to, from)| *to = *from);
        Self {
            screws,
            count: joints.len().min(JOINTS),
            flange,
            flange_from_ee: Pose::identity(),
        }
    }

    /// The same arm with this end effector in its flange (F_T_EE).
    #[must_use]
    pub const fn with_ee(self, flange_from_ee: Pose) -> Self {
        Self {
            flange_from_ee,
            ..self
        }
    }

    /// Its joints.
    #[cfg(test)]
    pub(crate) fn screws(&self) -> &[Screw] {
        &self.screws[..self.count]
    }

    /// How many joints it has; further entries of [`Joints`] mean nothing.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether it has fewer than six, so that its end effector does not move in every direction.
    pub fn has_few_joints(&self) -> bool {
        self.count < 6
    }

    /// O_T_F, the flange in the base.
    pub fn flange(&self, q: &Joints) -> Pose {
        self.walk(q, |_, _, _, _| ())
    }

    /// O_T_EE, the end effector in the base.
    pub fn pose(&self, q: &Joints) -> Pose {
        self.flange(q) * self.flange_from_ee
    }

    /// The origins of base, joints and flange in the base, m; the base's for a joint that the arm
    /// does not have.
    pub fn places(&self, q: &Joints) -> [Vector3<f64>; JOINTS + 2] {
        let mut places = [Vector3::zeros(); JOINTS + 2];
        let flange = self.walk(q, |joint, _, point, _| places[joint + 1] = *point);
        places[JOINTS + 1] = flange.translation.vector;
        places
    }

    /// From joint velocities to the velocity of the end effector's origin along base axes; zero for
    /// a joint that the arm does not have.
    pub fn jacobian(&self, q: &Joints) -> Jacobian {
        self.at(q).1
    }

    /// O_T_EE and the Jacobian.
    pub fn at(&self, q: &Joints) -> (Pose, Jacobian) {
        let mut jacobian = Jacobian::zeros();
        let flange = self.walk(q, |joint, axis, point, _| {
            let column = match self.screws[joint].slides {
                true => join(axis, &Vector3::zeros()),
                // The velocity of the base's origin, which the end effector's replaces below.
                false => join(&point.cross(axis), axis),
            };
            jacobian.set_column(joint, &column);
        });
        let ee = flange * self.flange_from_ee;
        for mut column in jacobian.column_iter_mut() {
            let turn = Vector3::from(column.fixed_rows::<3>(3)).cross(&ee.translation.vector);
            let mut linear = column.fixed_rows_mut::<3>(0);
            linear += turn;
        }
        (ee, jacobian)
    }

    /// How each link has moved from where it is while all joints stand at zero, in the base: entry
    /// k is of the link behind k joints; those behind more than the arm has mean nothing.
    pub fn moved_links(&self, q: &Joints) -> [Pose; JOINTS + 1] {
        let mut moved = [Pose::identity(); JOINTS + 1];
        let flange = self.walk(q, |joint, _, _, before| moved[joint] = before);
        moved[self.count] = flange * self.flange.inverse();
        moved
    }

    /// Walks from the base to the flange, which it returns, and shows the axis and the point of
    /// each joint on the way, in the base, and how the link before it has moved.
    fn walk(
        &self,
        q: &Joints,
        mut show: impl FnMut(usize, &Vector3<f64>, &Vector3<f64>, Pose),
    ) -> Pose {
        let mut rotation = Rotation3::identity();
        let mut shift = Vector3::zeros();
        for (joint, screw) in self.screws.iter().enumerate().take(self.count) {
            let axis = rotation * screw.axis;
            let place = rotation * screw.point + shift;
            let before = Pose::from_parts(Translation3::from(shift), rotation);
            show(joint, &axis, &place, before);
            if screw.slides {
                shift += axis * q[joint];
            } else {
                let axis = Unit::new_unchecked(screw.axis);
                rotation *= Rotation3::from_axis_angle(&axis, q[joint]);
                shift = place - rotation * screw.point;
            }
        }
        let origin = rotation * self.flange.translation.vector + shift;
        Pose::from_parts(Translation3::from(origin), rotation * self.flange.rotation)
    }
}

/// A pose there, m, with these axes of the other frame, or against them.
const fn placed([x, y, z]: [f64; 3], [a, b, c]: [f64; 3]) -> Pose {
    Pose {
        rotation: Rotation3::from_matrix_unchecked(Matrix3::new(
            a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, c,
        )),
        translation: Translation3 {
            vector: Vector3::new(x, y, z),
        },
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
        let flange = Chain::FRANKA.flange(&Joints::from(READY));
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
        let chain = Chain::FRANKA.with_ee(ee);
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
