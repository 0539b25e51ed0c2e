//! What the bridge sees before anything moves: `--dry-run` and `--preflight`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use franka::{FrankaError, RobotMode as Mode, RobotState as Told};
use ipc::{Domain, RobotPorts, TwistCommand, now_ns};
use panda::Pose;

use crate::config::Config;
use crate::drive::DriveError;
use crate::robot::{self, Motion};
use crate::steering::{Output, Steering};

/// How long a dry run looks.
const LOOKS: Duration = Duration::from_secs(3);
/// Between two lines of a dry run, states.
const LINE: u64 = 500;
/// States that a preflight receives, and commands that it sends.
const STATES: usize = 2000;
/// Most of the time between two states, 99 of 100, ms.
const MOST_MS: f64 = 1.3;
/// Least share of commands that the robot gets in time.
const LEAST_RATE: f64 = 0.98;

/// Connects, reads, and prints frames and what would be sent; moves nothing. Whether a motion could
/// begin.
///
/// # Errors
/// [`DriveError`]: the robot or the shared memory cannot be used.
pub fn dry_run(config: &Config, stop: &AtomicBool) -> Result<bool, DriveError> {
    let failed = DriveError::robot(config);
    let robot = robot::connect(config).map_err(&failed)?;
    let state = robot.read_once().map_err(&failed)?;
    print!("{}", frames(config, &state));
    let domain = Domain::join(&config.domain)?;
    // Its place is taken as when it works: two bridges are one too many.
    let mut ports = RobotPorts::open(&domain)?;
    let measured = robot::measured(&state);
    let mount = config.mount(&measured.flange_from_ee);
    let steering = Steering::new(
        mount,
        config.bounds,
        config.interface,
        config.model,
        &measured,
    );
    let mut steering = match steering {
        Ok(steering) => steering,
        Err(why) => {
            println!("no motion could begin: {why}");
            return Ok(false);
        }
    };
    let mut command = TwistCommand::default();
    let (begin, mut states) = (Instant::now(), 0);
    while begin.elapsed() < LOOKS && !stop.load(Ordering::Relaxed) {
        let state = robot.read_once().map_err(&failed)?;
        if let Some(newest) = ports.twist.latest()? {
            command = newest.message;
        }
        let now = now_ns();
        let output = steering.step(&command, &robot::measured(&state), now);
        if states % LINE == 0 {
            let twist = command.in_force(now);
            println!("vpc/twist in force: {}", list(&twist));
            println!("  would be sent: {}", sent(&output));
        }
        states += 1;
    }
    println!("mode {:?}; nothing was sent", state.robot_mode);
    Ok(state.robot_mode == Mode::Idle)
}

