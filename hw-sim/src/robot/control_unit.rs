//! The robot's control unit: the vendor's interface on one side, the robot on the other.

use std::io;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use fci::message::{IDENTITY, Kind, Mode as WireMode, Transform};
use fci::{Answer, Controller, Event, Generator, Load, Request, Server, Ticket, Version, errors};
use nalgebra::{Matrix3, Matrix4, Rotation3, Translation3, Vector3};
use panda::{
    Command, Errors, Joints, Mode, Motion, MotionKind, Pose, RequestError, Robot, State, Twist,
};

use super::description::urdf;

/// By how much the length of a rotation's rows and columns may miss 1, as the vendor's library has
/// it: 0.7071 passes.
const UNIT: f64 = 1e-5;
/// Largest cosine between two of its columns. The library does not look at that.
const ASKEW: f64 = 1e-4;
/// Angle of joint 4 at which the elbow changes its sign, rad: where the arm is stretched out.
const STRETCHED: f64 = -0.467;

/// Between two states of a robot in lockstep, as long as no motion follows commands.
const MILLISECOND: Duration = Duration::from_millis(1);
/// In lockstep a motion begins with a state, and another that the client answers: by then it has
/// read the first one. One that has not gets a third, before its library gives up after a second.
const SECOND_STATE: Duration = Duration::from_millis(30);
const THIRD_STATE: Duration = Duration::from_millis(300);
/// Longest wait at a time, so that a signal is seen.
const LOOK: Duration = Duration::from_millis(10);

/// Where the interface is, and in which version.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FciSettings {
    /// Where it listens.
    pub address: SocketAddr,
    /// Which version it speaks.
    pub version: Version,
    /// Decimals of F_T_NE at the desk; 0: all.
    pub desk_decimals: u32,
    /// Whether a client paces the robot's motions, a millisecond for each command; otherwise the
    /// machine's clock does.
    pub is_lockstep: bool,
}

/// The control unit.
#[derive(Debug)]
pub struct ControlUnit {
    server: Server,
    /// The motion that a client began.
    motion: Option<Started>,
    /// The clients that wait for a stop, and for a recovery.
    stop: Option<Ticket>,
    recovery: Option<Ticket>,
    /// The client that asked for a recovery, which begins once the robot stands.
    braking: Option<Ticket>,
    /// What clients have set that moves nothing here.
    stiffness: Transform,
    load: Load,
    desk_decimals: u32,
    is_lockstep: bool,
    /// In lockstep, when the next state is due whatever the client does; `None`: it waits for it.
    due: Option<Instant>,
}

/// A motion that was begun.
#[derive(Clone, Copy, Debug)]
struct Started {
    ticket: Ticket,
    generator: Generator,
    controller: Controller,
    is_stopped: bool,
    /// States without a command since it began.
    unanswered: u32,
    /// Whether a command has come.
    is_commanded: bool,
}

impl ControlUnit {
    /// A control unit that waits for a client.
    ///
    /// # Errors
    /// The address cannot be had.
    pub fn open(settings: &FciSettings) -> io::Result<Self> {
        Ok(Self {
            server: Server::bind(settings.address, settings.version)?,
            motion: None,
            stop: None,
            recovery: None,
            braking: None,
            stiffness: IDENTITY,
            load: Load::default(),
            desk_decimals: settings.desk_decimals,
            is_lockstep: settings.is_lockstep,
            due: Some(Instant::now()),
        })
    }

    /// In lockstep: waits for a moment, and returns whether the next step may be taken.
    pub fn may_step(&self, robot: &Robot) -> bool {
        let left = |due: Instant| due.saturating_duration_since(Instant::now());
        let moment = self.due.map_or(LOOK, left).min(LOOK);
        match self.is_awaited(robot) {
            true if self.server.wait(moment) => return true,
            true => (),
            false => std::thread::sleep(moment),
        }
        self.due.is_some_and(|due| due <= Instant::now())
    }

    /// Whether the robot's time stands still until a client commands.
    fn is_awaited(&self, robot: &Robot) -> bool {
        self.is_lockstep && robot.follows() && self.server.has_client()
    }

    /// When the next state is due in lockstep.
    fn next_due(&self, robot: &Robot) -> Option<Instant> {
        let motion = self.motion.filter(|_| self.is_awaited(robot));
        let after = match motion {
            None => MILLISECOND,
            Some(motion) if motion.is_commanded => return None,
            Some(motion) if motion.unanswered == 0 => SECOND_STATE,
            Some(_) => THIRD_STATE,
        };
        Some(Instant::now() + after)
    }

