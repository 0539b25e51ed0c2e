//! What an arm adds to the state of the cell: beyond the contract's fields it stands in `room`, as
//! `CONTRACT.md` lists.

use messages::{RobotFaults, RobotMode, RobotState};
use panda::{Flag, JOINTS, Mode, State};

use crate::cell::raise;
use crate::robot::sequence::TaskStep;

/// Adds the robot's own state and the step of the sequence.
pub(crate) fn add_arm(state: &mut RobotState, told: &State, phase: TaskStep) {
    state.joints = JOINTS as u32;
    (state.q, state.dq) = (told.q.into(), told.dq.into());
    state.room = [
        f64::from(told.robot_mode as u32 + 1),
        f64::from(told.current_errors.bits()),
        f64::from(told.last_motion_errors.bits()),
        told.control_command_success_rate,
        f64::from(phase as u32 + 1),
        f64::from(gripper(phase)),
        0.0,
        0.0,
    ];
    if !phase.obeys_controller() {
        // A motion of its own: nobody else is obeyed.
        state.mode = RobotMode::Idle.code();
    }
    let is_reflex = told.robot_mode == Mode::Reflex;
    if is_reflex
        || matches!(
            told.robot_mode,
            Mode::UserStopped | Mode::AutomaticErrorRecovery
        )
    {
        state.mode = RobotMode::Fault.code();
    }
    let mut errors = told.current_errors.flags();
    let is_outside = errors.any(Flag::is_position_limit);
    raise(state, RobotFaults::REFLEX, is_reflex);
    raise(state, RobotFaults::JOINT_LIMIT, is_outside);
}

/// 1 holding, 2 opening, 3 open.
fn gripper(phase: TaskStep) -> u32 {
    match phase {
        TaskStep::Releasing => 2,
        TaskStep::Retreating | TaskStep::Done => 3,
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use panda::Errors;
    use scene::Scene;

    use super::*;
    use crate::cell::{Cell, Order};
    use crate::rig::{Rig, RigSettings};

    #[test]
    fn the_bits_of_errors_are_those_that_the_contract_lists() {
        let contract = include_str!("../../../ipc/CONTRACT.md");
        for (name, bit) in [
            ("joint_position_limits_violation", 0),
            ("cartesian_velocity_violation", 3),
            ("communication_constraints_violation", 12),
        ] {
            let flag = Flag::ALL.iter().find(|flag| flag.name() == name).unwrap();
            assert_eq!(Errors::from(*flag).bits(), 1 << bit);
            assert!(contract.contains(&format!("{bit} {name}")));
        }
        assert_eq!(Flag::ALL.len(), 13);
    }

    #[test]
    fn a_robot_in_reflex_is_at_fault_and_says_why() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let mut settings = RigSettings::new(&scene);
        settings.arm.shaping = crate::robot::bridge::Shaping::Off;
        let mut rig = Rig::new(&scene, &scene.goal, &settings).unwrap();
        assert_eq!(rig.state().mode(), Some(RobotMode::Idle));
        rig.obey(&Order {
            twist: [0.01, 0.0, 0.0, 0.0, 0.0, 0.03],
            sent_ns: 0,
            until_ns: u64::MAX,
            is_armed: true,
        });
        for ms in 0..10 {
            rig.look(ms * 1_000_000).unwrap();
            rig.advance();
        }
        let state = rig.state();
        assert_eq!(state.mode(), Some(RobotMode::Fault));
        assert_eq!(state.room[0], 3.0);
        assert!(state.faults().any(RobotFaults::REFLEX) && state.room[1] != 0.0);
    }
}
