//! From a velocity of the end effector to velocities of the joints.
//!
//! Damped least squares for the six dimensions of the task; the seventh is the elbow's, which stays
//! at the position of joint 3 that the motion began with, unless a joint comes near the end of its
//! range. An arm with fewer than six joints does the nearest that it can, a radian counting as a
//! metre. Source: A. Maciejewski and C. Klein, "Numerical filtering for the operation of robotic
//! manipulators ...", J. Robotic Systems 5(6), 1988 (damping); Y. Nakamura, "Advanced Robotics"
//! (null space). The real robot's inverse kinematics is not published.

use nalgebra::{Cholesky, Const, DimMin, Matrix6, SMatrix};

use crate::brake::approach;
use crate::kinematics::{Chain, JOINTS, Jacobian, Joints, Pose, Twist, difference, split};
use crate::limits::{Limits, PERIOD, Setpoint};

/// Manipulability sqrt(det(J J^T)) under which damping sets in, m^3; 0.08 in the ready position.
const SINGULAR: f64 = 0.01;
/// The same of fewer than six joints: sqrt(det(J^T J)), lengths as shares of the longest lever.
const SINGULAR_OF_FEW: f64 = 0.02;
/// The damping in a singularity, mixed units of the Jacobian.
const DAMPING: f64 = 0.05;
/// The least damping of fewer than six joints.
pub(crate) const LEAST_DAMPING: f64 = 1e-4;
/// Rate at which the pose of the desired joints is drawn to the integral of commands, 1/s.
const FEEDBACK: f64 = 20.0;
/// The most that this may add, m/s and rad/s: enough for rounding and curvature, too little to race
/// out of a singularity.
const FEEDBACK_MOST: f64 = 0.02;
/// Rate at which joint 3 returns to its reference, 1/s.
const ELBOW_RATE: f64 = 2.0;
/// Squared part of joint 3 in the free direction under which the elbow is no longer held.
pub(crate) const ELBOW_FADE: f64 = 0.02;
/// Distance from the end of a joint's range at which it is pushed back, rad, and the speed at the
/// end, rad/s.
const MARGIN: f64 = 0.25;
const REPULSION: f64 = 1.0;
/// The most that the elbow may move the joints, rad/s, and its bounds, rad/s^2 and rad/s^3: a small
/// share of any joint's.
const ELBOW_SPEED: f64 = 0.3;
const ELBOW_BOUNDS: [f64; 2] = [1.0, 100.0];

/// The velocity inverse kinematics during one motion.
#[derive(Clone, Copy, Debug)]
pub struct VelocityIk {
    chain: Chain,
    limits: &'static Limits,
    /// Where joint 3 is to be, rad, and how fast that moves, rad/s.
    elbow: f64,
    elbow_rate: f64,
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
        let mut ik = Self {
            chain,
            limits,
            elbow: q[2],
            elbow_rate: 0.0,
            free: Joints::zeros(),
            speed: 0.0,
            acceleration: 0.0,
        };
        let jacobian = chain.posture(q).jacobian;
        let system = System::new(&jacobian);
        let columns = (0..JOINTS).map(|joint| system.free(joint));
        let longest = columns.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
        // Positive turns joint 3 forward, where it can.
        let free = longest.unwrap_or_default();
        ik.free = free.normalize() * if free[2] < 0.0 { -1.0 } else { 1.0 };
        ik
    }

    /// Where fewer than six joints have the end effector; `None` for six or more.
    pub fn pose_of_few(&self, q: &Joints) -> Option<Pose> {
        (self.chain.count() < 6).then(|| self.chain.pose(q))
    }

    /// Joint 3 is to be there after the next period, rad.
    pub fn turn_elbow(&mut self, elbow: f64) {
        self.elbow_rate = (elbow - self.elbow) / PERIOD;
        self.elbow = elbow;
    }

    /// Joint velocities for the period that begins at `from`, such that the end effector moves at
    /// `twist` (base axes) and is at `reference` in the middle of the period.
    pub fn step(&mut self, from: &Setpoint, twist: &Twist, reference: &Pose) -> Joints {
        // In the middle of the period: with that Jacobian a step is exact to second order.
        let q = from.q + (from.dq + from.ddq * PERIOD) * (0.5 * PERIOD);
        let posture = self.chain.posture(&q);
        let wanted = twist + feedback(&difference(reference, &posture.pose));
        let system = System::new(&posture.jacobian);
        let task = system.solve(&wanted);
        if self.chain.count() < JOINTS {
            return task;
        }
        self.turn_free(&system);
        let target = self.elbow_speed(&q, task[2]);
        self.elbow_rate = 0.0;
        (self.speed, self.acceleration) =
            approach(target, (self.speed, self.acceleration), ELBOW_BOUNDS);
        task + self.free * self.speed
    }

    /// Follows the free direction through the motion.
    fn turn_free(&mut self, system: &System) {
        let joint = self.free.iamax();
        let free = system.free(joint);
        let length = free.norm();
        // Where no direction is free of the damped task any more, the last one stands.
        if length > 1e-6 {
            let sign = if free.dot(&self.free) < 0.0 {
                -1.0
            } else {
                1.0
            };
            self.free = free * (sign / length);
        }
    }

    /// The speed along the free direction that holds joint 3, which the task turns at `task` rad/s,
    /// at its reference and keeps all joints off the ends of their ranges.
    fn elbow_speed(&self, q: &Joints, task: f64) -> f64 {
        // Where the free direction hardly turns joint 3, the quotient fades instead of growing.
        let turns = self.free[2];
        let share = turns / (turns * turns + ELBOW_FADE);
        let hold = share * (ELBOW_RATE * (self.elbow - q[2]) + self.elbow_rate - task);
        (hold + self.free.dot(&repulsion(q, self.limits))).clamp(-ELBOW_SPEED, ELBOW_SPEED)
    }
}

