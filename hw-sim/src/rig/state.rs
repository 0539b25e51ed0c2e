//! What an arm adds to the state of the cell.

use messages::{RobotFaults, RobotMode, RobotState};
use panda::{Flag, Mode, State};

use crate::cell::raise;

/// Adds the own state of a robot of so many joints; the sequence may move the robot by itself.
pub(crate) fn add_arm(state: &mut RobotState, told: &State, joints: usize, obeys_controller: bool) {
    state.joints = joints as u32;
    (state.q, state.dq) = (told.q.into(), told.dq.into());
    state.commands_in_time = told.control_command_success_rate;
    if !obeys_controller {
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

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;
    use crate::cell::{Cell, Order};
    use crate::rig::{Rig, RigSettings};

    #[test]
    fn a_robot_in_reflex_is_at_fault() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let mut settings = RigSettings::new(&scene);
        settings.arm.is_shaped = false;
        let mut rig = Rig::new(&scene, &scene.goal, &settings).unwrap();
        assert_eq!(rig.state().mode(), Some(RobotMode::Idle));
        rig.obey(&Order {
            twist: [0.01, 0.0, 0.0, 0.0, 0.0, 0.03],
            elbow: 0.0,
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
        assert!(state.faults().any(RobotFaults::REFLEX));
    }
}
