//! From commands at 30 Hz to commands at 1 kHz that the robot accepts.
//!
//! A part of the bridge between law and robot. Each axis follows the last target along the fastest
//! ramp under bounds on acceleration and jerk. In every millisecond the ramp starts from what the
//! robot reports as its last command, so that a command which the robot lost and extrapolated
//! leaves no step.

use nalgebra::Vector3;
use thiserror::Error;

use crate::kinematics::{Twist, join, split};
use crate::limits::PERIOD;
use crate::ramp::Ramp;

/// The greatest speeds of a Panda's end effector, m/s and rad/s; an FR3 allows no less.
const FASTEST: [f64; 2] = [1.7, 2.5];

/// The least share of the ramps: without any there is no stop.
pub(crate) const LEAST: f64 = 0.01;

/// Bounds of the shaped commands, each axis for itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShaperSettings {
    /// Of vx, vy, vz: m/s^2 and m/s^3.
    pub linear: Ramp,
    /// Of wx, wy, wz: rad/s^2 and rad/s^3.
    pub angular: Ramp,
}

impl Default for ShaperSettings {
    /// From rest to the limits of the scene `paper-robot` within a frame, and within the joints'
    /// bounds with room: see the README.
    fn default() -> Self {
        Self {
            linear: Ramp {
                acceleration: 0.5,
                jerk: 100.0,
            },
            angular: Ramp {
                acceleration: 1.2,
                jerk: 200.0,
            },
        }
    }
}

/// A bound that is not a positive number.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("shaper: {key} = {value}; allowed: above 0")]
pub struct ShaperError {
    /// Name of the setting in [`ShaperSettings`].
    pub key: &'static str,
    /// Its value.
    pub value: f64,
}

/// The last command by the robot's own account; along base axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echo {
    /// O_dP_EE_c, m/s and rad/s.
    pub twist: Twist,
    /// O_ddP_EE_c, m/s^2 and rad/s^2.
    pub acceleration: Twist,
}

/// The shaper between the 30 Hz twist and the 1 kHz interface.
#[derive(Clone, Copy, Debug)]
pub struct Shaper {
    settings: ShaperSettings,
    target: Twist,
    valid_until_ns: u64,
}

impl Shaper {
    /// A shaper that aims at standing still.
    ///
    /// # Errors
    /// A bound that is not a positive number.
    pub fn new(settings: ShaperSettings) -> Result<Self, ShaperError> {
        let rows = [
            ("linear.acceleration", settings.linear.acceleration),
            ("linear.jerk", settings.linear.jerk),
            ("angular.acceleration", settings.angular.acceleration),
            ("angular.jerk", settings.angular.jerk),
        ];
        for (key, value) in rows {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ShaperError { key, value });
            }
        }
        Ok(Self {
            settings,
            target: Twist::zeros(),
            valid_until_ns: 0,
        })
    }

    /// Its bounds.
    pub fn settings(&self) -> &ShaperSettings {
        &self.settings
    }

    /// A new command: velocity of the end effector's origin along base axes, to hold until this
    /// instant. What is not finite means standing still; what the robot's own bounds forbid is
    /// shortened.
    pub fn aim(&mut self, twist: &Twist, valid_until_ns: u64) {
        self.target = if twist.iter().all(|x| x.is_finite()) {
            shortened(twist)
        } else {
            Twist::zeros()
        };
        self.valid_until_ns = valid_until_ns;
    }

    /// Whether the last command no longer holds at this instant.
    pub fn is_stale(&self, now_ns: u64) -> bool {
        now_ns >= self.valid_until_ns
    }

    /// The twist that answers the state with this echo. Where the command is stale, on the way to
    /// zero.
    pub fn step(&self, echo: &Echo, now_ns: u64) -> Twist {
        self.step_with(echo, 1.0, now_ns)
    }

    /// The same along this share of the ramps, at least a hundredth.
    pub fn step_with(&self, echo: &Echo, share: f64, now_ns: u64) -> Twist {
        // A NaN counts as none.
        let share = if share > LEAST { share.min(1.0) } else { LEAST };
        let stale = self.is_stale(now_ns);
        Twist::from_fn(|axis, _| {
            let ramp = if axis < 3 {
                &self.settings.linear
            } else {
                &self.settings.angular
            };
            let ramp = Ramp {
                acceleration: share * ramp.acceleration,
                jerk: share * ramp.jerk,
            };
            let target = if stale { 0.0 } else { self.target[axis] };
            let (velocity, acceleration) = (echo.twist[axis], echo.acceleration[axis]);
            ramp.step(velocity, acceleration, target, PERIOD).0
        })
    }
}

