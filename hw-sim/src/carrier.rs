//! What carries a camera that is free to move: it executes a twist at once. An arm has its own, [`crate::robot`].

use scene::Limits;

/// Carries the camera.
#[derive(Clone, Debug)]
pub enum Carrier {
    /// The paper's hand-held camera: moves exactly as told, at once.
    FreeFlying(FreeFlying),
}

/// A camera free to move in space.
#[derive(Clone, Debug)]
pub struct FreeFlying {
    limits: Limits,
}

/// What a carrier makes of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Executed {
    /// The twist that moves the camera.
    pub twist: [f64; 6],
    /// Whether the command was outside the limits and was cut.
    pub limited: bool,
}

impl Carrier {
    /// A free-flying camera with these limits.
    pub fn free_flying(limits: Limits) -> Self {
        Self::FreeFlying(FreeFlying { limits })
    }

    /// The camera twist that follows from a commanded one.
    pub fn execute(&self, command: &[f64; 6]) -> Executed {
        match self {
            Self::FreeFlying(carrier) => carrier.execute(command),
        }
    }
}

impl FreeFlying {
    fn execute(&self, command: &[f64; 6]) -> Executed {
        cut(command, &self.limits)
    }
}

/// A command inside the limits, components that are not finite as zero.
pub fn cut(command: &[f64; 6], limits: &Limits) -> Executed {
    let limit = |k: usize| if k < 3 { limits.linear } else { limits.angular };
    let twist = std::array::from_fn(|k| {
        if command[k].is_finite() {
            command[k].clamp(-limit(k), limit(k))
        } else {
            0.0
        }
    });
    let within = |k: usize| command[k].abs() <= limit(k) * (1.0 + 1e-9);
    let limited = !(0..6).all(within);
    Executed { twist, limited }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_outside_the_limits_is_cut_and_said_so() {
        let carrier = Carrier::free_flying(Limits {
            linear: 0.5,
            angular: 1.0,
        });
        let inside = carrier.execute(&[0.5, -0.5, 0.0, 1.0, 0.0, 0.0]);
        assert!(!inside.limited);
        let cut = carrier.execute(&[0.6, f64::NAN, 0.0, -3.0, 0.0, 0.0]);
        assert_eq!(
            cut,
            Executed {
                twist: [0.5, 0.0, 0.0, -1.0, 0.0, 0.0],
                limited: true
            }
        );
    }
}
