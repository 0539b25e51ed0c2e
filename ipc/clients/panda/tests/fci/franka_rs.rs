//! Both versions of the interface, judged by a client of another team, the crate `franka-rs`.

use franka::{
    FciVersion, FrankaResult, JointVelocities, MoveControllerMode, RealtimeConfig, RobotMode,
    RobotOptions, VersionPolicy,
};
use testkit::tell;

use super::robot::Robot;
use super::{WAY, assert_clean};

/// Duration, s, and top speed, rad/s, of the motion: `panda.py` has the same.
const SECONDS: f64 = 2.0;
const TOP: f64 = 0.05;

/// What a client saw of a motion of joint 7 there and back.
struct Seen {
    way: f64,
    miss: f64,
    /// States that came right after the last, and how many of them echoed the command.
    states: u32,
    echoed: u32,
}

fn wave(robot: &franka::Robot) -> FrankaResult<Seen> {
    let mut motion = robot.start_joint_velocity_control(MoveControllerMode::JointImpedance)?;
    let (mut elapsed, mut sent): (f64, Option<f64>) = (0.0, None);
    let mut places = Vec::with_capacity(4000);
    let (mut states, mut echoed) = (0, 0);
    while elapsed < SECONDS {
        let (state, period) = motion.read_once()?;
        let period = period.as_secs_f64();
        if let Some(sent) = sent
            && period < 1.5e-3
        {
            states += 1;
            // A state of version 10 has numbers of 32 bits.
            echoed += u32::from((state.dq_d[6] - sent).abs() <= 1e-8);
        }
        elapsed += period;
        places.push(state.q[6]);
        let angle = 2.0 * std::f64::consts::PI * elapsed.min(SECONDS) / SECONDS;
        let mut dq = [0.0; 7];
        dq[6] = TOP * angle.sin().powi(3);
        sent = Some(dq[6]);
        let mut command = JointVelocities::new(dq);
        command.motion_finished = elapsed >= SECONDS;
        motion.write_once(&command, None)?;
    }
    let most = places.iter().copied().fold(f64::MIN, f64::max);
    Ok(Seen {
        way: most - places[0],
        miss: places[places.len() - 1] - places[0],
        states,
        echoed,
    })
}

#[test]
fn another_teams_client_finds_the_version_and_moves_the_robot() {
    for version in [FciVersion::V10, FciVersion::V5] {
        let number = match version {
            FciVersion::V10 => 10,
            FciVersion::V5 => 5,
        };
        let robot = Robot::of_version(number);
        let options = RobotOptions::new(RealtimeConfig::Ignore);
        let options = options.with_version(VersionPolicy::Auto);
        let client = franka::Robot::with_options(&robot.address().to_string(), options).unwrap();
        assert_eq!(client.fci_version(), version);
        let Seen {
            way,
            miss,
            states,
            echoed,
        } = wave(&client).unwrap();
        tell(format_args!(
            "franka-rs, version {number}: {way} rad, {miss} rad, {echoed} of {states} states echo"
        ));
        assert!((way - WAY).abs() < 1e-3 && miss.abs() < 1e-3);
        // How many are lost is the machine's matter.
        assert!(echoed > 100 && 2 * echoed > states);
        let state = client.read_once().unwrap();
        assert_eq!(state.robot_mode, RobotMode::Idle);
        drop(client);
        assert_clean(robot, 0);
    }
}