    /// One millisecond of the robot: the client's commands, its requests, the new state, and the
    /// answers that are due.
    pub fn step(&mut self, robot: &mut Robot) {
        let commands: Vec<Command> = self.commands();
        match self.is_awaited(robot) && commands.is_empty() {
            // Nothing is lost in lockstep.
            true => robot.wait(),
            false => robot.step(&commands),
        };
        if let Some(motion) = &mut self.motion {
            motion.unanswered += u32::from(commands.is_empty());
            motion.is_commanded |= !commands.is_empty();
        }
        if let Some(ticket) = self.braking.take() {
            self.recover(&ticket, robot);
        }
        for event in self.server.poll() {
            match event {
                Event::Request(ticket, request) => self.take(&ticket, &request, robot),
                Event::Connected(client) => eprintln!("hw-sim: FCI: {client} is connected"),
                Event::Incompatible { client, version } => eprintln!(
                    "hw-sim: FCI: {client} speaks version {version}; allowed: {}",
                    self.server.version()
                ),
                Event::Gone(why) => eprintln!("hw-sim: FCI: the client is gone: {why}"),
            }
        }
        // A state with the error goes out before the answer that the motion was aborted.
        self.server.tell(&self.told(robot.state()));
        self.answer(robot.state());
        self.due = self.next_due(robot);
    }

    fn commands(&mut self) -> Vec<Command> {
        let generator = self.motion.map(|motion| motion.generator);
        let commands = self.server.commands().into_iter();
        commands
            .map(|command| Command {
                id: command.message_id,
                motion: match generator {
                    Some(Generator::JointVelocity) => Motion::Joint(Joints::from(command.dq_c)),
                    _ => Motion::Cartesian(Twist::from(command.o_dp_ee_c)),
                },
                elbow: command.elbow_c,
                finished: command.is_last,
            })
            .collect()
    }

    fn take(&mut self, ticket: &Ticket, request: &Request, robot: &mut Robot) {
        let is_moving = robot.state().robot_mode == Mode::Move;
        let answer = match request {
            Request::Move {
                controller,
                generator,
            } => self.begin(ticket, *controller, *generator, robot),
            Request::StopMove => match robot.stop() {
                Ok(()) => {
                    self.stop = Some(*ticket);
                    if let Some(motion) = &mut self.motion {
                        motion.is_stopped = true;
                    }
                    return;
                }
                // It stands, or is about to.
                Err(_) => Answer::Success,
            },
            Request::AutomaticErrorRecovery => return self.recover(ticket, robot),
            Request::SetNeToEe(transform) => match pose(transform) {
                None => Answer::InvalidArgumentRejected,
                Some(pose) => match robot.set_end_effector(pose) {
                    Ok(()) => Answer::Success,
                    Err(_) => Answer::NotPossibleRejected,
                },
            },
            Request::SetEeToK(transform) => match pose(transform) {
                None => Answer::InvalidArgumentRejected,
                Some(_) if is_moving => Answer::NotPossibleRejected,
                Some(_) => {
                    self.stiffness = *transform;
                    Answer::Success
                }
            },
            Request::SetLoad(load) => {
                let rest = load.center.iter().chain(&load.inertia);
                match load.mass >= 0.0 && rest.chain([&load.mass]).all(|x| x.is_finite()) {
                    false => Answer::InvalidArgumentRejected,
                    true if is_moving => Answer::NotPossibleRejected,
                    true => {
                        self.load = *load;
                        Answer::Success
                    }
                }
            }
            Request::Setting(_) if is_moving => Answer::NotPossibleRejected,
            Request::Setting(_) => Answer::Success,
            Request::Query(Kind::GetRobotModel) => {
                let description = urdf(robot.model());
                self.server
                    .reply_with(ticket, Answer::Success, description.as_bytes());
                return;
            }
            Request::Query(kind) => {
                eprintln!("hw-sim: FCI: {kind:?} is not emulated");
                Answer::Error
            }
            Request::Invalid(_) => Answer::InvalidArgumentRejected,
        };
        self.server.reply(ticket, answer);
    }

    /// Begins a recovery, now or once the robot stands: clients ask for it as soon as they hear of
    /// the reflex, as the vendor's examples do.
    fn recover(&mut self, ticket: &Ticket, robot: &mut Robot) {
        let answer = match robot.recover() {
            Ok(()) => {
                self.recovery = Some(*ticket);
                return;
            }
            Err(RequestError::Moving { .. }) => {
                self.braking = Some(*ticket);
                return;
            }
            Err(_) if robot.state().robot_mode == Mode::Idle => Answer::Success,
            Err(_) => Answer::NotPossibleRejected,
        };
        self.server.reply(ticket, answer);
    }

