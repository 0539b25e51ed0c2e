//! The dead man: which twist goes to the robot, and when. Pure.

use messages::{TwistCommand, TwistState};

use crate::arm::Command;

/// Between two twists that nobody commanded, ns.
const ZERO_PERIOD_NS: u64 = 20_000_000;
/// Where the scene has no limits of acceleration: time in which a command may go from a limit to
/// the opposite one, and in which it brakes from a limit, as vpcd does, s. The law of such a scene
/// turns at once, and passes occlusions closely: half as steep, starts took 8 % longer.
const RAMP_S: f64 = 0.15;
/// A twist changes from the last one by no more than fits into the time between them, which counts
/// as this at most, and as late by the other, as commands come a little irregularly; ns.
const MOST_STEP_NS: u64 = 40_000_000;
const LATE_NS: u64 = 5_000_000;

/// Decides what is sent. vpcd's commands go out once each, as they come, with what they allow at
/// that instant, and never jump: the twist changes by what the scene's limits of acceleration
/// allow, or from a limit to the opposite one in 0.15 s. When a command ends and none has followed,
/// it brakes, from the limits in 0.15 s, and zeros go out for a while; then silence, so that the
/// robot's own time-out acts, too.
///
/// At once to zero it goes for a stop, and where vpcd says that it stands: vpcd brakes by itself
/// where there is time.
#[derive(Clone, Debug)]
pub struct Outlet {
    zeros_ns: u64,
    /// The scene's limits of the camera's velocity, m/s and rad/s.
    limits: [f64; 6],
    /// Most change of each in a second, where it is commanded, and where it brakes.
    turns: [f64; 6],
    falls: [f64; 6],
    /// What was sent last, and when, ns.
    sent: [f64; 6],
    sent_ns: u64,
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
    /// its limit, m/s and rad/s, and changes by no more than `acceleration`, m/s^2 and rad/s^2.
    pub fn new(zeros_ns: u64, limits: [f64; 6], acceleration: [f64; 6]) -> Self {
        let within = |share: f64| {
            std::array::from_fn(|k| match acceleration[k].is_finite() {
                true => acceleration[k],
                false => share * limits[k] / RAMP_S,
            })
        };
        Self {
            turns: within(2.0),
            falls: within(1.0),
            sent: [0.0; 6],
            sent_ns: 0,
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
        let is_law = matches!(
            command.state(),
            Some(TwistState::Moving | TwistState::Arrived)
        );
        Some(match self.is_stopped || cut == [0.0; 6] && !is_law {
            true => self.stand(now_ns),
            false => self.ramped(cut, self.turns, now_ns),
        })
    }

    /// Zero, at once.
    pub fn stand(&mut self, now_ns: u64) -> [f64; 6] {
        (self.sent, self.sent_ns) = ([0.0; 6], now_ns);
        self.sent
    }

    /// The next twist on the way to zero.
    pub fn brake(&mut self, now_ns: u64) -> [f64; 6] {
        self.ramped([0.0; 6], self.falls, now_ns)
    }

    /// The next twist on the straight way from the last one to this.
    fn ramped(&mut self, to: [f64; 6], slopes: [f64; 6], now_ns: u64) -> [f64; 6] {
        let elapsed_ns = now_ns.saturating_sub(self.sent_ns).min(MOST_STEP_NS) + LATE_NS;
        let most = slopes.map(|slope| slope * 1e-9 * elapsed_ns as f64);
        let apart: [f64; 6] = std::array::from_fn(|k| to[k] - self.sent[k]);
        // Without a change 0 / 0 is no number, and no minimum.
        let each = std::iter::zip(apart, most).map(|(apart, most)| most / apart.abs());
        let share = each.fold(1.0, f64::min);
        self.sent = match share < 1.0 {
            true => std::array::from_fn(|k| self.sent[k] + share * apart[k]),
            false => to,
        };
        self.sent_ns = now_ns;
        self.sent
    }

    /// A command came that is refused: it is as none, and what was in force is so no longer.
    pub fn refuse(&mut self) {
        self.command = TwistCommand::default();
    }

    /// Looks at the clock: the twist that is due, which nobody commands.
    pub fn due(&mut self, now_ns: u64) -> Option<[f64; 6]> {
        if now_ns < self.command.in_force_until_ns() && !self.is_stopped {
            return None;
        }
        if self.was_in_force {
            self.was_in_force = false;
            self.zero_ns = now_ns;
            self.zeros_until_ns = now_ns + self.zeros_ns;
        }
        if now_ns < self.zero_ns || now_ns >= self.zeros_until_ns {
            return None;
        }
        self.zero_ns = now_ns + ZERO_PERIOD_NS;
        let twist = match self.is_stopped {
            true => self.stand(now_ns),
            false => self.brake(now_ns),
        };
        if twist != [0.0; 6] {
            // They follow when it stands.
            self.zeros_until_ns = now_ns + ZERO_PERIOD_NS + self.zeros_ns;
        }
        Some(twist)
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

    /// That changes as it is told.
    fn outlet() -> Outlet {
        Outlet::new(500 * MS, [1.0; 6], [1e9; 6])
    }

    #[test]
    fn each_command_goes_out_once_and_then_zeros_and_then_silence() {
        let mut outlet = outlet();
        assert_eq!(outlet.due(BEGIN), None);
        assert_eq!(outlet.command(BEGIN), Command::None);
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN), Some([0.1; 6]));
        let mut sent = Vec::new();
        for ms in 0..2000 {
            let now = BEGIN + ms * MS;
            if let Some(twist) = outlet.due(now) {
                assert_eq!(twist, [0.0; 6]);
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
        let mut outlet = outlet();
        // Of lockstep, and one that was under way for too long.
        let mut lockstep = command(BEGIN, 0.1);
        lockstep.valid_until_ns = u64::MAX;
        assert_eq!(outlet.take(&lockstep, BEGIN), None);
        assert_eq!(outlet.due(BEGIN), None);
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN + 100 * MS), None);
        // From the future: in force later, and zero now.
        let future = command(BEGIN + 50 * MS, 0.1);
        assert_eq!(outlet.take(&future, BEGIN), Some([0.0; 6]));
    }

