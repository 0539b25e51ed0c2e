//! From a velocity of the end effector to velocities of the joints.
//!
//! Damped least squares for the six dimensions of the task; the seventh is the elbow's, which stays
//! at the position of joint 3 that the motion began with, unless a joint comes near the end of its
//! range. An arm with fewer than six joints does the nearest that it can, a radian counting as a
//! metre. Source: A. Maciejewski and C. Klein, "Numerical filtering for the operation of robotic
//! manipulators ...", J. Robotic Systems 5(6), 1988 (damping); A. Liegeois, "Automatic supervisory
//! control of the configuration and behavior of multibody mechanisms", IEEE SMC 7(12), 1977 (null
//! space).

use nalgebra::{Cholesky, Matrix6, SMatrix, UnitQuaternion};

use crate::kinematics::{Chain, JOINTS, Jacobian, Joints, Pose, Twist};
use crate::limits::{Limits, PERIOD, Setpoint};
use crate::ramp::Ramp;

/// Manipulability sqrt(det(J J^T)) under which damping sets in, m^3; 0.08 in the ready position.
const SINGULAR: f64 = 0.01;
/// The same of fewer than six joints: sqrt(det(J^T J)), lengths as shares of the longest lever.
const SINGULAR_OF_FEW: f64 = 0.02;
/// The damping in a singularity, mixed units of the Jacobian.
const DAMPING: f64 = 0.05;
/// What keeps J J^T from being singular, its unit.
const ROUNDING: f64 = 1e-8;
/// The index of joint 3.
pub const ELBOW: usize = 2;
/// Rate at which joint 3 returns to its reference, 1/s.
const ELBOW_RATE: f64 = 2.0;
/// The most that the reference of a joint 3 that is to turn is ahead of it, rad.
const ELBOW_LEAD: f64 = 0.05;
/// Squared part of joint 3 in the free direction under which the elbow is no longer held.
const ELBOW_FADE: f64 = 0.02;
/// Distance from the end of a joint's range at which it is pushed back, rad, and the speed at the
/// end, rad/s.
const MARGIN: f64 = 0.25;
const REPULSION: f64 = 1.0;
/// The most that the elbow may move the joints, rad/s, and its bounds: a small share of any
/// joint's.
const ELBOW_SPEED: f64 = 0.3;
const ELBOW_RAMP: Ramp = Ramp {
    acceleration: 1.0,
    jerk: 100.0,
};

/// Longest step of a search for a posture, rad or m.
const LONGEST: f64 = 0.3;
/// A posture is found where it misses the pose by less, m and rad together.
const FOUND: f64 = 1e-9;
/// So far off may be the nearest posture of fewer than six joints, m and rad together: what a
/// camera's picture leaves unsure.
const NEAR: f64 = 0.03;

/// From the velocity of the end effector (base axes) to the least velocities of the joints.
pub type Inverse = SMatrix<f64, JOINTS, 6>;

/// J^T (J J^T + damping)^-1, damped near a singularity only; zero for a Jacobian that is not
/// finite.
pub fn inverse(jacobian: &Jacobian) -> Inverse {
    damped_square(jacobian).map_or_else(Inverse::zeros, |square| jacobian.transpose() * square)
}

/// (J J^T + damping)^-1; `None` for a Jacobian that is not finite.
fn damped_square(jacobian: &Jacobian) -> Option<Matrix6<f64>> {
    let square = jacobian * jacobian.transpose();
    if !has_few_joints(jacobian) {
        let damping = damping(measure(&square) / SINGULAR);
        return inverted(&square, damping * damping);
    }
    let lever = lever(jacobian);
    let damping = lever * damping(measure_of_few(jacobian, lever) / SINGULAR_OF_FEW);
    inverted(&square, (damping * damping).max(ROUNDING))
}

/// [`Chain::has_few_joints`], by the columns of the joints that the arm does not have.
fn has_few_joints(jacobian: &Jacobian) -> bool {
    jacobian.column(5).amax() == 0.0
}

/// (J J^T)^-1, but for rounding; `None` for a Jacobian that is not finite.
pub(crate) fn square(jacobian: &Jacobian) -> Option<Matrix6<f64>> {
    inverted(&(jacobian * jacobian.transpose()), ROUNDING)
}

fn inverted(square: &Matrix6<f64>, more: f64) -> Option<Matrix6<f64>> {
    Cholesky::new(square + Matrix6::identity() * more).map(|f| f.inverse())
}

/// Manipulability, from J J^T, m^3.
fn measure(square: &Matrix6<f64>) -> f64 {
    Cholesky::new(*square).map_or(0.0, |f| f.l_dirty().diagonal().product())
}

