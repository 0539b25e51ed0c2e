//! `--first-motion`: the first time that a camera and a robot meet. Each axis of the camera is moved
//! by a little and back, at a tenth of the speed, and the image is compared with what it should
//! show.

use std::io::{BufRead, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use franka::{FrankaError, RobotMode as Mode, RobotState as Told};
use ipc::{Domain, Features, MOST_OBEYED_NS, RobotPorts, Subscriber, TwistCommand, now_ns};
use panda::Pose;

use crate::config::{Config, Interface};
use crate::diagnosis::{Move, explain};
use crate::drive::DriveError;
use crate::look;
use crate::robot::{self, Motion};
use crate::steering::{Output, Steering};

/// Length of a move along an axis, m, and about one, rad.
const LENGTHS: [f64; 2] = [0.005, 0.02];
/// Share of the bridge's greatest speeds.
const SHARE: f64 = 0.1;
/// Rest before frames count, and then frames for a mean: longer than any camera's latency.
const REST_NS: u64 = 600_000_000;
const FRAMES: usize = 10;
/// Longest wait for that many frames, ns.
const PATIENCE_NS: u64 = 3_000_000_000;

/// More states than a socket keeps.
const BACKLOG: usize = 1000;

/// Why there are no findings.
#[derive(Debug, thiserror::Error)]
pub enum FirstMotionError {
    /// The robot or the shared memory cannot be used.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// Somebody said no.
    #[error("not confirmed; nothing moved")]
    NotConfirmed,
    /// The robot is not ready.
    #[error("the robot is in mode {0}; bring it to idle at the desk, or by: vpcctl recover")]
    Mode(String),
    /// The robot stands where no motion can begin.
    #[error("no motion: {0}")]
    Start(#[from] crate::steering::StartError),
    /// The camera shows no features, or loses one.
    #[error("vpc/features: {0}; is the camera at work, and the whole pattern in sight?")]
    Features(String),
    /// Something limits the moves.
    #[error("a move was not carried out in full: {0}; guide the robot to a better place")]
    Limited(&'static str),
    /// No pose of the pattern explains an image.
    #[error("no pose of the scene's pattern explains what the camera sees")]
    NoPose,
    /// A signal came.
    #[error("stopped; the arm stands")]
    Stopped,
}

impl From<ipc::ReceiveError> for FirstMotionError {
    fn from(error: ipc::ReceiveError) -> Self {
        Self::Drive(error.into())
    }
}

/// Guides through the first motion: whether all is well.
///
/// # Errors
/// [`FirstMotionError`]: why nothing, or not all of it, could be looked at.
pub fn first_motion(
    config: &Config,
    is_confirmed: bool,
    stop: &AtomicBool,
) -> Result<bool, FirstMotionError> {
    let failed = |source: FrankaError| DriveError::Robot {
        address: config.robot.clone(),
        source: Box::new(source),
    };
    let robot = robot::connect(config).map_err(failed)?;
    let _ = franka::realtime::set_current_thread_scheduler_priority(config.priority);
    let state = robot.read_once().map_err(failed)?;
    print!("{}", look::frames(config, config.model, &state));
    let bounds = &config.bounds;
    println!(
        "  limits     {} m/s, {} rad/s; workspace {:?} to {:?} m; joint margin {} rad",
        bounds.linear,
        bounds.angular,
        bounds.workspace.lower,
        bounds.workspace.upper,
        bounds.joint_margin
    );
    println!(
        "Compare these with the desk: hand and load must be what is mounted.\n\
         The camera will move by {} mm along each of its axes and {} rad about it, and back, at {} mm/s.\n\
         Keep a hand on the stop.",
        1e3 * LENGTHS[0],
        LENGTHS[1],
        1e3 * SHARE * bounds.linear
    );
    if !is_confirmed && !confirmed() {
        return Err(FirstMotionError::NotConfirmed);
    }
    // States have piled up during the question.
    let mut state = state;
    for _ in 0..BACKLOG {
        state = robot.read_once().map_err(failed)?;
    }
    if state.robot_mode != Mode::Idle {
        return Err(FirstMotionError::Mode(format!("{:?}", state.robot_mode)));
    }
    let domain = Domain::join(&config.domain).map_err(DriveError::from)?;
    // The robot's place: no other bridge is at work.
    let ports = RobotPorts::open(&domain).map_err(DriveError::from)?;
    let measured = robot::measured(&state);
    let mount = config.mount(&measured.flange_from_ee);
    let steering = Steering::new(mount, *bounds, config.interface, config.model, &measured)?;
    let motion = Motion::begin(&robot, config.interface).map_err(failed)?;
    let mut stage = Stage {
        config,
        stop,
        features: domain.subscriber(1).map_err(DriveError::from)?,
        ports,
        steering,
        motion,
    };
    let moves = stage.moves();
    let ended = stage.come_to_rest();
    let moves = moves?;
    ended?;
    let findings = explain(&config.scene, &mount, &moves).ok_or(FirstMotionError::NoPose)?;
    println!(
        "The image moved as predicted to {:.2} px; with the best explanation, to {:.2} px.",
        findings.before_px, findings.after_px
    );
    let mistakes = findings.mistakes();
    for mistake in &mistakes {
        println!("LIKELY MISTAKE  {mistake}");
    }
    match mistakes.is_empty() {
        true => println!("All is as it should be. Start vpc-panda and vpcd, then: vpcctl arm"),
        false => println!("Do not arm. Mend this, then try again."),
    }
    Ok(mistakes.is_empty())
}

/// Asks on the terminal.
fn confirmed() -> bool {
    print!("Go on? [yes/no] ");
    let _ = std::io::stdout().flush();
    let mut answer = String::new();
    let read = std::io::stdin().lock().read_line(&mut answer);
    read.is_ok() && answer.trim() == "yes"
}

struct Stage<'a> {
    config: &'a Config,
    stop: &'a AtomicBool,
    features: Subscriber<Features>,
    ports: RobotPorts,
    steering: Steering,
    motion: Motion<'a>,
}

impl Stage<'_> {
    fn moves(&mut self) -> Result<Vec<Move>, FirstMotionError> {
        let names = ["vx", "vy", "vz", "wx", "wy", "wz"];
        let mut moves = Vec::new();
        for (axis, name) in names.into_iter().enumerate() {
            let bounds = &self.config.bounds;
            let speed = SHARE
                * if axis < 3 {
                    bounds.linear
                } else {
                    bounds.angular
                };
            let seconds = LENGTHS[usize::from(axis >= 3)] / speed;
            let mut twist = [0.0; 6];
            twist[axis] = speed;
            let before = self.look()?;
            self.go(twist, seconds)?;
            let after = self.look()?;
            self.go(twist.map(|v| -v), seconds)?;
            let pairs = before.1.iter().flatten().zip(after.1.iter().flatten());
            let most = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            println!("  {name}: the image moved by {most:.1} px");
            moves.push(Move {
                flange: [before.0, after.0],
                image: [before.1, after.1],
            });
        }
        Ok(moves)
    }

    /// One of the robot's milliseconds, with this twist of the camera.
    fn step(&mut self, twist: [f64; 6]) -> Result<Told, FirstMotionError> {
        let address = &self.config.robot;
        let failed = |source: FrankaError| DriveError::Robot {
            address: address.clone(),
            source: Box::new(source),
        };
        if self.stop.load(Ordering::Relaxed) {
            return Err(FirstMotionError::Stopped);
        }
        let state = self.motion.state().map_err(failed)?;
        let now = now_ns();
        let mut command = TwistCommand {
            twist,
            valid_until_ns: now + MOST_OBEYED_NS,
            ..TwistCommand::default()
        };
        command.stamp.published_ns = now;
        let measured = robot::measured(&state);
        let output = self.steering.step(&command, &measured, now);
        self.motion.answer(&output, false).map_err(failed)?;
        let limited = self.steering.limited();
        let mount = self.config.mount(&measured.flange_from_ee);
        let told = robot::told(&state, &mount, Some(limited), now);
        self.ports.robot.publish(&told).map_err(DriveError::from)?;
        if limited.by_workspace {
            return Err(FirstMotionError::Limited("a wall of the workspace is near"));
        }
        if limited.by_joint {
            return Err(FirstMotionError::Limited("a joint is near its margin"));
        }
        Ok(state)
    }

    fn go(&mut self, twist: [f64; 6], seconds: f64) -> Result<(), FirstMotionError> {
        let end = now_ns() + Duration::from_secs_f64(seconds).as_nanos() as u64;
        while now_ns() < end {
            self.step(twist)?;
        }
        Ok(())
    }

    /// Rests; where the flange then is, and what the camera sees, px.
    fn look(&mut self) -> Result<(Pose, Vec<[f64; 2]>), FirstMotionError> {
        let begin = now_ns();
        let count = self.config.scene.pattern.len();
        let mut sums = vec![[0.0; 2]; count];
        let mut frames = 0;
        loop {
            let state = self.step([0.0; 6])?;
            let now = now_ns();
            if let Some(newest) = self.features.latest()? {
                if usize::try_from(newest.count) != Ok(count) || !newest.all_visible() {
                    let found = format!(
                        "{} of {count} points, visible {:#b}",
                        newest.count, newest.visible
                    );
                    return Err(FirstMotionError::Features(found));
                }
                if newest.stamp.data_ns > begin + REST_NS / 2 && now > begin + REST_NS {
                    frames += 1;
                    for (sum, point) in sums.iter_mut().zip(newest.points.chunks_exact(2)) {
                        sum[0] += point[0] / FRAMES as f64;
                        sum[1] += point[1] / FRAMES as f64;
                    }
                }
            }
            if frames == FRAMES {
                let flange = robot::pose(&state.O_T_EE) * robot::pose(&state.F_T_EE).inverse();
                return Ok((flange, sums));
            }
            if now > begin + REST_NS + PATIENCE_NS {
                let found = format!("{frames} of {FRAMES} frames came in time");
                return Err(FirstMotionError::Features(found));
            }
        }
    }

    /// Ends the motion, however it went.
    fn come_to_rest(mut self) -> Result<(), FirstMotionError> {
        let address = &self.config.robot;
        let failed = |source: FrankaError| DriveError::Robot {
            address: address.clone(),
            source: Box::new(source),
        };
        loop {
            let state = self.motion.state().map_err(failed)?;
            let measured = robot::measured(&state);
            let output = self.steering.brake(&measured, now_ns());
            if self.steering.is_at_rest(&measured) {
                let still = match self.config.interface {
                    Interface::Joint => Output::Joint(panda::Joints::zeros()),
                    Interface::Cartesian => Output::Cartesian(panda::Twist::zeros()),
                };
                self.motion.answer(&still, true).map_err(failed)?;
                return Ok(());
            }
            self.motion.answer(&output, false).map_err(failed)?;
        }
    }
}