/// Joint velocities away from the ends of the joints' ranges, rad/s; zero farther than [`MARGIN`]
/// from them.
fn repulsion(q: &Joints, limits: &Limits) -> Joints {
    Joints::from_fn(|k, _| {
        let bound = &limits.joints[k];
        let (below, above) = (q[k] - bound.lower, bound.upper - q[k]);
        let near = (1.0 - below.min(above) / MARGIN).clamp(0.0, 1.0);
        REPULSION * near * near * if below < above { 1.0 } else { -1.0 }
    })
}

/// The part of the pose's error that is mended, bounded in length.
fn feedback(error: &Twist) -> Twist {
    let wanted = error * FEEDBACK;
    let (linear, angular) = split(&wanted);
    let longest = linear.norm().max(angular.norm());
    wanted * (FEEDBACK_MOST / longest.max(FEEDBACK_MOST))
}

/// J J^T, damped where it is nearly singular.
struct System<'a> {
    jacobian: &'a Jacobian,
    factor: Option<Cholesky<f64, Const<6>>>,
}

impl<'a> System<'a> {
    fn new(jacobian: &'a Jacobian) -> Self {
        let square = jacobian * jacobian.transpose();
        let damping = if has_few_joints(jacobian) {
            let share = (1.0 - measure_of_few(jacobian) / SINGULAR_OF_FEW).max(0.0);
            (DAMPING * share * lever(jacobian)).max(LEAST_DAMPING)
        } else {
            let factor = Cholesky::new(square);
            let measure = factor.as_ref().map_or(0.0, diagonal);
            if measure >= SINGULAR {
                return Self { jacobian, factor };
            }
            DAMPING * (1.0 - measure / SINGULAR)
        };
        let damping = damping.powi(2);
        Self {
            jacobian,
            // Positive definite by the damping; `None` only for a Jacobian that is not finite.
            factor: Cholesky::new(square + Matrix6::identity() * damping),
        }
    }

    /// The joint velocities of least length for this twist.
    fn solve(&self, twist: &Twist) -> Joints {
        self.factor.as_ref().map_or_else(Joints::zeros, |f| {
            self.jacobian.transpose() * f.solve(twist)
        })
    }

    /// The part of a unit velocity of `joint` that leaves the end effector where it is.
    fn free(&self, joint: usize) -> Joints {
        let mut unit = Joints::zeros();
        unit[joint] = 1.0;
        unit - self.solve(&self.jacobian.column(joint).into())
    }
}

/// sqrt(det(J J^T)), m^3; of fewer than six joints sqrt(det(J^T J)), lengths as shares of the
/// longest lever.
pub(crate) fn manipulability(jacobian: &Jacobian) -> f64 {
    if has_few_joints(jacobian) {
        return measure_of_few(jacobian);
    }
    Cholesky::new(jacobian * jacobian.transpose()).map_or(0.0, |factor| diagonal(&factor))
}

/// The product of a factor's diagonal: the root of the determinant.
fn diagonal<const N: usize>(factor: &Cholesky<f64, Const<N>>) -> f64
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    factor.l_dirty().diagonal().product()
}

/// Manipulability of fewer than six joints.
fn measure_of_few(jacobian: &Jacobian) -> f64 {
    let mut shares = *jacobian;
    let mut linear = shares.fixed_rows_mut::<3>(0);
    linear /= lever(jacobian);
    let square = shares.transpose() * shares;
    let missing = square.diagonal().map(|x| f64::from(x == 0.0));
    Cholesky::new(square + SMatrix::from_diagonal(&missing)).map_or(0.0, |factor| diagonal(&factor))
}

/// The longest lever at which a joint moves the end effector, m; 1 of a joint that slides.
fn lever(jacobian: &Jacobian) -> f64 {
    let levers = jacobian
        .column_iter()
        .map(|column| column.fixed_rows::<3>(0).norm());
    levers.fold(0.0, f64::max)
}

