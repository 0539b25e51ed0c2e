//! Forward kinematics of an arm, and its Jacobian.
//!
//! Frames: O the base; F the flange; EE the end effector, fixed to the flange. Source: Franka
//! Emika, "Robot and interface specifications", table of DH parameters (Craig's convention).

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use nalgebra::{
    IsometryMatrix3, Matrix3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3,
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

/// Where a frame is in another: x_other = R x + t, m.
pub type Pose = IsometryMatrix3<f64>;

/// A line of the table: a, d, and the twist alpha as its cosine and sine, which are exact in the
/// table's quarter turns.
pub struct Link {
    /// m.
    pub a: f64,
    /// m.
    pub d: f64,
    /// Of alpha.
    pub cos: f64,
    /// Of alpha.
    pub sin: f64,
}

const fn link(a: f64, d: f64, cos: f64, sin: f64) -> Link {
    Link { a, d, cos, sin }
}

/// Joint 1 to joint 7.
pub const LINKS: [Link; JOINTS] = [
    link(0.0, 0.333, 1.0, 0.0),
    link(0.0, 0.0, 0.0, -1.0),
    link(0.0, 0.316, 0.0, 1.0),
    link(0.0825, 0.0, 0.0, 1.0),
    link(-0.0825, 0.384, 0.0, -1.0),
    link(0.0, 0.0, 0.0, 1.0),
    link(0.088, 0.0, 0.0, 1.0),
];

/// From joint 7 to the flange, along the axis of joint 7, m.
pub const FLANGE: f64 = 0.107;

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

/// A joint's frame in that of the joint before it, where it stands at zero; it turns about its z
/// axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// From its axes to those of the joint before.
    pub rotation: Matrix3<f64>,
    /// Its origin, m.
    pub origin: Vector3<f64>,
    /// Whether it slides along its z axis instead; m in place of rad then.
    pub slides: bool,
}

impl Frame {
    const fn of(link: &Link) -> Self {
        let (cos, sin) = (link.cos, link.sin);
        Self {
            rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos),
            origin: Vector3::new(link.a, -sin * link.d, cos * link.d),
            slides: false,
        }
    }
}

/// The frames of an arm, base to flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// Of its joints; those of joints that it does not have mean nothing.
    pub joints: [Frame; JOINTS],
    /// How many joints it has, 4 to 7.
    pub count: usize,
    /// The flange in the frame of the last joint.
    pub flange: Pose,
}

/// A Franka robot.
pub(crate) static FRANKA: Frames = Frames {
    joints: [
        Frame::of(&LINKS[0]),
        Frame::of(&LINKS[1]),
        Frame::of(&LINKS[2]),
        Frame::of(&LINKS[3]),
        Frame::of(&LINKS[4]),
        Frame::of(&LINKS[5]),
        Frame::of(&LINKS[6]),
    ],
    count: JOINTS,
    flange: Pose {
        rotation: Rotation3::from_matrix_unchecked(Matrix3::new(
            1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
        )),
        translation: Translation3 {
            vector: Vector3::new(0.0, 0.0, FLANGE),
        },
    },
};

/// The arm as a chain of frames from the base to the end effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    frames: &'static Frames,
    flange_from_ee: Pose,
}

/// The end effector and its Jacobian at some joint positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// O_T_EE, the end effector in the base.
    pub pose: Pose,
    /// From joint velocities to the velocity of the end effector's origin along base axes.
    pub jacobian: Jacobian,
}

impl Default for Chain {
    /// A Franka robot; the end effector is the flange.
    fn default() -> Self {
        Self::new(Pose::identity())
    }
}

impl Chain {
    /// A Franka robot with this end effector in its flange (F_T_EE).
    pub const fn new(flange_from_ee: Pose) -> Self {
        Self::of(&FRANKA, flange_from_ee)
    }

    /// An arm with this end effector in its flange (F_T_EE).
    pub const fn of(frames: &'static Frames, flange_from_ee: Pose) -> Self {
        Self {
            frames,
            flange_from_ee,
        }
    }

    /// How many joints it has; further entries of [`Joints`] are zero.
    pub(crate) fn count(&self) -> usize {
        self.frames.count
    }

    /// Whether it is a Franka robot.
    pub(crate) fn is_franka(&self) -> bool {
        std::ptr::eq(self.frames, &raw const FRANKA)
    }

    /// O_T_F, the flange in the base.
    pub fn flange(&self, q: &Joints) -> Pose {
        self.follow(q, |_, _, _| ())
    }

    /// O_T_EE, the end effector in the base.
    pub fn pose(&self, q: &Joints) -> Pose {
        self.flange(q) * self.flange_from_ee
    }

