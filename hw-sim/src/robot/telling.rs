//! The cell in the words of the contract. What an arm says beyond it stands in `room`, as `CONTRACT.md` lists.

use ipc::{RobotFaults, RobotMode, RobotState};
use panda::{Errors, Flag, JOINTS, Mode};

use super::rig::Rig;
use super::sequence::Phase;

/// The state of the cell now; `is_exposure` where a frame is exposed at this instant.
pub fn state(rig: &mut Rig, is_exposure: bool) -> RobotState {
    let is_stale = rig.is_stale();
    let is_begun = rig.time_s() > 0.0;
    let arm = rig.arm();
    let object = arm.object();
    let told = arm.state();
    let mut state = RobotState::free_camera(
        object.translation.into(),
        object.rotation_vector(),
        rig.now_ns(),
    );
    state.features_sequence = if is_exposure { rig.frames() } else { 0 };
    state.twist = arm.camera_twist();
    state.joints = JOINTS as u32;
    (state.q, state.dq) = (told.q.into(), told.dq.into());
    let step = rig.sequence().phase() as u32;
    state.room = [
        f64::from(told.robot_mode as u32 + 1),
        f64::from(bits(told.current_errors)),
        f64::from(bits(told.last_motion_errors)),
        told.control_command_success_rate,
        f64::from(step + 1),
        f64::from(gripper(rig.sequence().phase())),
        0.0,
        0.0,
    ];

    let is_faulty = matches!(
        told.robot_mode,
        Mode::Reflex | Mode::UserStopped | Mode::AutomaticErrorRecovery
    );
    let mode = match (is_faulty, is_begun, is_stale) {
        (true, ..) => RobotMode::Fault,
        (_, false, _) => RobotMode::Idle,
        (_, true, true) => RobotMode::Stale,
        (_, true, false) => RobotMode::Moving,
    };
    state.mode = mode.code();
    let joint_limit = told
        .current_errors
        .flags()
        .any(|flag| flag.name().contains("position_limits"));
    for (fault, raised) in [
        (RobotFaults::STALE_COMMAND, is_begun && is_stale),
        (RobotFaults::COMMAND_LIMITED, rig.was_limited()),
        (RobotFaults::REFLEX, told.robot_mode == Mode::Reflex),
        (RobotFaults::JOINT_LIMIT, joint_limit),
    ] {
        state.faults |= if raised { fault.0 } else { 0 };
    }
    state
}

/// A bit for each flag, in the order of [`Flag::ALL`], which the contract lists.
fn bits(errors: Errors) -> u32 {
    let set = |(bit, &flag): (usize, &Flag)| u32::from(errors.contains(flag)) << bit;
    Flag::ALL.iter().enumerate().map(set).sum()
}

/// 1 holding, 2 opening, 3 open.
fn gripper(phase: Phase) -> u32 {
    match phase {
        Phase::Releasing => 2,
        Phase::Retreating | Phase::Done => 3,
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;
    use crate::robot::rig::RigSettings;

    #[test]
    fn the_bits_of_errors_are_those_that_the_contract_lists() {
        let contract = include_str!("../../../ipc/CONTRACT.md");
        for (name, bit) in [
            ("joint_position_limits_violation", 0),
            ("cartesian_velocity_violation", 3),
            ("communication_constraints_violation", 15),
        ] {
            let flag = Flag::ALL.iter().find(|flag| flag.name() == name).unwrap();
            assert_eq!(bits(Errors::from(*flag)), 1 << bit);
            assert!(contract.contains(&format!("{bit} {name}")));
        }
        assert_eq!(Flag::ALL.len(), 16);
    }

    #[test]
    fn a_robot_in_reflex_is_at_fault_and_says_why() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let mut settings = RigSettings::new(&scene);
        settings.arm.shaping = crate::robot::bridge::Shaping::Off;
        let mut rig = Rig::new(&scene, &scene.goal, &settings, 0).unwrap();
        assert_eq!(state(&mut rig, false).mode(), Some(RobotMode::Idle));
        rig.command(&[0.01, 0.0, 0.0, 0.0, 0.0, 0.03], u64::MAX, true);
        for _ in 0..10 {
            rig.look().unwrap();
            rig.advance();
        }
        let state = state(&mut rig, false);
        assert_eq!(state.mode(), Some(RobotMode::Fault));
        assert_eq!(state.room[0], 3.0);
        assert!(state.faults().any(RobotFaults::REFLEX) && state.room[1] != 0.0);
    }
}
