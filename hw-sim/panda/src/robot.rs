//! The robot: stepped once a millisecond with the commands that arrived.

use crate::brake::brake;
use crate::errors::{Errors, Flag};
use crate::generator::Generator;
use crate::interface::{Command, Interface, Motion, MotionKind, Reception};
use crate::kinematics::{Chain, JOINTS, Joints, Pose, Twist, split};
use crate::limits::{Limits, Model, Setpoint};
use crate::mode::{Mode, RequestError};
use crate::servo::Servo;
use crate::settings::{RobotError, RobotSettings, check};
use crate::state::State;

/// A Panda, or another [`Model`].
#[derive(Clone, Debug)]
pub struct Robot {
    settings: RobotSettings,
    chain: Chain,
    mode: Mode,
    motion: Option<(Generator, Interface)>,
    desired: Setpoint,
    servo: Servo,
    push: Joints,
    errors: Errors,
    last_motion_errors: Errors,
    time: u64,
    /// Milliseconds of recovery that are left.
    recovery: u64,
    state: State,
}

impl Robot {
    /// A robot that stands idle at `q` (rad).
    ///
    /// # Errors
    /// A joint outside its range.
    pub fn new(settings: RobotSettings, q: Joints) -> Result<Self, RobotError> {
        check(&q, settings.model.limits())?;
        let chain = settings.model.chain(settings.flange_from_ee());
        let mut robot = Self {
            settings,
            chain,
            mode: Mode::Idle,
            motion: None,
            desired: Setpoint::at_rest(q),
            servo: Servo::new(q),
            push: Joints::zeros(),
            errors: Errors::NONE,
            last_motion_errors: Errors::NONE,
            time: 0,
            recovery: 0,
            state: State::default(),
        };
        robot.report();
        Ok(robot)
    }

    /// Which robot it is.
    pub fn model(&self) -> Model {
        self.settings.model
    }

