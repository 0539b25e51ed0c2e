//! What the controller commands.

use crate::codes::codes;
use crate::features::Features;
use crate::field::Stamp;
use crate::message::{Qos, message};

/// Longest time for which a robot obeys a command that none follows, ns.
pub const MOST_OBEYED_NS: u64 = 100_000_000;
/// How much later than now a message may claim to be published, ns: one clock serves all processes.
pub const FUTURE_NS: u64 = 1_000_000;

codes! {
    /// State of the controller.
    TwistState {
        /// No run is under way: start-up or shutdown. The twist is zero.
        Stopped = 0 => "stopped",
        /// On the way to the goal.
        Moving = 1 => "moving",
        /// The image error is below the scene's convergence threshold, and the camera moves as the
        /// pattern does; it stays so until the error is twice the threshold. The controller keeps
        /// regulating.
        Arrived = 2 => "arrived",
        /// Features are missing, stale or refused; the twist is zero until good ones come.
        Holding = 3 => "holding",
        /// Slowing down to zero at the configured deceleration.
        Braking = 4 => "braking",
        /// The twist is zero until an operator arms the controller.
        Disarmed = 5 => "disarmed",
    }
}

message! {
    /// Camera velocity command.
    TwistCommand {
        /// Head; `data_ns` is that of the features it answers.
        stamp: Stamp,
        /// Sequence number of the features it answers; 0 if it answers none.
        features_sequence: u64,
        /// `published_ns` of the features it answers.
        features_published_ns: u64 ["ns"],
        /// The camera must stop at this instant, CLOCK_MONOTONIC; 2^64-1 in lockstep.
        valid_until_ns: u64 ["ns"],
        /// State of the controller.
        state: u32 [code(TwistState)],
        /// Zero.
        reserved: u32,
        /// Camera velocity in the camera frame (x right, y down, z forward): vx vy vz wx wy wz,
        /// within the scene's limits.
        twist: [f64; 6] ["m/s, rad/s" finite],
        /// Velocity of joint 3 of an arm with seven joints, the elbow, beside that motion; 0: the
        /// elbow is held.
        elbow: f64 ["rad/s" finite],
    }
    // No history: a camera that restarts must not execute a command from before.
    "vpc/twist" from "controller": Qos { history: 0, buffer: 64, subscribers: 8, publishers: 1 }
}

impl TwistCommand {
    /// The answer to `features`, valid for ever: what lockstep wants. See
    /// [`TwistCommand::valid_until`].
    pub fn answer(features: &Features, twist: [f64; 6], state: TwistState) -> Self {
        Self::answer_to(&features.stamp, twist, state)
    }

    /// As [`TwistCommand::answer`], to the features message with this head.
    pub fn answer_to(features: &Stamp, twist: [f64; 6], state: TwistState) -> Self {
        let mut command = Self {
            features_sequence: features.sequence,
            features_published_ns: features.published_ns,
            valid_until_ns: u64::MAX,
            state: state.code(),
            twist,
            ..Self::default()
        };
        command.stamp.data_ns = features.data_ns;
        command
    }

    /// The zero twist that answers nothing: at start-up, at shutdown, and while no features come.
    pub fn zero(state: TwistState) -> Self {
        Self::answer_to(&Stamp::default(), [0.0; 6], state)
    }

    /// The same command, valid until this instant, CLOCK_MONOTONIC, ns.
    pub fn valid_until(self, valid_until_ns: u64) -> Self {
        Self {
            valid_until_ns,
            ..self
        }
    }

    /// The same command with a velocity of the elbow, rad/s.
    pub fn with_elbow(self, elbow: f64) -> Self {
        Self { elbow, ..self }
    }

    /// Whether this is the answer to the features message with this sequence number and time of
    /// publication.
    pub fn answers(&self, sequence: u64, published_ns: u64) -> bool {
        self.features_sequence == sequence && self.features_published_ns == published_ns
    }

    /// Until when a robot in real time obeys it, CLOCK_MONOTONIC, ns: while it is valid, but no
    /// longer than [`MOST_OBEYED_NS`] after it was published, whatever it claims. 0 for a command
    /// of lockstep, which is valid for ever because its time is not real.
    pub fn in_force_until_ns(&self) -> u64 {
        match self.valid_until_ns {
            u64::MAX => 0,
            valid => valid.min(self.stamp.published_ns.saturating_add(MOST_OBEYED_NS)),
        }
    }

    /// The dead man of every robot in real time: what the newest command lets it do at this instant
    /// (CLOCK_MONOTONIC, ns). Zero when it is no longer in force, is from the future, or is not
    /// finite. Also ask it for zero before the first command.
    pub fn in_force(&self, now_ns: u64) -> [f64; 6] {
        match self.is_in_force(now_ns) {
            true => self.twist,
            false => [0.0; 6],
        }
    }

    fn is_in_force(&self, now_ns: u64) -> bool {
        let is_from_future = self.stamp.published_ns > now_ns.saturating_add(FUTURE_NS);
        let is_finite = self
            .twist
            .iter()
            .chain([&self.elbow])
            .all(|v| v.is_finite());
        now_ns < self.in_force_until_ns() && is_finite && !is_from_future
    }

    /// As [`TwistCommand::in_force`], of the elbow, rad/s.
    pub fn elbow_in_force(&self, now_ns: u64) -> f64 {
        match self.is_in_force(now_ns) {
            true => self.elbow,
            false => 0.0,
        }
    }

    /// Whether the command may be executed at this instant (CLOCK_MONOTONIC, ns).
    pub fn is_valid_at(&self, now_ns: u64) -> bool {
        now_ns < self.valid_until_ns
    }

    /// The state; `None` if the code is unknown, which reception refuses.
    pub fn state(&self) -> Option<TwistState> {
        TwistState::from_code(self.state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    #[test]
    fn no_command_is_in_force_for_longer_than_a_robot_obeys() {
        const SENT: u64 = 5_000_000_000;
        let command = |valid_until_ns, twist| {
            let mut command = TwistCommand::zero(TwistState::Moving);
            command.stamp.published_ns = SENT;
            (command.valid_until_ns, command.twist) = (valid_until_ns, twist);
            command
        };
        let (go, still) = ([0.1; 6], [0.0; 6]);
        let short = command(SENT + 10, go);
        assert_eq!(
            (short.in_force(SENT + 9), short.in_force(SENT + 10)),
            (go, still)
        );
        let long = command(SENT + 33_000_000_000, go);
        assert_eq!(long.in_force(SENT + MOST_OBEYED_NS - 1), go);
        assert_eq!(long.in_force(SENT + MOST_OBEYED_NS), still);
        // From the future, or of lockstep.
        assert_eq!(long.in_force(SENT - 2 * FUTURE_NS), still);
        assert_eq!(command(u64::MAX, go).in_force(SENT), still);
        let mut broken = go;
        broken[4] = f64::NAN;
        assert_eq!(command(SENT + 10, broken).in_force(SENT), still);
        assert_eq!(TwistCommand::default().in_force(0), still);
        // The elbow of an arm stops with its camera.
        let turns = short.with_elbow(0.2);
        assert_eq!(
            (
                turns.elbow_in_force(SENT + 9),
                turns.elbow_in_force(SENT + 10)
            ),
            (0.2, 0.0)
        );
        let broken = short.with_elbow(f64::NAN);
        assert_eq!(broken.in_force(SENT + 9), still);
        assert_eq!(broken.elbow_in_force(SENT + 9), 0.0);
    }

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