/// Checks machine, network and robot. The last check holds the arm where it is for two seconds by
/// velocities of zero. Whether all is well.
///
/// # Errors
/// [`DriveError`]: the robot cannot be used.
pub fn preflight(config: &Config, stop: &AtomicBool) -> Result<bool, DriveError> {
    let failed = DriveError::robot(config);
    let mut is_good = true;
    let mut check = |is_met: bool, what: &str, found: String| {
        is_good &= is_met;
        println!("{}  {what}: {found}", if is_met { "ok  " } else { "LACK" });
    };
    let kernel = franka::realtime::has_realtime_kernel();
    let found = match kernel {
        true => "PREEMPT_RT".to_owned(),
        false => "not PREEMPT_RT: expect reflexes under load".to_owned(),
    };
    check(kernel, "kernel", found);
    let robot = robot::connect(config).map_err(&failed)?;
    let priority = config.priority;
    let got = franka::realtime::set_current_thread_scheduler_priority(priority);
    let found = match &got {
        Ok(()) => format!("SCHED_FIFO {priority}"),
        Err(why) => format!("{why}; allow CAP_SYS_NICE, or LimitRTPRIO="),
    };
    check(got.is_ok(), "priority", found);
    let state = robot.read_once().map_err(&failed)?;
    let idle = state.robot_mode == Mode::Idle;
    let errors = &state.current_errors;
    check(idle, "mode", format!("{:?} {errors}", state.robot_mode));
    let (mut last, mut gaps, mut lost) = (Instant::now(), Vec::with_capacity(STATES), 0);
    let mut time = state.time.as_millis();
    for _ in 0..STATES {
        let state = robot.read_once().map_err(&failed)?;
        gaps.push(1e3 * last.elapsed().as_secs_f64());
        last = Instant::now();
        lost += state.time.as_millis().saturating_sub(time + 1);
        time = state.time.as_millis();
        if stop.load(Ordering::Relaxed) {
            return Ok(false);
        }
    }
    gaps.sort_by(f64::total_cmp);
    let (median, most) = (gaps[STATES / 2], gaps[STATES * 99 / 100]);
    let found = format!("{lost} of {STATES} lost; {median:.2} ms apart, p99 {most:.2} ms");
    check(lost == 0 && most < MOST_MS, "states", found);
    if idle {
        let rate = rate(config, &robot, stop).map_err(&failed)?;
        let found = format!("{:.1} % at worst, by the robot's own count", 1e2 * rate);
        check(rate > LEAST_RATE, "commands in time", found);
    }
    println!("      filter: none on our side");
    print!("{}", frames(config, &state));
    Ok(is_good)
}

/// The least success rate while the arm is held where it is.
fn rate(config: &Config, robot: &franka::Robot, stop: &AtomicBool) -> Result<f64, FrankaError> {
    let still = Output::still(config.interface);
    let mut motion = Motion::begin(robot, config.interface)?;
    let mut least: f64 = 1.0;
    for count in 0..STATES {
        let state = motion.state()?;
        // It counts the last 100 commands.
        if count > 200 {
            least = least.min(state.control_command_success_rate);
        }
        if stop.load(Ordering::Relaxed) {
            break;
        }
        motion.answer(&still, false)?;
    }
    motion.state()?;
    motion.answer(&still, true)?;
    Ok(least)
}

/// The robot's frames and load as it has them set, and where the camera is by them.
pub(crate) fn frames(config: &Config, state: &Told) -> String {
    let flange_from_ee = robot::pose(&state.F_T_EE);
    let base_from_ee = robot::pose(&state.O_T_EE);
    let mount = config.mount(&flange_from_ee);
    let base_from_flange = base_from_ee * flange_from_ee.inverse();
    let rows = [
        ("O_T_EE", base_from_ee),
        ("F_T_EE", flange_from_ee),
        ("F_T_NE", robot::pose(&state.F_T_NE)),
        ("NE_T_EE", robot::pose(&state.NE_T_EE)),
        ("F_T_camera", mount.flange_from_camera),
        ("O_T_camera", mount.camera(&base_from_flange)),
    ];
    let mut text = format!("robot {} at {}\n", config.model, config.robot);
    for (name, pose) in rows {
        text += &format!("  {name:<10} {}\n", words(&pose));
    }
    text + &format!(
        "  load       {} kg at {} m in the flange\n  hand       {} kg\n",
        state.m_load,
        list(&state.F_x_Cload),
        state.m_ee
    )
}

/// m, and a rotation vector in deg.
fn words(pose: &Pose) -> String {
    let turn = pose.rotation.scaled_axis().map(f64::to_degrees);
    format!(
        "at {} m, turned by {} deg",
        list(pose.translation.vector.as_slice()),
        list(turn.as_slice())
    )
}

fn list(numbers: &[f64]) -> String {
    let numbers: Vec<String> = numbers.iter().map(|x| format!("{x:.4}")).collect();
    format!("({})", numbers.join(" "))
}

fn sent(output: &Output) -> String {
    match output {
        Output::Joint(dq) => format!("joint velocities {} rad/s", list(dq.as_slice())),
        Output::Cartesian(twist) => format!("end effector {} m/s, rad/s", list(twist.as_slice())),
    }
}
