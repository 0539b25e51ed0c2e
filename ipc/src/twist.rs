//! What the controller commands.

use core::mem::{offset_of, size_of};

use iceoryx2::prelude::ZeroCopySend;

use crate::features::Features;
use crate::message::{self, Invalid, Message, Qos, Stamp, codes};

codes! {
    /// What the controller is about.
    TwistState {
        /// No run is under way: start-up or shutdown; the twist is zero.
        Stopped = 0 => "stopped",
        /// On the way to the goal.
        Moving = 1 => "moving",
        /// The image error is below the scene's convergence threshold; the controller keeps regulating.
        Arrived = 2 => "arrived",
        /// Features are missing, stale or refused; the twist is zero until good ones come.
        Holding = 3 => "holding",
        /// Slowing down to zero, at the deceleration of the configuration.
        Braking = 4 => "braking",
        /// The twist is zero until an operator arms the controller.
        Disarmed = 5 => "disarmed",
    }
}

/// Camera velocity command; service `vpc/twist`.
///
/// Whoever executes it stops when it is no longer valid: a silent controller never leaves its last command standing.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("vpc/TwistCommand/1")]
pub struct TwistCommand {
    /// Head; `data_ns` is that of the features it answers.
    pub stamp: Stamp,
    /// Sequence number of the features it answers; 0 where it answers none.
    pub features_sequence: u64,
    /// `published_ns` of the features it answers, which tells a restarted camera's message from its predecessor's.
    pub features_published_ns: u64,
    /// The command holds until this instant, CLOCK_MONOTONIC, ns; afterwards the camera must stop. `u64::MAX` in
    /// lockstep, where time does not pass between frames.
    pub valid_until_ns: u64,
    /// A [`TwistState`] code.
    pub state: u32,
    /// Zero.
    pub reserved: u32,
    /// Velocity of the camera in the camera frame (x right, y down, z forward): vx vy vz in m/s, wx wy wz in rad/s;
    /// finite, inside the scene's limits.
    pub twist: [f64; 6],
}

const _: () = {
    assert!(size_of::<TwistCommand>() == 104);
    assert!(offset_of!(TwistCommand, stamp) == 0);
    assert!(offset_of!(TwistCommand, features_sequence) == 24);
    assert!(offset_of!(TwistCommand, features_published_ns) == 32);
    assert!(offset_of!(TwistCommand, valid_until_ns) == 40);
    assert!(offset_of!(TwistCommand, state) == 48);
    assert!(offset_of!(TwistCommand, reserved) == 52);
    assert!(offset_of!(TwistCommand, twist) == 56);
};

impl TwistCommand {
    /// The answer to some features, valid for ever (lockstep); see [`TwistCommand::valid_for_ns`].
    pub fn answer(features: &Features, twist: [f64; 6], state: TwistState) -> Self {
        Self::answer_to(&features.stamp, twist, state)
    }

    /// The answer to the features message with this head.
    pub fn answer_to(features: &Stamp, twist: [f64; 6], state: TwistState) -> Self {
        Self {
            stamp: Stamp {
                data_ns: features.data_ns,
                ..Stamp::default()
            },
            features_sequence: features.sequence,
            features_published_ns: features.published_ns,
            valid_until_ns: u64::MAX,
            state: state.code(),
            reserved: 0,
            twist,
        }
    }

    /// The zero twist that answers nothing: at start-up, at shutdown, and while no features come.
    pub fn zero(state: TwistState) -> Self {
        Self::answer_to(&Stamp::default(), [0.0; 6], state)
    }

    /// The same command, valid from now for this long, ns.
    pub fn valid_for_ns(mut self, duration: u64) -> Self {
        self.valid_until_ns = crate::now_ns().saturating_add(duration);
        self
    }

    /// Whether this is the answer to the features message with this sequence number and time of publication.
    pub fn answers(&self, sequence: u64, published_ns: u64) -> bool {
        self.features_sequence == sequence && self.features_published_ns == published_ns
    }

    /// Whether the command may be executed at this instant (CLOCK_MONOTONIC, ns).
    pub fn is_valid_at(&self, now_ns: u64) -> bool {
        now_ns < self.valid_until_ns
    }

    /// The state; `None` where the code is unknown, which reception refuses.
    pub fn state(&self) -> Option<TwistState> {
        TwistState::from_code(self.state)
    }
}

impl Message for TwistCommand {
    const SERVICE: &'static str = "vpc/twist";
    /// No history: a camera that restarts must not execute a command from before.
    const QOS: Qos = Qos {
        history: 0,
        buffer: 64,
        subscribers: 8,
        publishers: 1,
    };

    message::carried_by!(twist);

    fn check(&self) -> Result<(), Invalid> {
        message::check_stamp(Self::SERVICE, &self.stamp)?;
        message::check_code(Self::SERVICE, "state", self.state, self.state().is_some())?;
        message::check_finite(Self::SERVICE, "twist", &self.twist)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_told_from_the_answer_to_a_restarted_camera() {
        let mut features = Features::new(&[[0.0, 0.0]; 4], 5);
        (features.stamp.sequence, features.stamp.published_ns) = (1, 1000);
        let command = TwistCommand::answer(&features, [0.0; 6], TwistState::Moving);
        assert!(command.answers(1, 1000));
        assert!(!command.answers(1, 2000) && !command.answers(2, 1000));
    }

    #[test]
    fn a_command_ends_at_its_instant() {
        let mut command = TwistCommand::zero(TwistState::Stopped);
        command.valid_until_ns = 100;
        assert!(command.is_valid_at(99) && !command.is_valid_at(100));
    }

    #[test]
    fn an_unknown_state_and_an_infinite_twist_are_refused() {
        let mut command = TwistCommand::zero(TwistState::Stopped);
        command.stamp.sequence = 1;
        assert_eq!(command.check(), Ok(()));
        command.state = 77;
        let message = command.check().unwrap_err().to_string();
        assert!(message.starts_with("vpc/twist: state = 77"), "{message}");
        command.state = 1;
        command.twist[3] = f64::INFINITY;
        let message = command.check().unwrap_err().to_string();
        assert!(
            message.starts_with("vpc/twist: twist[3] = inf"),
            "{message}"
        );
    }
}
