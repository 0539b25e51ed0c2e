//! The robot's referee: sees every state from outside, and differentiates the desired positions by
//! itself.

use std::borrow::Cow;
use std::fmt;

use panda::limits::{JointBounds, Limits, PERIOD};
use panda::{Errors, JOINTS, Joints, Mode, State, Twist};
use serde::{Deserialize, Serialize};

/// Room for rounding: positions of size 1 differentiated three times at 1 kHz carry up to 1e-16 /
/// 1e-9.
const ROUNDING: f64 = 1.0 + 1e-3;

/// Judges the robot by its limits, state by state.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspector {
    limits: &'static Limits,
    report: ArmReport,
    seen: Errors,
    mode: Mode,
    /// Desired positions, velocities and accelerations a millisecond ago.
    q: Joints,
    dq: Joints,
    ddq: Joints,
    /// The command a millisecond ago, and its derivative.
    twist: Twist,
    acceleration: Twist,
    steps: u64,
}

/// Counts of milliseconds, and shares of the limits.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ArmReport {
    /// Times that the robot went into reflex.
    pub reflexes: u64,
    /// Milliseconds in which a joint was out of its range, or a joint or the end effector
    /// faster than allowed.
    pub limit_violations: u64,
    /// Milliseconds in which a joint or the end effector accelerated or jerked more than
    /// allowed.
    pub discontinuities: u64,
    /// Names of the robot's errors, each once.
    pub errors: Vec<Cow<'static, str>>,
    /// Largest share of a joint's speed, 1 at its limit.
    pub joint_velocity: f64,
    /// Largest share of a joint's acceleration.
    pub joint_acceleration: f64,
    /// Largest share of a joint's jerk.
    pub joint_jerk: f64,
    /// Least distance of a joint from an end of its range, rad.
    pub joint_room: f64,
    /// Milliseconds in which the robot obeyed the controller.
    pub steered_ms: u64,
    /// Those in which the bridge slowed the camera down, for a joint or a singular posture.
    pub slowed_ms: u64,
}

impl ArmReport {
    /// Whether nothing happened that must not.
    pub fn is_clean(&self) -> bool {
        self.reflexes == 0 && self.limit_violations == 0 && self.discontinuities == 0
    }
}

impl fmt::Display for ArmReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} reflexes, {} limit violations, {} discontinuities",
            self.reflexes, self.limit_violations, self.discontinuities
        )
    }
}

impl Inspector {
    /// An inspector that meets a robot with these limits at rest.
    pub fn new(state: &State, limits: &'static Limits) -> Self {
        Self {
            limits,
            report: ArmReport {
                joint_room: f64::INFINITY,
                ..ArmReport::default()
            },
            seen: Errors::NONE,
            mode: state.robot_mode,
            q: state.q_d,
            dq: Joints::zeros(),
            ddq: Joints::zeros(),
            twist: Twist::zeros(),
            acceleration: Twist::zeros(),
            steps: 0,
        }
    }

    /// The report so far.
    pub fn report(&self) -> &ArmReport {
        &self.report
    }

    /// Notes a millisecond of the controller's, and whether the bridge slowed the camera down.
    pub fn steered(&mut self, is_slowed: bool) {
        self.report.steered_ms += 1;
        self.report.slowed_ms += u64::from(is_slowed);
    }

