//! The rules of the supervisor and of the gate, from a scene and the settings of safety.

use messages::ClockMode;
use scene::Scene;
use serde::{Deserialize, Serialize};
use vpc::Settings;

/// The settings of safety.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Safety {
    /// Whether the controller starts armed.
    pub armed: bool,
    /// Time in which a twist at the limits is braked to zero, s.
    pub brake_s: f64,
    /// Longest time for which the law goes on while points are hidden, s.
    pub blind_s: f64,
    /// Time without usable features after which the camera is disarmed, s.
    pub lost_s: f64,
    /// Periods for which the last command may stand without new features; the camera brakes so
    /// early that it never stands longer.
    pub stale_periods: f64,
    /// Whether the camera stands still until a robot was heard.
    pub needs_robot: bool,
    /// What it does when it has arrived.
    pub after_arrival: AfterArrival,
}

impl Default for Safety {
    fn default() -> Self {
        Self {
            armed: false,
            brake_s: 0.15,
            blind_s: 1.0,
            lost_s: 0.3,
            stale_periods: 3.0,
            needs_robot: true,
            after_arrival: AfterArrival::Follow,
        }
    }
}

/// What the controller does from the cycle after its arrival on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum AfterArrival {
    /// It follows the pattern.
    #[default]
    Follow,
    /// It stands until an operator arms.
    Hold,
    /// It disarms.
    Disarm,
}

/// The rules of the supervisor and of the gate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rules {
    /// Largest magnitude of each component of the twist, m/s and rad/s.
    pub limits: [f64; 6],
    /// Greatest change of each from one cycle to the next; infinite without such a limit.
    pub change: [f64; 6],
    /// Time for which a command is valid without new features, ns; `None` in lockstep, where it is
    /// valid for ever.
    pub valid_ns: Option<u64>,
    /// Time in which a twist at the limits is braked to zero, ns; 0: as fast as the acceleration
    /// allows.
    pub brake_ns: u64,
    /// Time in which, after an arming or a brake, the law's twist is taken up from zero to the
    /// limits, ns; 0: at once.
    pub ramp_ns: u64,
    /// Time without usable features, or of standstill of the loop, or in which a robot that was
    /// heard is silent or does not follow, after which the camera is disarmed, ns; `None` in
    /// lockstep, where time does not pass.
    pub lost_ns: Option<u64>,
    /// Whether the camera stands still until a robot was heard.
    pub needs_robot: bool,
    /// Whether it begins armed.
    pub begins_armed: bool,
    /// What it does when it has arrived.
    pub after_arrival: AfterArrival,
}

impl Rules {
    /// The rules for this scene and law, under these settings of safety.
    pub fn new(scene: &Scene, settings: &Settings, safety: &Safety, clock: ClockMode) -> Self {
        let period_s = scene.sampling_time();
        let live = |value: u64| (clock != ClockMode::Lockstep).then_some(value);
        // Never before the command has gone stale and a brake has had time to begin.
        let least_lost_ns = ns((safety.stale_periods + 2.0) * period_s);
        let brake_ns = live(ns(safety.brake_s)).unwrap_or(0);
        let acceleration = settings.acceleration(&scene.limits);
        Self {
            limits: scene.limits.velocity(),
            change: acceleration.map(|a| a * period_s),
            valid_ns: live((safety.stale_periods * ns(period_s) as f64) as u64),
            brake_ns,
            // As steeply as it brakes.
            ramp_ns: brake_ns,
            lost_ns: live(ns(safety.lost_s).max(least_lost_ns)),
            needs_robot: safety.needs_robot,
            begins_armed: safety.armed,
            after_arrival: safety.after_arrival,
        }
    }

    /// Cycles that a stop from this twist takes at the greatest change; a share of one counts as
    /// that.
    pub fn stop_cycles(&self, twist: &[f64; 6]) -> f64 {
        let each = twist.iter().zip(self.change);
        each.map(|(v, most)| v.abs() / most).fold(0.0, f64::max)
    }
}

/// Nanoseconds of a time in s.
pub fn ns(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}
