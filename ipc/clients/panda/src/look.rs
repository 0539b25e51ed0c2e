//! What the bridge sees before anything moves: `--dry-run` and `--preflight`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use arm::Pose;
use franka::{FrankaError, RobotMode as Mode, RobotState as Told};
use ipc::{Domain, RobotPorts, now_ns};
use messages::TwistCommand;
use program::kernel::{self, Kernel};

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
    let mut steering = match Steering::begin(config, &robot::measured(&state)) {
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
            println!("vpc/twist in force: {}", list(&twist, 4));
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
    let kernel = Kernel::read();
    let word = if kernel.is_enough() { "ok  " } else { "note" };
    println!("{word}  kernel: {kernel}; needed: {}", kernel::NEEDED);
    let mut check = |is_met: bool, what: &str, found: String| {
        is_good &= is_met;
        println!("{}  {what}: {found}", if is_met { "ok  " } else { "LACK" });
    };
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
fn rate(config: &Config, robot: &robot::Robot, stop: &AtomicBool) -> Result<f64, FrankaError> {
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
    text += "  F_T_NE and hand are the end effector of the desk; F_T_NE as its matrix, mm:\n";
    text += &matrix(&robot::pose(&state.F_T_NE));
    let mm = |place: &[f64; 3]| list(&place.map(|x| 1e3 * x), 1);
    text + &format!(
        "  hand       {} kg, centre of mass at {} mm in the flange\n  load       {} kg at {} mm in the flange\n",
        state.m_ee,
        mm(&state.F_x_Cee),
        state.m_load,
        mm(&state.F_x_Cload),
    )
}

/// A place in mm and angles in deg about x, y, z, with R = Rz Ry Rx.
///
/// Source: the robot's app "Measure Pose" shows poses so (Basler, rc_visard, "Franka Emika pose
/// format").
fn words(pose: &Pose) -> String {
    let place = pose.translation.vector * 1e3;
    let (x, y, z) = pose.rotation.euler_angles();
    let turn = [x, y, z].map(f64::to_degrees);
    let (place, turn) = (list(place.as_slice(), 1), list(&turn, 2));
    format!("at {place} mm, angles Rx Ry Rz {turn} deg (R = Rz Ry Rx)")
}

/// The rows of a transformation, its place in mm.
///
/// Source: Franka, RIDE CLI 1.1.1, "End effector commissioning": the end effector's transformation
/// from the flange is a matrix of 4 x 4.
fn matrix(pose: &Pose) -> String {
    let row = |k: usize| {
        let turn = (0..3).map(|column| rounded(pose.rotation[(k, column)], 4));
        let turn: String = turn.map(|x| format!("{x:9.4}")).collect();
        let place = rounded(1e3 * pose.translation.vector[k], 1);
        format!("   {turn}{place:9.1}\n")
    };
    (0..3).map(row).collect()
}

fn list(numbers: &[f64], digits: usize) -> String {
    let numbers = numbers.iter().map(|x| rounded(*x, digits));
    let numbers: Vec<String> = numbers.map(|x| format!("{x:.digits$}")).collect();
    format!("({})", numbers.join(" "))
}

/// To so many decimals, a zero without a sign.
fn rounded(x: f64, digits: usize) -> f64 {
    let scale = 10_f64.powi(digits as i32);
    (x * scale).round() / scale + 0.0
}

fn sent(output: &Output) -> String {
    match output {
        Output::Joint(dq) => format!("joint velocities {} rad/s", list(dq.as_slice(), 4)),
        Output::Cartesian(twist) => {
            format!("end effector {} m/s, rad/s", list(twist.as_slice(), 4))
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Translation3};

    use super::*;

    #[test]
    fn a_pose_is_told_as_the_robots_app_and_the_desk_show_it() {
        let turn = Rotation3::from_euler_angles(0.1, -0.2, 0.3);
        let by_axes = Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), 0.3)
            * Rotation3::from_axis_angle(&nalgebra::Vector3::y_axis(), -0.2)
            * Rotation3::from_axis_angle(&nalgebra::Vector3::x_axis(), 0.1);
        assert!(turn.angle_to(&by_axes) < 1e-9);
        let pose = Pose::from_parts(Translation3::new(0.01, 0.0, -0.000_000_1), by_axes);
        assert_eq!(
            words(&pose),
            "at (10.0 0.0 0.0) mm, angles Rx Ry Rz (5.73 -11.46 17.19) deg (R = Rz Ry Rx)"
        );
        let quarter = Rotation3::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let pose = Pose::from_parts(Translation3::new(0.0, 0.0, 0.1034), quarter);
        let rows = "      0.0000  -1.0000   0.0000      0.0\n\
                    \x20     1.0000   0.0000   0.0000      0.0\n\
                    \x20     0.0000   0.0000   1.0000    103.4\n";
        assert_eq!(matrix(&pose), rows);
    }
}
