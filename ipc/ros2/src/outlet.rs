//! The dead man: which twist goes to the robot, and when. Pure.

use ipc::{TwistCommand, TwistState};

use crate::arm::Command;

/// Between two zero twists that nobody commanded, ns.
const ZERO_PERIOD_NS: u64 = 20_000_000;

/// Decides what is sent. vpcd's commands go out once each, as they come, with what they allow at
/// that instant. When one ends and none has followed, zeros go out for a while; then silence, so
/// that the robot's own time-out acts, too.
#[derive(Clone, Debug)]
pub struct Outlet {
    zeros_ns: u64,
    /// The scene's limits of the camera's velocity, m/s and rad/s.
    limits: [f64; 6],
    command: TwistCommand,
    /// Whether it was beyond the limits.
    is_limited: bool,
    has_command: bool,
    /// Until when zeros follow, and when the next one is due, CLOCK_MONOTONIC, ns.
    zeros_until_ns: u64,
    zero_ns: u64,
    /// Whether the last command was in force when it was looked at last.
    was_in_force: bool,
    /// Somebody asked for a stop, or the program ends: nothing but zeros.
    is_stopped: bool,
}

impl Outlet {
    /// One that has sent nothing; zeros follow for so long, ns. Each component of a twist is cut to
    /// its limit, m/s and rad/s.
    pub fn new(zeros_ns: u64, limits: [f64; 6]) -> Self {
        Self {
            zeros_ns,
            limits,
            is_limited: false,
            command: TwistCommand::zero(TwistState::Stopped),
            has_command: false,
            zeros_until_ns: 0,
            zero_ns: 0,
            was_in_force: false,
            is_stopped: false,
        }
    }

    /// Nothing but zeros from now on, or no longer.
    pub fn stop(&mut self, is_stopped: bool) {
        self.is_stopped = is_stopped;
    }

    /// Takes a new command of vpcd; returns the twist of the camera to send.
    pub fn take(&mut self, command: &TwistCommand, now_ns: u64) -> Option<[f64; 6]> {
        self.command = *command;
        self.has_command = true;
        let is_in_force = now_ns < command.in_force_until_ns();
        if !is_in_force {
            // It ended under way: as one that ends later.
            return None;
        }
        self.was_in_force = true;
        let twist = command.in_force(now_ns);
        let cut = std::array::from_fn(|k| twist[k].clamp(-self.limits[k], self.limits[k]));
        self.is_limited = cut != twist;
        Some(if self.is_stopped { [0.0; 6] } else { cut })
    }

    /// A command came that is refused: it is as none, and what was in force is so no longer.
    pub fn refuse(&mut self) {
        let ended = TwistCommand::zero(TwistState::Stopped);
        self.command = ended.valid_for_ns(0);
    }

    /// Looks at the clock: whether a zero twist is due, which nobody commands.
    pub fn is_zero_due(&mut self, now_ns: u64) -> bool {
        if now_ns < self.command.in_force_until_ns() && !self.is_stopped {
            return false;
        }
        if self.was_in_force {
            self.was_in_force = false;
            self.zeros_until_ns = now_ns + self.zeros_ns;
            self.zero_ns = now_ns;
        }
        let is_due = (self.zero_ns..self.zeros_until_ns).contains(&now_ns);
        if is_due {
            self.zero_ns = now_ns + ZERO_PERIOD_NS;
        }
        is_due
    }

    /// What vpcd's command is at this instant.
    pub fn command(&self, now_ns: u64) -> Command {
        let is_in_force = now_ns < self.command.in_force_until_ns();
        match (self.has_command, is_in_force) {
            (false, _) => Command::None,
            (true, false) => Command::Stale,
            (true, true) if self.is_limited => Command::Limited,
            (true, true) => Command::InForce,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const BEGIN: u64 = 1_000_000 * MS;

    fn command(sent_ns: u64, twist: f64) -> TwistCommand {
        let mut command = TwistCommand::zero(TwistState::Moving);
        command.stamp.published_ns = sent_ns;
        command.valid_until_ns = sent_ns + 100 * MS;
        command.twist = [twist; 6];
        command
    }

    #[test]
    fn each_command_goes_out_once_and_then_zeros_and_then_silence() {
        let mut outlet = Outlet::new(500 * MS, [1.0; 6]);
        assert!(!outlet.is_zero_due(BEGIN));
        assert_eq!(outlet.command(BEGIN), Command::None);
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN), Some([0.1; 6]));
        let mut sent = Vec::new();
        for ms in 0..2000 {
            let now = BEGIN + ms * MS;
            if outlet.is_zero_due(now) {
                sent.push(ms);
            }
        }
        assert_eq!((sent[0], sent[1]), (100, 120));
        assert_eq!((sent.len(), sent.last()), (25, Some(&580)));
        assert_eq!(outlet.command(BEGIN + 99 * MS), Command::InForce);
        assert_eq!(outlet.command(BEGIN + 100 * MS), Command::Stale);
        // A new one ends the silence.
        let now = BEGIN + 3000 * MS;
        assert_eq!(outlet.take(&command(now, 0.2), now), Some([0.2; 6]));
    }

    #[test]
    fn what_robots_do_not_obey_is_not_passed_on() {
        let mut outlet = Outlet::new(500 * MS, [1.0; 6]);
        // Of lockstep, and one that was under way for too long.
        let mut lockstep = command(BEGIN, 0.1);
        lockstep.valid_until_ns = u64::MAX;
        assert_eq!(outlet.take(&lockstep, BEGIN), None);
        assert!(!outlet.is_zero_due(BEGIN));
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN + 100 * MS), None);
        // From the future: in force later, and zero now.
        let future = command(BEGIN + 50 * MS, 0.1);
        assert_eq!(outlet.take(&future, BEGIN), Some([0.0; 6]));
    }

    #[test]
    fn a_refused_command_ends_the_one_before() {
        let mut outlet = Outlet::new(500 * MS, [1.0; 6]);
        let now = ipc::now_ns();
        assert_eq!(outlet.take(&command(now, 0.1), now), Some([0.1; 6]));
        outlet.refuse();
        assert!(outlet.is_zero_due(now + MS));
    }

    #[test]
    fn after_a_stop_only_zeros_go_out() {
        let mut outlet = Outlet::new(500 * MS, [1.0; 6]);
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN), Some([0.1; 6]));
        // At once, though a command is in force.
        outlet.stop(true);
        assert!(outlet.is_zero_due(BEGIN + MS));
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN), Some([0.0; 6]));
        outlet.stop(false);
        let now = BEGIN + 30 * MS;
        assert_eq!(outlet.take(&command(now, 0.1), now), Some([0.1; 6]));
    }

    #[test]
    fn a_twist_is_cut_to_the_limits_of_the_scene() {
        let mut outlet = Outlet::new(500 * MS, [0.5, 0.5, 0.5, 1.0, 1.0, 1.0]);
        let cut = [-0.5, -0.5, -0.5, -1.0, -1.0, -1.0];
        assert_eq!(outlet.take(&command(BEGIN, -50.0), BEGIN), Some(cut));
        assert_eq!(outlet.command(BEGIN), Command::Limited);
        assert_eq!(outlet.take(&command(BEGIN, 0.4), BEGIN), Some([0.4; 6]));
        assert_eq!(outlet.command(BEGIN), Command::InForce);
    }
}