/// The longest lever at which a joint moves the end effector, m; 1 of a joint that slides.
fn lever(jacobian: &Jacobian) -> f64 {
    let levers = jacobian
        .column_iter()
        .map(|column| column.fixed_rows::<3>(0).norm());
    levers.fold(0.0, f64::max)
}

/// Manipulability of fewer than six joints, lengths as shares of this one.
fn measure_of_few(jacobian: &Jacobian, lever: f64) -> f64 {
    let mut jacobian = *jacobian;
    jacobian.fixed_rows_mut::<3>(0).unscale_mut(lever);
    let mut square = jacobian.transpose() * jacobian;
    for k in 0..JOINTS {
        // The arm does not have this joint.
        if square[(k, k)] == 0.0 {
            square[(k, k)] = 1.0;
        }
    }
    Cholesky::new(square).map_or(0.0, |f| f.l_dirty().diagonal().product())
}

/// The damping at this share of the manipulability under which it sets in.
fn damping(share: f64) -> f64 {
    (1.0 - share).max(0.0) * DAMPING
}

/// The velocities of seven joints with which joint 3, the elbow, turns at 1 rad/s while the end
/// effector stands: less where that hardly turns it, zero for an arm with fewer joints.
pub fn elbow(inverse: &Inverse, jacobian: &Jacobian) -> Joints {
    if jacobian.column(JOINTS - 1).amax() == 0.0 {
        return Joints::zeros();
    }
    let free = free(inverse, jacobian, ELBOW);
    free / (free[ELBOW] + ELBOW_FADE)
}

/// The inverse with the elbow held, which would move so.
pub fn held(inverse: &Inverse, elbow: &Joints) -> Inverse {
    inverse - elbow * inverse.row(ELBOW)
}

/// A posture that brings the end of a chain to a pose, by at most so many Newton steps from `q`,
/// and how many it took; with the elbow held, joint 3 stays. Fewer than six joints bring it as near
/// as they can. `None` if the steps find none.
pub fn posture(
    chain: &Chain,
    mut q: Joints,
    wanted: &Pose,
    is_elbow_held: bool,
    steps: usize,
) -> (Option<Joints>, usize) {
    for taken in 0..steps {
        let (at, mut jacobian) = chain.at(&q);
        let apart = wanted.translation.vector - at.translation.vector;
        // The angle of a rotation matrix is NaN where rounding takes its trace past 3.
        let turn = wanted.rotation * at.rotation.inverse();
        let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis();
        let error = Twist::new(apart.x, apart.y, apart.z, turn.x, turn.y, turn.z);
        if error.norm() < FOUND {
            return (Some(q), taken);
        }
        if is_elbow_held {
            jacobian.column_mut(ELBOW).fill(0.0);
        }
        let step = inverse(&jacobian) * error;
        let is_nearest = error.norm() < NEAR && step.amax() < FOUND;
        if is_nearest && chain.has_few_joints() {
            return (Some(q), taken);
        }
        q += step * (LONGEST / step.amax()).min(1.0);
    }
    (None, steps)
}

/// The velocity inverse kinematics during one motion.
#[derive(Clone, Copy, Debug)]
pub struct VelocityIk {
    chain: Chain,
    limits: &'static Limits,
    /// Where joint 3 is to be, rad.
    elbow: f64,
    /// The direction in which joints move without the end effector, of length 1; its sign does not
    /// jump.
    free: Joints,
    /// Velocity along it, rad/s, and acceleration.
    speed: f64,
    acceleration: f64,
}

impl VelocityIk {
    /// A motion begins at rest at `q`.
    pub fn new(chain: Chain, limits: &'static Limits, q: &Joints) -> Self {
        let jacobian = chain.jacobian(q);
        let inverse = inverse(&jacobian);
        let columns = (0..JOINTS).map(|joint| free(&inverse, &jacobian, joint));
        let longest = columns.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
        let longest = longest.unwrap_or_default();
        // Positive turns joint 3 forward, where it can.
        let sign = if longest[ELBOW] < 0.0 { -1.0 } else { 1.0 };
        Self {
            chain,
            limits,
            elbow: q[ELBOW],
            free: longest.normalize() * sign,
            speed: 0.0,
            acceleration: 0.0,
        }
    }

    /// Joint velocities for the period that begins at `from`, such that the end effector moves at
    /// `twist` (base axes) and joint 3 at `elbow`, rad/s. An elbow that is `None` comes to rest
    /// wherever it is.
    pub fn step(&mut self, from: &Setpoint, twist: &Twist, elbow: Option<f64>) -> Joints {
        // In the middle of the period: with that Jacobian a step is exact to second order.
        let q = from.q + (from.dq + from.ddq * PERIOD) * (0.5 * PERIOD);
        let jacobian = self.chain.jacobian(&q);
        let inverse = inverse(&jacobian);
        let free = free(&inverse, &jacobian, self.free.iamax());
        let length = free.norm();
        // Where no direction is free of the damped task any more, the last one stands.
        if length > 1e-6 {
            self.free = free * (free.dot(&self.free).signum() / length);
        }
        let task = inverse * twist;
        let target = elbow.map_or(0.0, |rate| self.elbow_speed(&q, task[ELBOW], rate));
        (self.speed, self.acceleration) =
            ELBOW_RAMP.step(self.speed, self.acceleration, target, PERIOD);
        task + self.free * self.speed
    }

