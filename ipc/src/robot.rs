//! Where the robot and its camera are.

use core::mem::{offset_of, size_of};

use iceoryx2::prelude::ZeroCopySend;

use crate::message::{self, Invalid, Message, Qos, Stamp, codes};

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

/// Bits of [`RobotState::faults`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotFaults(pub u32);

impl RobotFaults {
    /// A command was not valid in time.
    pub const STALE_COMMAND: Self = Self(1);
    /// A command was outside the limits and was cut.
    pub const COMMAND_LIMITED: Self = Self(1 << 1);
    /// The robot's own reflex stopped it (Panda: a discontinuity or a limit of a joint).
    pub const REFLEX: Self = Self(1 << 2);
    /// A joint is at the limit of its range.
    pub const JOINT_LIMIT: Self = Self(1 << 3);
    /// The pattern left the image or went behind the camera.
    pub const PATTERN_LOST: Self = Self(1 << 4);

    /// Whether any of these bits is set.
    pub fn any(self, of: Self) -> bool {
        self.0 & of.0 != 0
    }
}

/// State of the robot that carries the camera, at the instant `stamp.data_ns`; service `vpc/robot`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("vpc/RobotState/1")]
pub struct RobotState {
    /// Head.
    pub stamp: Stamp,
    /// Sequence number of the features exposed at this instant; 0 where none were.
    pub features_sequence: u64,
    /// A [`RobotMode`] code.
    pub mode: u32,
    /// Bits of [`RobotFaults`].
    pub faults: u32,
    /// Object in the camera frame: translation, m.
    pub translation: [f64; 3],
    /// Object in the camera frame: rotation vector (axis times angle), rad.
    pub rotation: [f64; 3],
    /// Camera velocity in the camera frame as it is carried out: vx vy vz in m/s, wx wy wz in rad/s.
    pub twist: [f64; 6],
    /// Joints in `q` and `dq`, 0 for a free-flying camera, 7 for a Panda.
    pub joints: u32,
    /// Zero.
    pub reserved: u32,
    /// Joint positions, base to flange, rad.
    pub q: [f64; 7],
    /// Joint velocities, base to flange, rad/s.
    pub dq: [f64; 7],
    /// Zero; room for what a real arm will want to say.
    pub room: [f64; 8],
}

const _: () = {
    assert!(size_of::<RobotState>() == 320);
    assert!(offset_of!(RobotState, stamp) == 0);
    assert!(offset_of!(RobotState, features_sequence) == 24);
    assert!(offset_of!(RobotState, mode) == 32);
    assert!(offset_of!(RobotState, faults) == 36);
    assert!(offset_of!(RobotState, translation) == 40);
    assert!(offset_of!(RobotState, rotation) == 64);
    assert!(offset_of!(RobotState, twist) == 88);
    assert!(offset_of!(RobotState, joints) == 136);
    assert!(offset_of!(RobotState, reserved) == 140);
    assert!(offset_of!(RobotState, q) == 144);
    assert!(offset_of!(RobotState, dq) == 200);
    assert!(offset_of!(RobotState, room) == 256);
};

impl RobotState {
    /// A free-flying camera at rest in front of the object.
    ///
    /// `translation` (m) and `rotation` (rotation vector, rad) are the object in the camera frame.
    pub fn free_camera(translation: [f64; 3], rotation: [f64; 3], data_ns: u64) -> Self {
        Self {
            stamp: Stamp {
                data_ns,
                ..Stamp::default()
            },
            features_sequence: 0,
            mode: RobotMode::Idle.code(),
            faults: 0,
            translation,
            rotation,
            twist: [0.0; 6],
            joints: 0,
            reserved: 0,
            q: [0.0; 7],
            dq: [0.0; 7],
            room: [0.0; 8],
        }
    }

    /// The mode; `None` where the code is unknown, which reception refuses.
    pub fn mode(&self) -> Option<RobotMode> {
        RobotMode::from_code(self.mode)
    }

    /// The faults.
    pub fn faults(&self) -> RobotFaults {
        RobotFaults(self.faults)
    }
}

impl Message for RobotState {
    const SERVICE: &'static str = "vpc/robot";
    const QOS: Qos = Qos {
        history: 1,
        buffer: 64,
        subscribers: 8,
        publishers: 1,
    };

    message::carried_by!(robot);

    fn check(&self) -> Result<(), Invalid> {
        let service = Self::SERVICE;
        message::check_stamp(service, &self.stamp)?;
        message::check_code(service, "mode", self.mode, self.mode().is_some())?;
        message::check_count(service, "joints", self.joints, 0..=self.q.len())?;
        message::check_finite(service, "translation", &self.translation)?;
        message::check_finite(service, "rotation", &self.rotation)?;
        message::check_finite(service, "twist", &self.twist)?;
        message::check_finite(service, "q", &self.q)?;
        message::check_finite(service, "dq", &self.dq)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
