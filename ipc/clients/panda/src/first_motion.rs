//! `--first-motion`: the first time that a camera and a robot meet. Each axis of the camera is
//! moved by a little and back, at a tenth of the speed, and the image is compared with what it
//! should show. All waits are by the robot's own clock.

use std::io::{BufRead, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use arm::Pose;
use franka::{RobotMode as Mode, RobotState as Told};
use ipc::{Domain, RobotPorts, Subscriber, now_ns};
use messages::{Features, MOST_OBEYED_NS, TwistCommand};

use crate::config::Config;
use crate::diagnosis::{Move, advise};
use crate::drive::{DriveError, Event, enter_real_time};
use crate::look;
use crate::robot::{self, Doing, Motion};
use crate::steering::{Output, Steering};

/// Length of a move along an axis, m, and about one, rad.
const LENGTHS: [f64; 2] = [0.005, 0.02];
/// Share of the bridge's greatest speeds.
const SHARE: f64 = 0.1;
/// Rest before frames count, and then frames for a mean: longer than any camera's latency.
const REST_NS: u64 = 600_000_000;
const FRAMES: usize = 10;
/// Longest wait for that many frames, and for the next frame, ns.
const PATIENCE_NS: u64 = 3_000_000_000;
const BLIND_NS: u64 = 500_000_000;
/// The camera's axes.
const NAMES: [&str; 6] = ["vx", "vy", "vz", "wx", "wy", "wz"];

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
    /// A defect.
    #[error("a defect; the robot stops by itself without commands")]
    Panic,
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
    let failed = DriveError::robot(config);
    let robot = robot::connect(config).map_err(&failed)?;
    let state = robot.read_once().map_err(&failed)?;
    print!("{}", look::frames(config, &state));
    let bounds = &config.bounds;
    println!(
        "  limits     {} m/s, {} rad/s; workspace {:?} to {:?} m; joint margin {} rad",
        bounds.caps.linear,
        bounds.caps.angular,
        bounds.workspace.lower,
        bounds.workspace.upper,
        bounds.reserve.margin
    );
    println!(
        "Compare F_T_NE and hand with the end effector at the desk: they must be what is mounted, and so must load.\n\
         The camera will move by {} mm along each of its axes and {} rad about it, and back, at {} mm/s.\n\
         Keep a hand on the stop.",
        1e3 * LENGTHS[0],
        LENGTHS[1],
        1e3 * SHARE * bounds.caps.linear
    );
    if !is_confirmed && !confirmed() {
        return Err(FirstMotionError::NotConfirmed);
    }
    // The first state that is read may be as old as the question.
    robot.read_once().map_err(&failed)?;
    let state = robot.read_once().map_err(&failed)?;
    if state.robot_mode != Mode::Idle {
        return Err(FirstMotionError::Mode(format!("{:?}", state.robot_mode)));
    }
    // A thread of its own is in real time; what is printed and thought is not.
    let moves = std::thread::scope(|scope| {
        let moving = scope.spawn(|| carry_out(config, &robot, &state, stop));
        moving.join().unwrap_or(Err(FirstMotionError::Panic))
    })?;
    for (name, most) in NAMES.into_iter().zip(moves.iter().map(Move::length_px)) {
        println!("  {name}: the image moved by {most:.1} px");
    }
    let flange_from_ee = robot::pose(&state.F_T_EE);
    let advice = advise(&config.scene, &config.hand_eye, &flange_from_ee, &moves);
    let advice = advice.ok_or(FirstMotionError::NoPose)?;
    println!(
        "The image moved as predicted to {:.2} px; with the best explanation, to {:.2} px.",
        advice.findings.before_px, advice.findings.after_px
    );
    for mistake in &advice.mistakes {
        println!("LIKELY MISTAKE  {mistake}");
    }
    match advice.mistakes.is_empty() {
        true => println!("All is as it should be. Start vpc-panda and vpcd, then: vpcctl arm"),
        false => println!("Do not arm. Mend this, then try again."),
    }
    Ok(advice.mistakes.is_empty())
}

/// All moves, from rest to rest.
fn carry_out(
    config: &Config,
    robot: &robot::Robot,
    state: &Told,
    stop: &AtomicBool,
) -> Result<Vec<Move>, FirstMotionError> {
    // Nothing moves yet: a terminal that waits does no harm.
    enter_real_time(config.priority, &mut |event| {
        if let Event::Lacks(what) = event {
            eprintln!("vpc-panda: DEGRADED, not real time: {what}");
        }
    });
    let domain = Domain::join(&config.domain).map_err(DriveError::from)?;
    // The robot's place: no other bridge is at work.
    let ports = RobotPorts::open(&domain).map_err(DriveError::from)?;
    let steering = Steering::begin(config, &robot::measured(state))?;
    let motion = Motion::begin(robot, config.interface).map_err(DriveError::robot(config))?;
    let mut stage = Stage {
        config,
        stop,
        features: domain.subscriber(1).map_err(DriveError::from)?,
        newest: None,
        ports,
        steering,
        motion,
    };
    let moves = stage.moves();
    // A robot that stopped by itself has ended the motion.
    if !matches!(moves, Err(FirstMotionError::Drive(_))) {
        stage.come_to_rest()?;
    }
    moves
}

