//! The command that stands, inside the limits.

/// A camera velocity (camera frame; m/s, rad/s) that holds until an instant; then the camera stands
/// still.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Standing {
    twist: [f64; 6],
    until_ns: u64,
    limited: bool,
}

impl Standing {
    /// A command cut to the limits; components that are not finite count as zero. Nothing is
    /// rescaled: a wrong command must show, not be mended.
    pub fn new(command: &[f64; 6], until_ns: u64, limits: &[f64; 6]) -> Self {
        let cut = |k: usize| command[k].clamp(-limits[k], limits[k]);
        let is_within = |k: usize| command[k].abs() <= limits[k] * (1.0 + 1e-9);
        Self {
            twist: std::array::from_fn(|k| if command[k].is_finite() { cut(k) } else { 0.0 }),
            until_ns,
            limited: !(0..6).all(is_within),
        }
    }

    /// The velocity while the command holds.
    pub fn twist(&self) -> [f64; 6] {
        self.twist
    }

    /// The velocity at an instant: zero where the command no longer holds.
    pub fn twist_at(&self, now_ns: u64) -> [f64; 6] {
        if self.is_stale(now_ns) {
            [0.0; 6]
        } else {
            self.twist
        }
    }

    /// When the command ends, ns.
    pub fn until_ns(&self) -> u64 {
        self.until_ns
    }

    /// Ends the command at an instant, if it held longer.
    pub fn end(&mut self, now_ns: u64) {
        self.until_ns = self.until_ns.min(now_ns);
    }

    /// Whether the command no longer holds.
    pub fn is_stale(&self, now_ns: u64) -> bool {
        now_ns >= self.until_ns
    }

    /// Whether the command was outside the limits and was cut.
    pub fn was_limited(&self) -> bool {
        self.limited
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_outside_the_limits_is_cut_and_said_so_and_ends() {
        let limits = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
        assert!(!Standing::new(&[0.5, -0.5, 0.0, 1.0, 0.0, 0.0], 10, &limits).was_limited());
        let cut = Standing::new(&[0.6, f64::NAN, 0.0, -3.0, 0.0, 0.0], 10, &limits);
        assert!(cut.was_limited());
        assert_eq!(cut.twist_at(9), [0.5, 0.0, 0.0, -1.0, 0.0, 0.0]);
        assert_eq!(cut.twist_at(10), [0.0; 6]);
    }
}