    fn begin(
        &mut self,
        ticket: &Ticket,
        controller: Controller,
        generator: Generator,
        robot: &mut Robot,
    ) -> Answer {
        let kind = match (controller, generator) {
            (Controller::External, _) => None,
            (_, Generator::CartesianVelocity) => Some(MotionKind::Cartesian),
            (_, Generator::JointVelocity) => Some(MotionKind::Joint),
            _ => None,
        };
        let Some(kind) = kind else {
            eprintln!(
                "hw-sim: FCI: a motion of {generator:?} under {controller:?} is not emulated; allowed: joint or Cartesian velocities under an impedance controller"
            );
            return Answer::NotPossibleRejected;
        };
        match robot.start(kind) {
            Ok(()) => {
                self.motion = Some(Started {
                    ticket: *ticket,
                    generator,
                    controller,
                    is_stopped: false,
                    unanswered: 0,
                    is_commanded: false,
                });
                Answer::MotionStarted
            }
            Err(_) => Answer::NotPossibleRejected,
        }
    }

    /// Answers what has ended by now.
    fn answer(&mut self, state: &State) {
        let aborted = match state.robot_mode {
            Mode::Reflex => Some(Answer::ReflexAborted),
            Mode::UserStopped => Some(Answer::EmergencyAborted),
            _ => None,
        };
        if state.robot_mode != Mode::Move
            && let Some(motion) = self.motion.take()
        {
            let ended = match motion.is_stopped {
                true => Answer::Preempted,
                false => Answer::Success,
            };
            self.server.reply(&motion.ticket, aborted.unwrap_or(ended));
        }
        for (waiting, until) in [
            (&mut self.stop, Mode::Move),
            (&mut self.recovery, Mode::AutomaticErrorRecovery),
        ] {
            if state.robot_mode != until
                && let Some(ticket) = waiting.take()
            {
                self.server
                    .reply(&ticket, aborted.unwrap_or(Answer::Success));
            }
        }
    }

    /// The state as a client is told of it.
    fn told(&self, state: &State) -> fci::State {
        let motion = self.motion.filter(|_| state.robot_mode == Mode::Move);
        let elbow = |q: &Joints| [q[2], if q[3] > STRETCHED { 1.0 } else { -1.0 }];
        // The robot multiplies what the desk has, rounded or not.
        let f_t_ne = rounded(state.f_t_ne.to_homogeneous(), self.desk_decimals);
        let f_t_ee = f_t_ne * state.ne_t_ee.to_homogeneous();
        let told = |pose: &Pose| match self.desk_decimals {
            0 => columns(pose),
            _ => flat(&((pose * state.f_t_ee.inverse()).to_homogeneous() * f_t_ee)),
        };
        fci::State {
            message_id: state.id,
            o_t_ee: told(&state.o_t_ee),
            o_t_ee_d: told(&state.o_t_ee_d),
            o_t_ee_c: told(&state.o_t_ee_c),
            f_t_ee: told(&state.f_t_ee),
            ee_t_k: self.stiffness,
            f_t_ne: flat(&f_t_ne),
            ne_t_ee: columns(&state.ne_t_ee),
            load: self.load,
            elbow: elbow(&state.q),
            elbow_d: elbow(&state.q_d),
            q: state.q.into(),
            q_d: state.q_d.into(),
            dq: state.dq.into(),
            dq_d: state.dq_d.into(),
            ddq_d: state.ddq_d.into(),
            o_dp_ee_d: state.o_dp_ee_d.into(),
            o_dp_ee_c: state.o_dp_ee_c.into(),
            o_ddp_ee_c: state.o_ddp_ee_c.into(),
            generator: motion.map_or(Generator::Idle, |motion| motion.generator),
            controller: motion.map_or(Controller::Other, |motion| motion.controller),
            errors: flags(state.current_errors),
            reflex_reason: flags(state.last_motion_errors),
            mode: match state.robot_mode {
                Mode::Idle => WireMode::Idle,
                Mode::Move => WireMode::Move,
                Mode::Reflex => WireMode::Reflex,
                Mode::UserStopped => WireMode::UserStopped,
                Mode::AutomaticErrorRecovery => WireMode::AutomaticErrorRecovery,
            },
            control_command_success_rate: state.control_command_success_rate,
        }
    }
}

fn flags(errors: Errors) -> [bool; errors::COUNT] {
    errors::flags(errors.flags().map(|flag| flag.name()))
}

/// A pose, column by column.
fn columns(pose: &Pose) -> Transform {
    flat(&pose.to_homogeneous())
}

