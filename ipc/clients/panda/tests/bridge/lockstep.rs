//! Both versions of the interface, judged by a client of another team, the crate `franka-rs`. In
//! lockstep the same commands bring the same bits, however late they are.

use std::time::{Duration, Instant};

use franka::{
    FciVersion, FrankaResult, JointVelocities, MoveControllerMode, RealtimeConfig, RobotMode,
    RobotOptions, RobotState, VersionPolicy,
};
use testkit::tell;

use crate::robot::Robot;

/// Duration and top speed, rad/s, of the motion.
const MILLISECONDS: u64 = 2000;
const TOP: f64 = 0.05;
/// How far it goes before it comes back: 4/3 / pi is the mean of a cubed sine over half of it.
const WAY: f64 = TOP * 4.0 / 3.0 / std::f64::consts::PI * MILLISECONDS as f64 / 2e3;
/// Commands in a row after which a robot in real time would stop, where they are late; a client that
/// is late for longer, now and then.
const LATE: Duration = Duration::from_millis(40);
const OFTEN: usize = 400;

/// What a state says of the motion, bit by bit.
fn bits(state: &RobotState) -> Vec<u64> {
    let joints = [state.q, state.dq, state.q_d, state.dq_d, state.ddq_d];
    let numbers = joints.iter().flatten().chain(&state.O_T_EE);
    numbers.map(|x| x.to_bits()).collect()
}

/// Moves joint 7 there and back; the states that were answered.
fn wave(robot: &franka::Robot, is_late: bool) -> FrankaResult<Vec<RobotState>> {
    let mut motion = robot.start_joint_velocity_control(MoveControllerMode::JointImpedance)?;
    let (mut elapsed_ms, mut states) = (0, Vec::with_capacity(4000));
    let mut sent: f64 = 0.0;
    while elapsed_ms < MILLISECONDS {
        let (state, period) = motion.read_once()?;
        // A state of version 10 has numbers of 32 bits.
        assert!((state.dq_d[6] - sent).abs() <= 1e-8, "{sent}");
        elapsed_ms += period.as_millis();
        states.push(state);
        let angle = 2.0 * std::f64::consts::PI * elapsed_ms as f64 / MILLISECONDS as f64;
        let mut dq = [0.0; 7];
        sent = TOP * angle.sin().powi(3);
        dq[6] = sent;
        let mut command = JointVelocities::new(dq);
        command.motion_finished = elapsed_ms >= MILLISECONDS;
        if is_late && states.len().is_multiple_of(OFTEN) {
            std::thread::sleep(LATE);
        }
        motion.write_once(&command, None)?;
    }
    Ok(states)
}

/// The motion of a robot of this version; what its states say, bit by bit.
fn moved(version: FciVersion, is_late: bool) -> Vec<Vec<u64>> {
    let number = match version {
        FciVersion::V10 => 10,
        FciVersion::V5 => 5,
    };
    let robot = Robot::start("lockstep", number, "");
    let options = RobotOptions::new(RealtimeConfig::Ignore);
    let options = options.with_version(VersionPolicy::Auto);
    let client = franka::Robot::with_options(&robot.address.to_string(), options).unwrap();
    assert_eq!(client.fci_version(), version);
    let begin = Instant::now();
    let states = wave(&client, is_late).unwrap();
    let (took, count) = (begin.elapsed(), states.len());
    tell(format_args!(
        "version {number}: a motion of {MILLISECONDS} ms, {count} states, took {took:?}"
    ));
    // A state for each command.
    assert_eq!(count as u64, 1 + MILLISECONDS);
    let at = |state: &RobotState| state.q[6];
    let most = states.iter().map(at).fold(f64::MIN, f64::max);
    let (first, last) = (at(&states[0]), at(&states[count - 1]));
    assert!((most - first - WAY).abs() < 1e-3, "{}", most - first);
    assert!((last - first).abs() < 1e-3, "{}", last - first);
    let state = client.read_once().unwrap();
    assert_eq!(state.robot_mode, RobotMode::Idle);
    drop(client);
    let report = robot.report();
    for words in [
        "\"reflexes\":0",
        "\"limit_violations\":0",
        "\"discontinuities\":0",
    ] {
        assert!(report.contains(words), "{report}");
    }
    states.iter().map(bits).collect()
}

#[test]
fn the_same_commands_bring_the_same_bits_however_late() {
    for version in [FciVersion::V10, FciVersion::V5] {
        assert!(moved(version, false) == moved(version, true));
    }
}
