//! The 1 kHz link: which command answers which state, and what is lost.
//!
//! The robot sends a state with a number every millisecond. A command counts only if it carries the
//! number of the last state and comes before the next one; anything else is dropped. Source: Franka
//! Emika, FCI documentation, "Network requirements" and "Errors due to communication problems".

use crate::kinematics::{Joints, Twist};

/// Lost commands in a row after which the robot aborts a motion.
pub const ABORT: u32 = 20;
/// Commands over which the success rate is taken.
pub const WINDOW: u32 = 100;

/// A velocity to follow for the next millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Of the end effector's origin along base axes.
    Cartesian(Twist),
    /// Of the joints.
    Joint(Joints),
}

/// Which of the motions a motion is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionKind {
    /// [`Motion::Cartesian`].
    Cartesian,
    /// [`Motion::Joint`].
    Joint,
}

impl Motion {
    /// Standing still.
    pub fn zero(kind: MotionKind) -> Self {
        match kind {
            MotionKind::Cartesian => Self::Cartesian(Twist::zeros()),
            MotionKind::Joint => Self::Joint(Joints::zeros()),
        }
    }

    /// Its kind.
    pub const fn kind(&self) -> MotionKind {
        match self {
            Self::Cartesian(_) => MotionKind::Cartesian,
            Self::Joint(_) => MotionKind::Joint,
        }
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Cartesian(twist) => twist.iter().all(|x| x.is_finite()),
            Self::Joint(dq) => dq.iter().all(|x| x.is_finite()),
        }
    }
}

/// A command message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Number of the state that it answers.
    pub id: u64,
    /// The commanded velocity, m/s and rad/s or rad/s for each joint.
    pub motion: Motion,
    /// Position of joint 3, the elbow, rad, in a Cartesian motion; `None`: as last told, at first
    /// where the motion began.
    pub elbow: Option<f64>,
    /// The last command of this motion. The next would be zero: a robot that still moves goes into
    /// reflex.
    pub finished: bool,
}

impl Command {
    /// Whether all numbers are finite.
    fn is_finite(&self) -> bool {
        self.motion.is_finite() && self.elbow.is_none_or(f64::is_finite)
    }
}

/// The outcome of a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reception {
    /// The command that answers the last state.
    Accepted(Command),
    /// None; the robot extrapolates.
    Lost,
    /// None, for the [`ABORT`]th time in a row.
    Aborted,
}

/// The robot's end of the link during one motion.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    kind: MotionKind,
    lost: u32,
    /// The last [`WINDOW`] receptions, newest in bit 0, accepted ones set.
    history: u128,
    received: u32,
}

impl Interface {
    /// A motion of this kind begins.
    pub const fn new(kind: MotionKind) -> Self {
        Self {
            kind,
            lost: 0,
            history: 0,
            received: 0,
        }
    }

    /// Judges the messages that `arrived` since the state with the number `expected` went out. Of
    /// several good ones the first counts. Numbers that are not finite and motions of another kind
    /// are dropped, where libfranka would not have let them out.
    pub fn receive(&mut self, expected: u64, arrived: &[Command]) -> Reception {
        let good = |c: &&Command| c.id == expected && c.motion.kind() == self.kind && c.is_finite();
        let accepted = arrived.iter().find(good).copied();
        self.history = self.history << 1 | u128::from(accepted.is_some());
        self.received = (self.received + 1).min(WINDOW);
        match accepted {
            Some(command) => {
                self.lost = 0;
                Reception::Accepted(command)
            }
            None => {
                self.lost += 1;
                if self.lost >= ABORT {
                    Reception::Aborted
                } else {
                    Reception::Lost
                }
            }
        }
    }

    /// Share of the last [`WINDOW`] commands that came in time, of those that there were so far; 0
    /// to 1.
    pub fn success_rate(&self) -> f64 {
        let mask = (1u128 << WINDOW) - 1;
        let successes = (self.history & mask).count_ones();
        f64::from(successes) / f64::from(self.received.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(id: u64) -> Command {
        Command {
            id,
            motion: Motion::Cartesian(Twist::zeros()),
            elbow: None,
            finished: false,
        }
    }

    #[test]
    fn a_command_counts_for_its_own_state_only() {
        let mut link = Interface::new(MotionKind::Cartesian);
        assert_eq!(link.receive(7, &[command(6)]), Reception::Lost);
        assert_eq!(link.receive(8, &[command(9)]), Reception::Lost);
        let late_and_good = [command(8), command(9)];
        assert_eq!(
            link.receive(9, &late_and_good),
            Reception::Accepted(command(9))
        );
    }

    #[test]
    fn nonsense_and_other_motions_are_not_commands() {
        let mut link = Interface::new(MotionKind::Cartesian);
        let mut wrong = command(1);
        wrong.motion = Motion::Cartesian(Twist::repeat(f64::NAN));
        assert_eq!(link.receive(1, &[wrong]), Reception::Lost);
        wrong.motion = Motion::Joint(Joints::zeros());
        assert_eq!(link.receive(1, &[wrong]), Reception::Lost);
    }

    #[test]
    fn nineteen_in_a_row_may_be_lost_but_not_twenty() {
        let mut link = Interface::new(MotionKind::Cartesian);
        for round in 0..3 {
            for _ in 0..19 {
                assert_eq!(link.receive(0, &[]), Reception::Lost);
            }
            let good = command(round);
            assert_eq!(link.receive(round, &[good]), Reception::Accepted(good));
        }
        for _ in 0..19 {
            assert_eq!(link.receive(0, &[]), Reception::Lost);
        }
        assert_eq!(link.receive(0, &[]), Reception::Aborted);
    }

    #[test]
    fn the_success_rate_is_that_of_the_last_hundred() {
        let mut link = Interface::new(MotionKind::Cartesian);
        link.receive(0, &[command(0)]);
        assert_eq!(link.success_rate(), 1.0);
        link.receive(0, &[]);
        assert_eq!(link.success_rate(), 0.5);
        for _ in 0..100 {
            link.receive(0, &[command(0)]);
        }
        assert_eq!(link.success_rate(), 1.0);
        for _ in 0..10 {
            link.receive(0, &[]);
        }
        assert_eq!(link.success_rate(), 0.9);
    }
}