    /// Looks at the state of the next millisecond.
    pub fn look(&mut self, state: &State) {
        self.steps += 1;
        if state.robot_mode == Mode::Reflex && self.mode != Mode::Reflex {
            self.report.reflexes += 1;
        }
        self.mode = state.robot_mode;
        self.note(state.current_errors.union(state.last_motion_errors));

        let dq = (state.q_d - self.q) / PERIOD;
        let ddq = (dq - self.dq) / PERIOD;
        let jerk = (ddq - self.ddq) / PERIOD;
        let acceleration = (state.o_dp_ee_c - self.twist) / PERIOD;
        let cartesian_jerk = (acceleration - self.acceleration) / PERIOD;
        let bounds = &self.limits.joints;
        let share = |x: &Joints, bound: fn(&JointBounds) -> f64| {
            let shares = x
                .iter()
                .zip(bounds)
                .map(|(x, joint)| x.abs() / bound(joint));
            shares.fold(0.0, f64::max)
        };
        let speed = share(&dq, |joint| joint.velocity);
        let push = share(&ddq, |joint| joint.acceleration);
        let snap = share(&jerk, |joint| joint.jerk);
        let report = &mut self.report;
        report.joint_velocity = report.joint_velocity.max(speed);
        report.joint_acceleration = report.joint_acceleration.max(push);
        report.joint_jerk = report.joint_jerk.max(snap);
        for q in [&state.q, &state.q_d] {
            let room = (0..JOINTS)
                .map(|k| (q[k] - bounds[k].lower).min(bounds[k].upper - q[k]))
                .fold(f64::INFINITY, f64::min);
            report.joint_room = report.joint_room.min(room);
        }
        let (t, r) = (&self.limits.translation, &self.limits.rotation);
        let measured = share(&state.dq, |joint| joint.velocity);
        let is_fast =
            speed.max(measured) > ROUNDING || over(&state.o_dp_ee_c, t.velocity, r.velocity);
        report.limit_violations += u64::from(is_fast || report.joint_room < 0.0);
        // The end of a motion takes the command to zero; that the joints brake evenly is judged by
        // the joints.
        let is_commanded = state.robot_mode == Mode::Move;
        let is_rough = push > ROUNDING
            || snap > ROUNDING
            || (is_commanded && over(&acceleration, t.acceleration, r.acceleration))
            || (is_commanded && over(&cartesian_jerk, t.jerk, r.jerk));
        report.discontinuities += u64::from(is_rough);

        (self.q, self.dq, self.ddq) = (state.q_d, dq, ddq);
        (self.twist, self.acceleration) = (state.o_dp_ee_c, acceleration);
    }

    fn note(&mut self, errors: Errors) {
        for flag in errors.flags().filter(|&flag| !self.seen.contains(flag)) {
            self.report.errors.push(flag.name().into());
        }
        self.seen = self.seen.union(errors);
    }
}

fn over(x: &Twist, linear: f64, angular: f64) -> bool {
    x.fixed_rows::<3>(0).norm() > linear * ROUNDING
        || x.fixed_rows::<3>(3).norm() > angular * ROUNDING
}

#[cfg(test)]
mod tests {
    use panda::{Command, Motion, MotionKind, READY, Robot, RobotSettings};

    use super::*;

    fn robot() -> Robot {
        let mut robot = Robot::new(RobotSettings::default(), Joints::from(READY)).unwrap();
        robot.start(MotionKind::Cartesian).unwrap();
        robot
    }

    fn step(robot: &mut Robot, twist: Twist) -> State {
        let id = robot.state().id;
        let motion = Motion::Cartesian(twist);
        *robot.step(&[Command {
            id,
            motion,
            elbow: None,
            finished: false,
        }])
    }

    #[test]
    fn a_jump_that_causes_a_reflex_is_named_once() {
        let mut robot = robot();
        let mut inspector = Inspector::new(robot.state(), robot.limits());
        for _ in 0..300 {
            inspector.look(&step(&mut robot, Twist::x() * 0.05));
        }
        let report = inspector.report();
        assert_eq!(report.reflexes, 1);
        assert!(!report.errors.is_empty() && !report.is_clean());
    }

    #[test]
    fn desired_joints_that_jump_are_a_discontinuity() {
        let robot = robot();
        let mut inspector = Inspector::new(robot.state(), robot.limits());
        let mut state = *robot.state();
        inspector.look(&state);
        assert!(inspector.report().is_clean());
        state.q_d[3] += 1e-4;
        inspector.look(&state);
        assert_eq!(inspector.report().discontinuities, 1);
        assert_eq!(inspector.report().reflexes, 0);
    }

    #[test]
    fn a_joint_beyond_its_range_or_speed_is_a_violation() {
        let robot = robot();
        for change in [(|s: &mut State| s.q[3] = 0.0) as fn(&mut State), |s| {
            s.dq[0] = 3.0
        }] {
            let mut inspector = Inspector::new(robot.state(), robot.limits());
            let mut state = *robot.state();
            change(&mut state);
            inspector.look(&state);
            assert_eq!(inspector.report().limit_violations, 1);
        }
    }
}
