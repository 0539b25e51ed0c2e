//! Where the robot and its camera are.

use crate::codes::{bits, codes};
use crate::field::Stamp;
use crate::message::{Qos, message};

/// Most joints of a robot.
const JOINTS: usize = 7;

codes! {
    /// What the robot does with commands.
    RobotMode {
        /// It waits for a first valid command.
        Idle = 0 => "idle",
        /// It executes commands.
        Moving = 1 => "moving",
        /// It stopped because the last command is no longer valid.
        Stale = 2 => "stale",
        /// It stopped by itself; see the faults.
        Fault = 3 => "fault",
    }
}

bits! {
    /// What is wrong with the robot.
    RobotFaults {
        /// A command was no longer valid when the next one was due.
        STALE_COMMAND = 1 => "stale command",
        /// A command was outside the limits and was clipped.
        COMMAND_LIMITED = 2 => "command limited",
        /// The robot's own reflex stopped it (Panda: a discontinuity or a limit of a joint).
        REFLEX = 4 => "reflex",
        /// A joint is at the limit of its range.
        JOINT_LIMIT = 8 => "joint limit",
        /// The pattern left the image or went behind the camera.
        PATTERN_LOST = 16 => "pattern lost",
    }
}

message! {
    /// State of the robot that carries the camera, at the instant `stamp.data_ns`.
    RobotState {
        /// Head.
        stamp: Stamp,
        /// Sequence number of the features exposed at this instant; 0 if there are none.
        features_sequence: u64,
        /// What it does with commands.
        mode: u32 [code(RobotMode)],
        /// What is wrong.
        faults: u32 [bits(RobotFaults)],
        /// Object in the camera frame: translation.
        translation: [f64; 3] ["m" finite],
        /// Object in the camera frame: rotation vector (axis times angle).
        rotation: [f64; 3] ["rad" finite],
        /// Camera velocity that is carried out, in the camera frame: vx vy vz wx wy wz.
        twist: [f64; 6] ["m/s, rad/s" finite],
        /// Valid entries of `q` and `dq`: 0 for a free-flying camera, 7 for a Panda.
        joints: u32 [range(0, JOINTS)],
        /// Zero.
        reserved: u32,
        /// Joint positions, base to flange; of a joint that turns without end, whole turns do not
        /// count.
        q: [f64; JOINTS] ["rad" finite],
        /// Joint velocities, base to flange.
        dq: [f64; JOINTS] ["rad/s" finite],
        /// Share of the last commands that came to the robot in time, 0 to 1; 0 where it does not
        /// count them, or no motion runs.
        commands_in_time: f64 [finite],
    }
    "vpc/robot" from "robot": Qos { history: 1, buffer: 64, subscribers: 8, publishers: 1 }
}

impl RobotState {
    /// A free-flying camera at rest in front of the object.
    ///
    /// `translation` (m) and `rotation` (rotation vector, rad) are the object in the camera frame.
    pub fn free_camera(translation: [f64; 3], rotation: [f64; 3], data_ns: u64) -> Self {
        let mut state = Self {
            translation,
            rotation,
            ..Self::default()
        };
        state.stamp.data_ns = data_ns;
        state
    }

    /// The mode; `None` if the code is unknown, which reception refuses.
    pub fn mode(&self) -> Option<RobotMode> {
        RobotMode::from_code(self.mode)
    }

    /// What is wrong.
    pub fn faults(&self) -> RobotFaults {
        RobotFaults(self.faults)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    #[test]
    fn a_state_is_checked_field_by_field() {
        let mut good = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], 1);
        good.stamp.sequence = 1;
        assert_eq!(good.check(), Ok(()));
        let refused = |change: fn(&mut RobotState)| {
            let mut state = good;
            change(&mut state);
            state.check().unwrap_err().to_string()
        };
        assert!(refused(|s| s.joints = 8).contains("joints = 8; allowed: 0 to 7"));
        assert!(refused(|s| s.mode = 9).contains("mode = 9"));
        assert!(refused(|s| s.rotation[2] = f64::NAN).contains("rotation[2] = NaN"));
        assert!(refused(|s| s.dq[6] = f64::INFINITY).contains("dq[6] = inf"));
        assert!(refused(|s| s.stamp.sequence = 0).contains("sequence = 0"));
    }

    #[test]
    fn faults_are_bits() {
        let faults = RobotFaults(RobotFaults::REFLEX.0 | RobotFaults::STALE_COMMAND.0);
        assert!(faults.any(RobotFaults::REFLEX) && !faults.any(RobotFaults::JOINT_LIMIT));
    }
}