    #[test]
    fn a_refused_command_ends_the_one_before() {
        let mut outlet = outlet();
        let now = ipc::now_ns();
        assert_eq!(outlet.take(&command(now, 0.1), now), Some([0.1; 6]));
        outlet.refuse();
        assert_eq!(outlet.due(now + MS), Some([0.0; 6]));
    }

    #[test]
    fn after_a_stop_only_zeros_go_out() {
        let mut outlet = outlet();
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN), Some([0.1; 6]));
        // At once, though a command is in force.
        outlet.stop(true);
        assert_eq!(outlet.due(BEGIN + MS), Some([0.0; 6]));
        assert_eq!(outlet.take(&command(BEGIN, 0.1), BEGIN), Some([0.0; 6]));
        outlet.stop(false);
        let now = BEGIN + 30 * MS;
        assert_eq!(outlet.take(&command(now, 0.1), now), Some([0.1; 6]));
    }

    #[test]
    fn a_twist_is_cut_to_the_limits_of_the_scene() {
        let mut outlet = Outlet::new(500 * MS, [0.5, 0.5, 0.5, 1.0, 1.0, 1.0], [1e9; 6]);
        let cut = [-0.5, -0.5, -0.5, -1.0, -1.0, -1.0];
        assert_eq!(outlet.take(&command(BEGIN, -50.0), BEGIN), Some(cut));
        assert_eq!(outlet.command(BEGIN), Command::Limited);
        assert_eq!(outlet.take(&command(BEGIN, 0.4), BEGIN), Some([0.4; 6]));
        assert_eq!(outlet.command(BEGIN), Command::InForce);
    }

    /// The largest change of two twists that follow each other.
    fn jump(sent: &[f64]) -> f64 {
        let pairs = sent.iter().zip(&sent[1..]);
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn twists_change_in_steps_and_stop_at_once() {
        // From limit to limit in 0.15 s: at most 45 ms of it at a time.
        let mut outlet = Outlet::new(500 * MS, [1.0; 6], [f64::INFINITY; 6]);
        let mut sent = vec![0.0];
        let mut now = BEGIN;
        for wanted in [1.0, -1.0] {
            for _ in 0..14 {
                now += 30 * MS;
                sent.push(outlet.take(&command(now, wanted), now).unwrap()[0]);
            }
            assert_eq!(sent.last(), Some(&wanted));
        }
        assert!(jump(&sent) < 2.0 * 0.045 / 0.15 + 1e-6, "{sent:?}");
        // It ends, at full speed: it stands within 0.15 s, and zeros follow for half a second.
        let mut fall = vec![-1.0];
        for ms in 0..2000 {
            let twist = outlet.due(now + ms * MS);
            fall.extend(twist.map(|twist| twist[0]));
            if ms == 250 {
                assert_eq!(fall.last(), Some(&0.0));
            }
        }
        assert!(jump(&fall) < 0.045 / 0.15 + 1e-6, "{fall:?}");
        let zeros = fall.iter().filter(|twist| **twist == 0.0).count();
        assert!((25..=26).contains(&zeros), "{fall:?}");

        // By the scene's own limit; then a stop.
        let mut outlet = Outlet::new(500 * MS, [1.0; 6], [2.0; 6]);
        let twist = outlet.take(&command(BEGIN, 1.0), BEGIN).unwrap()[0];
        assert!((twist - 2.0 * 0.045).abs() < 1e-9, "{twist}");
        let mut stands = command(BEGIN, 0.0);
        stands.state = TwistState::Disarmed.code();
        assert_eq!(outlet.take(&stands, BEGIN), Some([0.0; 6]));
        outlet.take(&command(BEGIN, 1.0), BEGIN).unwrap();
        outlet.stop(true);
        assert_eq!(outlet.due(BEGIN + MS), Some([0.0; 6]));
    }
}