/// A twist as long as a Panda allows, its directions kept.
fn shortened(twist: &Twist) -> Twist {
    let (linear, angular) = split(twist);
    let shorten = |x: Vector3<f64>, most: f64| x * (most / x.norm().max(most));
    join(&shorten(linear, FASTEST[0]), &shorten(angular, FASTEST[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing() -> Echo {
        Echo {
            twist: Twist::zeros(),
            acceleration: Twist::zeros(),
        }
    }

    /// What the robot echoes when it accepted `twist`.
    fn accepted(echo: &Echo, twist: Twist) -> Echo {
        Echo {
            twist,
            acceleration: (twist - echo.twist) / PERIOD,
        }
    }

    fn shaper() -> Shaper {
        Shaper::new(ShaperSettings::default()).unwrap()
    }

    #[test]
    fn a_command_of_the_robot_scene_is_reached_within_a_frame() {
        let mut shaper = shaper();
        let target = Twist::new(0.01, -0.01, 0.005, 0.03, 0.0, -0.03);
        shaper.aim(&target, u64::MAX);
        let mut echo = standing();
        for _ in 0..33 {
            echo = accepted(&echo, shaper.step(&echo, 0));
        }
        assert!((echo.twist - target).norm() < 1e-12);
    }

    #[test]
    fn a_command_that_went_stale_ramps_to_zero_and_stays_there() {
        let mut shaper = shaper();
        shaper.aim(&Twist::repeat(0.01), 50_000_000);
        let mut echo = standing();
        for tick in 0..150 {
            let now = tick * 1_000_000;
            echo = accepted(&echo, shaper.step(&echo, now));
            if tick == 49 {
                assert!((echo.twist - Twist::repeat(0.01)).norm() < 1e-12);
            }
        }
        assert!(shaper.is_stale(50_000_000) && !shaper.is_stale(49_999_999));
        assert!(echo.twist.norm() < 1e-12);
    }

    #[test]
    fn a_ramp_goes_on_from_what_the_robot_substituted() {
        let mut shaper = shaper();
        shaper.aim(&Twist::repeat(0.01), u64::MAX);
        let mut echo = standing();
        for tick in 0..200 {
            let next = if (5..24).contains(&tick) {
                echo.twist + echo.acceleration * PERIOD
            } else {
                shaper.step(&echo, 0)
            };
            let after = accepted(&echo, next);
            let jerk = (after.acceleration - echo.acceleration) / PERIOD;
            let linear = jerk.fixed_rows::<3>(0).amax();
            assert!(linear < 100.0 * (1.0 + 1e-6), "{linear}");
            echo = after;
        }
        assert!((echo.twist - Twist::repeat(0.01)).norm() < 1e-12);
    }

    #[test]
    fn nonsense_means_standing_still_and_too_much_is_shortened() {
        let mut shaper = shaper();
        shaper.aim(&Twist::repeat(f64::NAN), u64::MAX);
        assert_eq!(shaper.step(&standing(), 0), Twist::zeros());
        shaper.aim(&Twist::new(30.0, 0.0, 40.0, 0.0, 0.0, 0.0), u64::MAX);
        assert!((shaper.target.norm() - 1.7).abs() < 1e-12);
    }

    #[test]
    fn no_share_of_the_ramps_keeps_it_from_a_stop() {
        let moving = Echo {
            twist: Twist::repeat(0.01),
            ..Echo::default()
        };
        for share in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1.0] {
            let next = shaper().step_with(&moving, share, 0);
            assert!(
                next.iter().all(|v| (0.0..0.01).contains(v)),
                "{share}: {next}"
            );
        }
    }

    #[test]
    fn a_bound_that_is_no_positive_number_is_refused_by_name() {
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut settings = ShaperSettings::default();
            settings.angular.jerk = value;
            let error = Shaper::new(settings).map(|_| ()).unwrap_err();
            assert_eq!(error.key, "angular.jerk");
        }
    }
}