    /// The speed along the free direction that holds joint 3, which the task turns at `task` rad/s,
    /// at its reference, which moves at `rate`, and keeps all joints off the ends of their ranges.
    fn elbow_speed(&mut self, q: &Joints, task: f64, rate: f64) -> f64 {
        if rate != 0.0 {
            let led = self.elbow + rate * PERIOD;
            self.elbow = led.clamp(q[ELBOW] - ELBOW_LEAD, q[ELBOW] + ELBOW_LEAD);
        }
        // Where the free direction hardly turns joint 3, the quotient fades instead of growing.
        let turns = self.free[ELBOW];
        let share = turns / (turns * turns + ELBOW_FADE);
        let hold = share * (ELBOW_RATE * (self.elbow - q[ELBOW]) + rate - task);
        (hold + self.free.dot(&self.repulsion(q))).clamp(-ELBOW_SPEED, ELBOW_SPEED)
    }

    /// Joint velocities away from the ends of the joints' ranges, rad/s; zero farther than
    /// [`MARGIN`] from them.
    fn repulsion(&self, q: &Joints) -> Joints {
        Joints::from_fn(|k, _| {
            let [below, above] = self.limits.0[k].room(q[k]);
            let near = (1.0 - below.min(above) / MARGIN).clamp(0.0, 1.0);
            REPULSION * near * near * if below < above { 1.0 } else { -1.0 }
        })
    }
}

/// The part of a unit velocity of `joint` that leaves the end effector where it is.
fn free(inverse: &Inverse, jacobian: &Jacobian, joint: usize) -> Joints {
    let mut free = -inverse * jacobian.column(joint);
    free[joint] += 1.0;
    free
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::READY;
    use crate::limits::Model;

    const LIMITS: &Limits = Model::Panda.limits();

    /// The joints after so many milliseconds at this velocity.
    fn follow(q: [f64; 7], twist: Twist, ticks: usize) -> (Chain, Joints) {
        let chain = Chain::FRANKA;
        let mut desired = Setpoint {
            q: Joints::from(q),
            dq: Joints::zeros(),
            ddq: Joints::zeros(),
        };
        let mut ik = VelocityIk::new(chain, LIMITS, &desired.q);
        for _ in 0..ticks {
            desired = desired.after(&ik.step(&desired, &twist, Some(0.0)));
        }
        (chain, desired.q)
    }

    #[test]
    fn the_end_effector_follows_and_the_elbow_stays() {
        let (chain, q) = follow(READY, Twist::new(0.0, 0.1, 0.0, 0.0, 0.0, 0.0), 2000);
        let went = chain.pose(&q).translation.y - chain.pose(&Joints::from(READY)).translation.y;
        assert!((went - 0.2).abs() < 1e-5, "{went}");
        assert!(q[2].abs() < 0.05, "{}", q[2]);
    }

    #[test]
    fn the_joints_allow_less_than_the_end_effector_may() {
        // At the ready position, along x: 2.38 m/s^2 of 13, joint 2 being the first.
        let joints = inverse(&Chain::FRANKA.jacobian(&Joints::from(READY))) * Twist::x();
        let most = (0..JOINTS).map(|k| LIMITS.0[k].acceleration / joints[k].abs());
        let least = most.fold(f64::INFINITY, f64::min);
        assert!((least - 2.38).abs() < 0.005, "{least}");
    }

    #[test]
    fn a_joint_near_its_limit_is_pushed_back_in_the_null_space() {
        let mut q = READY;
        q[6] = LIMITS.0[6].range[1] - 0.05;
        let (chain, after) = follow(q, Twist::zeros(), 3000);
        assert!(after[6] < q[6] - 0.02, "{}", after[6]);
        let apart =
            chain.pose(&after).translation.vector - chain.pose(&Joints::from(q)).translation.vector;
        assert!(apart.norm() < 1e-5, "{}", apart.norm());
    }

    #[test]
    fn joint_velocities_stay_bounded_in_a_singularity() {
        // The outstretched arm cannot go further out.
        let q = Joints::from([0.0, 0.0, 0.0, -0.07, 0.0, 1.6, 0.0]);
        let inverse = inverse(&Chain::FRANKA.jacobian(&q));
        assert!(inverse.amax() * 0.1 < 2.0, "{inverse}");
    }
}