    /// Its limits.
    pub fn limits(&self) -> &'static Limits {
        self.settings.model.limits()
    }

    /// The state after the last step.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Sets NE_T_EE, the end effector in the nominal one.
    ///
    /// # Errors
    /// The robot is in motion.
    pub fn set_end_effector(&mut self, ne_from_ee: Pose) -> Result<(), RequestError> {
        if !self.desired.is_at_rest() || self.motion.is_some() {
            return Err(RequestError::Moving { mode: self.mode });
        }
        self.settings.ne_from_ee = ne_from_ee;
        self.chain = self.model().chain(self.settings.flange_from_ee());
        self.report();
        Ok(())
    }

    /// Begins a motion; the next step expects a command that answers the present state.
    ///
    /// # Errors
    /// The robot is not idle.
    pub fn start(&mut self, kind: MotionKind) -> Result<(), RequestError> {
        self.need(Mode::Idle)?;
        let generator = Generator::new(kind, self.chain, self.limits(), &self.desired.q);
        self.motion = Some((generator, Interface::new(kind)));
        self.mode = Mode::Move;
        self.report();
        Ok(())
    }

    /// Ends the motion from outside, as a stop command does: the robot brakes and becomes idle.
    ///
    /// # Errors
    /// No motion runs.
    pub fn stop(&mut self) -> Result<(), RequestError> {
        if self.mode != Mode::Move {
            return Err(RequestError::Mode {
                mode: self.mode,
                needed: Mode::Move,
            });
        }
        self.end_motion(Errors::NONE);
        self.report();
        Ok(())
    }

    /// Presses the user's stop: the robot brakes in any mode and refuses motions until it is
    /// released.
    pub fn press_user_stop(&mut self) {
        if self.motion.is_some() {
            self.end_motion(Errors::NONE);
        }
        self.mode = Mode::UserStopped;
        self.report();
    }

    /// Releases the user's stop: idle, or reflex where errors stand.
    ///
    /// # Errors
    /// It was not pressed; the robot still brakes.
    pub fn release_user_stop(&mut self) -> Result<(), RequestError> {
        self.need(Mode::UserStopped)?;
        self.mode = if self.errors.is_empty() {
            Mode::Idle
        } else {
            Mode::Reflex
        };
        self.report();
        Ok(())
    }

    /// Begins automatic error recovery; idle follows, or reflex again where the cause stands.
    ///
    /// # Errors
    /// The robot is not in reflex, or still brakes.
    pub fn recover(&mut self) -> Result<(), RequestError> {
        self.need(Mode::Reflex)?;
        self.mode = Mode::AutomaticErrorRecovery;
        self.recovery = self.settings.recovery_ms;
        self.report();
        Ok(())
    }

    /// From now on the surroundings push the joints with these accelerations, rad/s^2.
    pub fn push(&mut self, acceleration: Joints) {
        self.push = acceleration;
    }

    /// One millisecond, with the commands that `arrived` since the last state; returns the new
    /// state.
    pub fn step(&mut self, arrived: &[Command]) -> &State {
        self.time += 1;
        match self.motion {
            Some(_) => self.follow(arrived),
            None => self.rest(),
        }
        self.servo.step(&self.desired, &self.push);
        self.report();
        self.watch();
        &self.state
    }

    /// Whether a motion follows commands.
    pub fn follows(&self) -> bool {
        self.motion.is_some()
    }

    /// One more state, of a motion that stands still until its next command comes; returns it.
    pub fn wait(&mut self) -> &State {
        self.time += 1;
        self.report();
        &self.state
    }

    /// Follows the command of this millisecond, or its substitute if it is missing.
    fn follow(&mut self, arrived: &[Command]) {
        let Some((generator, link)) = &mut self.motion else {
            return;
        };
        let (motion, elbow, finished) = match link.receive(self.state.id, arrived) {
            Reception::Accepted(command) => (command.motion, command.elbow, command.finished),
            Reception::Lost => (generator.extrapolation(), None, false),
            Reception::Aborted => {
                self.reflex(Flag::CommunicationConstraintsViolation.into());
                self.brake();
                return;
            }
        };
        let (desired, errors) = generator.advance(&motion, elbow, &self.desired);
        if !errors.is_empty() {
            self.reflex(errors);
            self.brake();
            return;
        }
        self.desired = desired;
        if finished {
            // The next command would be zero: no error where that is no jump.
            let (_, errors) = generator.advance(&Motion::zero(motion.kind()), None, &self.desired);
            match errors.is_empty() {
                true => self.end_motion(Errors::NONE),
                false => self.reflex(errors),
            }
        }
    }

    /// Brakes, and goes on to the next mode once at rest.
    fn rest(&mut self) {
        self.brake();
        match self.mode {
            Mode::Move if self.desired.is_at_rest() => self.mode = Mode::Idle,
            Mode::AutomaticErrorRecovery if self.recovery > 0 => self.recovery -= 1,
            Mode::AutomaticErrorRecovery => {
                // Where the cause stands, `watch` raises it again in this very step.
                self.errors = Errors::NONE;
                self.mode = Mode::Idle;
            }
            _ => {}
        }
    }

    fn brake(&mut self) {
        self.desired = brake(&self.desired, self.limits());
    }

    /// Watches what is measured.
    fn watch(&mut self) {
        let errors = self.measured_errors();
        if !errors.is_empty() && self.mode != Mode::AutomaticErrorRecovery {
            self.reflex(errors);
            self.report();
        }
    }

    fn measured_errors(&self) -> Errors {
        let (q, dq) = (&self.servo.q, &self.servo.dq);
        let measured = self.chain.posture(q);
        let (linear, _) = split(&(measured.jacobian * dq));
        let limits = self.limits();
        let is_fast = |k: usize| limits.joints[k].is_too_fast(q[k], dq[k]);
        let walls = self.settings.walls;
        let beyond = walls.is_some_and(|w| !w.contain(&measured.pose.translation.vector));
        let fast_ee = linear.norm() > limits.translation.velocity;
        Errors::raised([
            (
                Flag::JointPositionLimitsViolation,
                limits.outside(q).is_some(),
            ),
            (Flag::CartesianPositionLimitsViolation, beyond),
            (Flag::JointVelocityViolation, (0..JOINTS).any(is_fast)),
            (Flag::CartesianVelocityViolation, fast_ee),
        ])
    }

    /// Latches errors and stops; a user's stop stays one.
    fn reflex(&mut self, errors: Errors) {
        self.errors = self.errors.union(errors);
        if self.motion.is_some() {
            self.end_motion(errors);
        }
        if self.mode != Mode::UserStopped {
            self.mode = Mode::Reflex;
        }
    }

    fn end_motion(&mut self, errors: Errors) {
        self.motion = None;
        self.last_motion_errors = errors;
    }

    fn need(&self, needed: Mode) -> Result<(), RequestError> {
        let mode = self.mode;
        if mode != needed {
            Err(RequestError::Mode { mode, needed })
        } else if !self.desired.is_at_rest() {
            Err(RequestError::Moving { mode })
        } else {
            Ok(())
        }
    }

    /// Updates the state.
    fn report(&mut self) {
        let desired = self.chain.posture(&self.desired.q);
        let (pose, twist, acceleration) = match &self.motion {
            Some((Generator::Cartesian(g), _)) => (g.pose(), *g.twist(), *g.acceleration()),
            _ => (desired.pose, Twist::zeros(), Twist::zeros()),
        };
        let state = &mut self.state;
        state.f_t_ee = self.settings.flange_from_ee();
        (state.f_t_ne, state.ne_t_ee) = (self.settings.flange_from_ne, self.settings.ne_from_ee);
        state.id = self.time;
        state.time = self.time;
        (state.q, state.dq) = (self.servo.q, self.servo.dq);
        (state.q_d, state.dq_d) = (self.desired.q, self.desired.dq);
        state.ddq_d = self.desired.ddq;
        state.o_t_ee = self.chain.pose(&self.servo.q);
        (state.o_t_ee_d, state.o_t_ee_c) = (desired.pose, pose);
        state.o_dp_ee_d = desired.jacobian * self.desired.dq;
        (state.o_dp_ee_c, state.o_ddp_ee_c) = (twist, acceleration);
        state.robot_mode = self.mode;
        state.current_errors = self.errors;
        state.last_motion_errors = self.last_motion_errors;
        state.control_command_success_rate = self
            .motion
            .as_ref()
            .map_or(0.0, |(_, link)| link.success_rate());
    }
}