    /// The end effector with its Jacobian.
    pub fn posture(&self, q: &Joints) -> Posture {
        let mut axes = [Vector3::zeros(); JOINTS];
        let mut origins = [Vector3::zeros(); JOINTS];
        let flange = self.follow(q, |joint, rotation, origin| {
            axes[joint] = rotation.column(2).into();
            origins[joint] = *origin;
        });
        let pose = flange * self.flange_from_ee;
        let mut jacobian = Jacobian::zeros();
        for joint in 0..self.frames.count {
            let axis = axes[joint];
            let column = match self.frames.joints[joint].slides {
                true => join(&axis, &Vector3::zeros()),
                false => join(
                    &axis.cross(&(pose.translation.vector - origins[joint])),
                    &axis,
                ),
            };
            jacobian.set_column(joint, &column);
        }
        Posture { pose, jacobian }
    }

    /// Walks from the base to the flange, which it returns, and shows each joint's frame (rotation,
    /// origin) on the way.
    fn follow(
        &self,
        q: &Joints,
        mut show: impl FnMut(usize, &Matrix3<f64>, &Vector3<f64>),
    ) -> Pose {
        let mut rotation = Matrix3::identity();
        let mut origin = Vector3::zeros();
        let Frames {
            joints,
            count,
            flange,
        } = self.frames;
        for (joint, frame) in joints.iter().enumerate().take(*count) {
            origin += rotation * frame.origin;
            if frame.slides {
                rotation *= frame.rotation;
                origin += rotation.column(2) * q[joint];
            } else {
                let (s, c) = q[joint].sin_cos();
                let turn = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
                rotation *= frame.rotation * turn;
            }
            show(joint, &rotation, &origin);
        }
        origin += rotation * flange.translation.vector;
        Pose::from_parts(
            Translation3::from(origin),
            Rotation3::from_matrix_unchecked(rotation * flange.rotation.matrix()),
        )
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

/// The error from `actual` to `wanted`, as the twist (base axes) that corrects it in one second.
pub fn difference(wanted: &Pose, actual: &Pose) -> Twist {
    let linear = wanted.translation.vector - actual.translation.vector;
    let angular = rotation_vector(&(wanted.rotation * actual.rotation.inverse()));
    join(&linear, &angular)
}

/// The rotation vector, rad. nalgebra's own takes the angle from its cosine alone, which knows
/// small angles to 1e-8 only and is no number where rounding takes the cosine past one. Near half a
/// turn, where the sine says nothing of the axis, the quaternion does.
pub fn rotation_vector(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let m = rotation.matrix();
    let sine = Vector3::new(
        m[(2, 1)] - m[(1, 2)],
        m[(0, 2)] - m[(2, 0)],
        m[(1, 0)] - m[(0, 1)],
    ) * 0.5;
    let (s, c) = (sine.norm(), 0.5 * (m.trace() - 1.0));
    if c < -0.99 {
        UnitQuaternion::from_rotation_matrix(rotation).scaled_axis()
    } else if s < 1e-12 {
        sine
    } else {
        sine * (s.atan2(c) / s)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn the_ready_position_is_where_the_data_sheet_has_it() {
        let flange = Chain::default().flange(&Joints::from(READY));
        let expected = Vector3::new(0.306_890_566, 0.0, 0.590_282_1);
        assert!((flange.translation.vector - expected).norm() < 1e-6);
        // The flange points down, its x axis forward.
        assert!((flange.rotation * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn a_difference_of_any_size_mends_itself() {
        for angle in [0.0, 1e-13, 1e-9, 1e-3, 1.0, 3.0, PI - 1e-6] {
            let vector = Vector3::new(0.6, 0.0, -0.8) * angle;
            let wanted = Pose::from_parts(Translation3::new(0.1, 0.2, 0.3), Rotation3::new(vector));
            let error = difference(&wanted, &Pose::identity());
            let expected = Twist::new(0.1, 0.2, 0.3, vector.x, vector.y, vector.z);
            assert!((error - expected).norm() < 1e-9 * (1e-6 + angle), "{angle}");
        }
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_pose() {
        let ee = Pose::from_parts(
            Translation3::new(0.05, -0.03, 0.1),
            Rotation3::new(Vector3::new(0.3, -0.2, 0.5)),
        );
        let chain = Chain::new(ee);
        let q = Joints::from([0.3, -0.6, 0.4, -1.9, 0.7, 1.4, -0.9]);
        let jacobian = chain.posture(&q).jacobian;
        let h = 1e-6;
        for joint in 0..JOINTS {
            let mut step = Joints::zeros();
            step[joint] = h;
            let numeric =
                difference(&chain.pose(&(q + step)), &chain.pose(&(q - step))) / (2.0 * h);
            assert!((numeric - jacobian.column(joint)).norm() < 1e-9);
        }
    }
}