/// To so many decimals; 0: as it is.
fn rounded(matrix: Matrix4<f64>, decimals: u32) -> Matrix4<f64> {
    let scale = 10f64.powi(decimals.cast_signed());
    match decimals {
        0 => matrix,
        _ => matrix.map(|x| (scale * x).round() / scale),
    }
}

fn flat(matrix: &Matrix4<f64>) -> Transform {
    let mut columns = [0.0; 16];
    columns.copy_from_slice(matrix.as_slice());
    columns
}

/// The pose of a transformation; `None` if it is none.
fn pose(transform: &Transform) -> Option<Pose> {
    let at = |row: usize, column: usize| transform[4 * column + row];
    let rotation = Matrix3::from_fn(at);
    let translation = Vector3::from_fn(|row, _| at(row, 3));
    let last = [at(3, 0), at(3, 1), at(3, 2), at(3, 3)];
    let is_unit = |length: f64| (length - 1.0).abs() <= UNIT;
    let columns = rotation.column_iter().map(|column| column.norm());
    let rows = rotation.row_iter().map(|row| row.norm());
    let cosines = (rotation.transpose() * rotation).map_with_location(|i, k, x| match i == k {
        true => 0.0,
        false => x,
    });
    let is_pose = last == [0.0, 0.0, 0.0, 1.0]
        && columns.chain(rows).all(is_unit)
        && cosines.amax() <= ASKEW
        && rotation.determinant() > 0.0
        && translation.iter().all(|x| x.is_finite());
    if !is_pose {
        return None;
    }
    // The nearest rotation.
    let svd = rotation.svd(true, true);
    let exact = Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?);
    Some(Pose::from_parts(Translation3::from(translation), exact))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_goes_over_the_wire_and_back_and_nonsense_is_none() {
        let hand = panda::RobotSettings::with_hand().flange_from_ne;
        let sent = columns(&hand);
        // As libfranka shows F_T_NE of the hand.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((sent[0] - half).abs() < 1e-9 && (sent[1] + half).abs() < 1e-9);
        assert_eq!(sent[14], 0.1034);
        let apart = pose(&sent).unwrap().to_homogeneous() - hand.to_homogeneous();
        assert!(apart.amax() < 1e-14);
        for (place, value) in [(0, 0.9), (15, 2.0), (12, f64::NAN), (0, f64::NAN)] {
            let mut wrong = sent;
            wrong[place] = value;
            assert_eq!(pose(&wrong), None);
        }
    }

    #[test]
    fn a_rounded_desk_makes_rotations_that_are_none_and_leaves_the_flange_where_it_is() {
        let settings = |desk_decimals| FciSettings {
            address: "127.0.0.1:0".parse().unwrap(),
            version: Version::V5,
            desk_decimals,
            is_lockstep: false,
        };
        let robot = panda::RobotSettings::with_hand();
        let robot = Robot::new(robot, panda::READY.into()).unwrap();
        let state = robot.state();
        let flange = (state.o_t_ee * state.f_t_ee.inverse()).to_homogeneous();
        for (decimals, short) in [(0, 0.0), (4, 9.59e-6)] {
            let told = ControlUnit::open(&settings(decimals)).unwrap().told(state);
            let [ee, hand] = [told.o_t_ee, told.f_t_ee].map(|x| Matrix4::from_column_slice(&x));
            // Half of its entries are 0.7071, so that two columns are short.
            for (column, short) in [(0, short), (1, short), (2, 0.0)] {
                for matrix in [&ee, &hand] {
                    let length = matrix.column(column).norm();
                    assert!((1.0 - length - short).abs() < 1e-8, "{decimals}: {length}");
                }
            }
            let back = ee * hand.try_inverse().unwrap();
            assert!((back - flange).amax() < 1e-12);
        }
    }

    #[test]
    fn a_rotation_that_was_rounded_is_taken_as_the_vendors_library_takes_it() {
        let about_z = |cosine: f64, sine: f64| {
            let mut sent = IDENTITY;
            (sent[0], sent[1]) = (cosine, sine);
            (sent[4], sent[5]) = (-sine, cosine);
            sent
        };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let rounded = (1e4 * half).round() / 1e4;
        let taken = pose(&about_z(rounded, rounded)).unwrap();
        assert!((taken.rotation[(0, 0)] - half).abs() < 1e-12);
        assert_eq!(pose(&about_z(rounded - 1e-5, rounded - 1e-5)), None);
        // Rows and columns of length 1, but no rotation.
        let mut askew = about_z(half, half);
        askew[4] = half;
        assert_eq!(pose(&askew), None);
    }
}