/// Whether the arm has fewer than six joints: its J J^T is singular.
pub(crate) fn has_few_joints(jacobian: &Jacobian) -> bool {
    jacobian.column(5).amax() == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::READY;
    use crate::limits::Model;

    const LIMITS: &Limits = Model::Panda.limits();

    fn follow(q: [f64; 7], twist: Twist, ticks: usize) -> (Chain, Setpoint, Pose) {
        let chain = Chain::default();
        let mut desired = Setpoint::at_rest(Joints::from(q));
        let mut ik = VelocityIk::new(chain, LIMITS, &desired.q);
        let mut reference = chain.pose(&desired.q);
        for _ in 0..ticks {
            let half = crate::generator::moved(&reference, &twist, 0.5 * PERIOD);
            desired = desired.after(&ik.step(&desired, &twist, &half));
            reference = crate::generator::moved(&reference, &twist, PERIOD);
        }
        (chain, desired, reference)
    }

    #[test]
    fn the_end_effector_is_where_the_commands_lead() {
        let twist = Twist::new(0.05, -0.08, 0.03, 0.1, 0.2, -0.15);
        let (chain, desired, reference) = follow(READY, twist, 2000);
        let error = difference(&reference, &chain.pose(&desired.q));
        assert!(error.norm() < 1e-8, "{}", error.norm());
    }

    #[test]
    fn the_joints_allow_less_than_the_end_effector_may() {
        // At the ready position, along x: 2.38 m/s^2 of 13 and 1190 m/s^3 of 6500, joint 2 being
        // the first.
        let jacobian = Chain::default().posture(&Joints::from(READY)).jacobian;
        let joints = System::new(&jacobian).solve(&Twist::x());
        let least = |bound: fn(usize) -> f64| {
            let most = (0..JOINTS).map(|k| bound(k) / joints[k].abs());
            most.fold(f64::INFINITY, f64::min)
        };
        let acceleration = least(|k| LIMITS.joints[k].acceleration);
        assert!((acceleration - 2.38).abs() < 0.005, "{acceleration}");
        let jerk = least(|k| LIMITS.joints[k].jerk);
        assert!((jerk - 1190.0).abs() < 3.0, "{jerk}");
    }

    #[test]
    fn a_pose_that_is_off_is_drawn_to_the_integral_of_commands() {
        let chain = Chain::default();
        let mut desired = Setpoint::at_rest(Joints::from(READY));
        let mut ik = VelocityIk::new(chain, LIMITS, &desired.q);
        let off = Twist::new(1e-3, -1e-3, 0.0, 0.0, 2e-3, 0.0);
        let reference = crate::generator::moved(&chain.pose(&desired.q), &off, 1.0);
        for _ in 0..1500 {
            desired = desired.after(&ik.step(&desired, &Twist::zeros(), &reference));
        }
        assert!(difference(&reference, &chain.pose(&desired.q)).norm() < 1e-9);
    }

    #[test]
    fn the_elbow_stays_where_it_was() {
        let twist = Twist::new(0.0, 0.1, 0.0, 0.0, 0.0, 0.0);
        let (_, desired, _) = follow(READY, twist, 2000);
        assert!(desired.q[2].abs() < 0.05, "{}", desired.q[2]);
    }

    #[test]
    fn the_elbow_goes_where_it_is_told_while_the_end_effector_stands() {
        let chain = Chain::default();
        let mut desired = Setpoint::at_rest(Joints::from(READY));
        let mut ik = VelocityIk::new(chain, LIMITS, &desired.q);
        let reference = chain.pose(&desired.q);
        for tick in 1..=3000 {
            ik.turn_elbow(0.2 * (f64::from(tick) * PERIOD).min(2.0));
            desired = desired.after(&ik.step(&desired, &Twist::zeros(), &reference));
        }
        // It nears the end of its way slowly.
        assert!((desired.q[2] - 0.4).abs() < 0.05, "{}", desired.q[2]);
        assert!(difference(&reference, &chain.pose(&desired.q)).norm() < 1e-8);
    }

    #[test]
    fn a_joint_near_its_limit_is_pushed_back_in_the_null_space() {
        let mut q = READY;
        q[6] = LIMITS.joints[6].upper - 0.05;
        let (chain, desired, reference) = follow(q, Twist::zeros(), 3000);
        assert!(desired.q[6] < q[6] - 0.02, "{}", desired.q[6]);
        assert!(difference(&reference, &chain.pose(&desired.q)).norm() < 1e-8);
    }

    #[test]
    fn joint_velocities_stay_bounded_in_a_singularity() {
        // The outstretched arm cannot go further out.
        let q = [0.0, 0.0, 0.0, -0.07, 0.0, 1.6, 0.0];
        let chain = Chain::default();
        let mut ik = VelocityIk::new(chain, LIMITS, &Joints::from(q));
        let rest = Setpoint::at_rest(Joints::from(q));
        for axis in 0..6 {
            let mut twist = Twist::zeros();
            twist[axis] = 0.1;
            let dq = ik.step(&rest, &twist, &chain.pose(&rest.q));
            assert!(dq.amax() < 2.0, "axis {axis}: {dq}");
        }
    }
}