/// The robot's clock, ns.
fn robots_ns(state: &Told) -> u64 {
    1_000_000 * state.time.as_millis()
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
    /// The newest frame, and when it came, ns.
    newest: Option<(u64, Features)>,
    ports: RobotPorts,
    steering: Steering,
    motion: Motion<'a>,
}

impl Stage<'_> {
    fn moves(&mut self) -> Result<Vec<Move>, FirstMotionError> {
        let mut moves = Vec::new();
        for axis in 0..NAMES.len() {
            let bounds = &self.config.bounds;
            let speed = SHARE
                * if axis < 3 {
                    bounds.caps.linear
                } else {
                    bounds.caps.angular
                };
            let seconds = LENGTHS[usize::from(axis >= 3)] / speed;
            let mut twist = [0.0; 6];
            twist[axis] = speed;
            let before = self.look()?;
            self.go(twist, seconds)?;
            let after = self.look()?;
            self.go(twist.map(|v| -v), seconds)?;
            moves.push(Move {
                flange: [before.0, after.0],
                image: [before.1, after.1],
            });
        }
        Ok(moves)
    }

    /// One of the robot's milliseconds, with this twist of the camera.
    fn step(&mut self, twist: [f64; 6]) -> Result<Told, FirstMotionError> {
        let failed = DriveError::robot(self.config);
        if self.stop.load(Ordering::Relaxed) {
            return Err(FirstMotionError::Stopped);
        }
        let state = self.motion.state().map_err(&failed)?;
        let now = robots_ns(&state);
        // Frames that came before the state, and not while it is answered.
        self.watch(now)?;
        let mut command = TwistCommand {
            twist,
            valid_until_ns: now + MOST_OBEYED_NS,
            ..TwistCommand::default()
        };
        command.stamp.published_ns = now;
        let measured = robot::measured(&state);
        let output = self.steering.step(&command, &measured, now);
        self.motion.answer(&output, false).map_err(&failed)?;
        let limited = self.steering.limited();
        let mount = self.config.mount(&measured.end_effector.flange_from_ee);
        let told = robot::told(&state, &mount, Doing::Moves(limited), now_ns());
        self.ports.robot.publish(&told).map_err(DriveError::from)?;
        if limited.by_workspace {
            return Err(FirstMotionError::Limited("a wall of the workspace is near"));
        }
        if limited.by_joint {
            return Err(FirstMotionError::Limited("a joint is near its margin"));
        }
        Ok(state)
    }

    /// All points are to stay in sight.
    fn watch(&mut self, now: u64) -> Result<(), FirstMotionError> {
        let count = self.config.scene.pattern.len();
        let since = self.newest.as_ref().map_or(now, |(came, _)| *came);
        let Some(frame) = self.features.latest()? else {
            return match now > since + BLIND_NS {
                true => Err(FirstMotionError::Features("no more frames come".to_owned())),
                false => Ok(()),
            };
        };
        if usize::try_from(frame.count) != Ok(count) || !frame.all_visible() {
            let found = format!(
                "{} of {count} points, visible {:#b}",
                frame.count, frame.visible
            );
            return Err(FirstMotionError::Features(found));
        }
        self.newest = Some((now, frame.message));
        Ok(())
    }

    fn go(&mut self, twist: [f64; 6], seconds: f64) -> Result<(), FirstMotionError> {
        let mut end = None;
        loop {
            let now = robots_ns(&self.step(twist)?);
            let end = *end.get_or_insert(now + Duration::from_secs_f64(seconds).as_nanos() as u64);
            if now >= end {
                return Ok(());
            }
        }
    }

    /// Rests; where the flange then is, and what the camera sees, px.
    fn look(&mut self) -> Result<(Pose, Vec<[f64; 2]>), FirstMotionError> {
        let begin = robots_ns(&self.step([0.0; 6])?);
        let count = self.config.scene.pattern.len();
        let mut sums = vec![[0.0; 2]; count];
        let (mut frames, mut last) = (0, 0);
        loop {
            let state = self.step([0.0; 6])?;
            let now = robots_ns(&state);
            let counts = |came: u64, frame: &Features| {
                // Both stamps are of the camera's clock.
                let latency = frame.stamp.published_ns.saturating_sub(frame.stamp.data_ns);
                came > begin + REST_NS.max(REST_NS / 2 + latency)
            };
            if let Some((came, frame)) = &self.newest
                && *came > last
                && counts(*came, frame)
            {
                last = *came;
                frames += 1;
                for (sum, point) in sums.iter_mut().zip(frame.points.chunks_exact(2)) {
                    sum[0] += point[0] / FRAMES as f64;
                    sum[1] += point[1] / FRAMES as f64;
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
        let failed = DriveError::robot(self.config);
        loop {
            let state = self.motion.state().map_err(&failed)?;
            let measured = robot::measured(&state);
            let output = self.steering.brake(&measured, robots_ns(&state));
            if self.steering.is_at_rest(&measured) {
                let still = Output::still(self.config.interface);
                self.motion.answer(&still, true).map_err(&failed)?;
                return Ok(());
            }
            self.motion.answer(&output, false).map_err(&failed)?;
        }
    }
}
