//! A robot of your own in the place of hw-sim's: the smallest bridge between `vpcd` and a robot
//! with a velocity interface at 1 kHz. Copy this file, and write your robot's driver in the place
//! of `stand_in.rs`.
//!
//! ```sh
//! vpcd --scene ipc/scene/scenes/paper-robot.toml --domain /tmp/mine --arm &
//! cargo run --release -p hw-sim --example own_robot -- /tmp/mine 30
//! ```
//! Ends when the features are at the goal (exit code 0), after so many seconds (1), or on SIGINT or
//! SIGTERM (1), each time with a robot that stands. A third argument names a file with your
//! hand-eye calibration. So that it runs alone, `stand_in.rs` plays the camera, too: with a camera
//! of your own leave it out.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use arm::{Bridge, Caps, Driver, Pose, ShaperSettings};
use hand_eye::{Frame, read};
use ipc::{Domain, RobotPorts, now_ns};
use messages::{RobotFaults, RobotMode, RobotState, TwistCommand};
use scene::Scene;
use signal_hook::consts::{SIGINT, SIGTERM};

mod stand_in;

type Failure = Box<dyn std::error::Error>;

/// A robot slower than this stands, m/s and rad/s.
const AT_REST: f64 = 1e-4;

/// One of the robot's milliseconds: from `vpc/twist` to the driver, and from the driver to
/// `vpc/robot`. `command` is the newest command.
fn step(
    bridge: &mut Bridge<stand_in::Robot>,
    ports: &mut RobotPorts,
    command: &mut TwistCommand,
    caps: &Caps,
) -> Result<(), Failure> {
    if let Some(newest) = ports.twist.latest()? {
        *command = newest.message;
    }
    let now = now_ns();
    // The dead man: a controller that fell silent, hangs, or is in lockstep moves nothing.
    bridge.obey(&command.in_force(now), command.in_force_until_ns(), caps);
    bridge.step(now);

    // For observers, and for vpcd, which a robot at fault disarms.
    let (is_at_fault, limited) = (bridge.driver.is_at_fault(), bridge.limited());
    let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], now);
    let mode = match (is_at_fault, limited.is_stale) {
        (true, _) => RobotMode::Fault,
        (false, true) => RobotMode::Stale,
        (false, false) => RobotMode::Moving,
    };
    state.mode = mode.code();
    for (fault, is_raised) in [
        (RobotFaults::REFLEX, is_at_fault),
        (RobotFaults::STALE_COMMAND, limited.is_stale),
        (RobotFaults::COMMAND_LIMITED, limited.is_cut),
        (RobotFaults::JOINT_LIMIT, limited.by_joint),
    ] {
        state.faults |= if is_raised { fault.0 } else { 0 };
    }
    // What is carried out, not what was asked for.
    state.twist = bridge.carried_out();
    state.joints = arm::JOINTS as u32;
    (state.q, state.dq) = bridge.driver.joints();
    ports.robot.publish(&state)?;
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("own_robot: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<bool, Failure> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: own_robot DOMAIN [SECONDS [HAND_EYE.toml]]";
    let directory = arguments.next().ok_or(usage)?;
    let seconds: f64 = arguments.next().unwrap_or("30".into()).parse()?;
    let mount = match arguments.next() {
        Some(file) => read(Path::new(&file), Frame::Flange)?.mount(&Pose::identity()),
        None => stand_in::mount(),
    };
    let end = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&end))?;
    }
    let scene = Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml")?;
    let domain = Domain::join(Path::new(&directory))?;
    let mut ports = RobotPorts::open(&domain)?;
    let robot = stand_in::Robot::new(&scene, &mount)?;
    let mut bridge = Bridge::new(robot, mount, ShaperSettings::default())?;
    let mut caps = Caps::axes(scene.limits.velocity());
    // Nothing is in force yet.
    let mut command = TwistCommand::default();
    let mut camera = stand_in::Camera::new(&domain, &scene)?;
    let begin = now_ns();
    let (mut first, mut error) = (None, f64::INFINITY);
    let (mut has_arrived, mut is_over) = (false, false);
    let mut millisecond = 0;
    loop {
        has_arrived |= error <= scene.success.convergence_px;
        let is_late = millisecond as f64 > 1e3 * seconds;
        is_over |= has_arrived || is_late || end.load(Ordering::Relaxed);
        // However it ends, the robot comes to rest first.
        if is_over {
            caps = Caps::axes([0.0; 6]);
            if bridge.driver.carried_out().amax() < AT_REST {
                break;
            }
        }
        // With libfranka this is `robot.control(...)`, which calls at its own pace.
        let due = begin + millisecond * 1_000_000;
        std::thread::sleep(Duration::from_nanos(due.saturating_sub(now_ns())));
        if millisecond.is_multiple_of(33) {
            error = camera.expose(&bridge.driver, &mount)?;
            first.get_or_insert(error);
        }
        step(&mut bridge, &mut ports, &mut command, &caps)?;
        millisecond += 1;
    }
    println!(
        "{{\"first_px\":{:.2},\"error_px\":{error:.2},\"seconds\":{:.2},\"mode\":\"{}\"}}",
        first.unwrap_or(f64::NAN),
        1e-3 * millisecond as f64,
        bridge.driver.mode()
    );
    Ok(has_arrived && !bridge.driver.is_at_fault())
}
