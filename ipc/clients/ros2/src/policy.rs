//! From what another program wants of the camera to `vpc/desired`. Pure.

use messages::DesiredTwist;
use nalgebra::UnitQuaternion;

use crate::config::Config;
use crate::frames::Frames;
use crate::message::TwistStamped;
use crate::refusal::Refusal;
use crate::stamp::{Clocks, Order};

/// Makes wanted twists.
#[derive(Clone, Debug)]
pub struct Policy {
    frames: Frames,
    valid_ns: u64,
    order: Order,
}

impl Policy {
    /// That has heard nothing yet.
    pub fn new(config: &Config) -> Self {
        Self {
            frames: Frames::new(config),
            valid_ns: config.valid_ns,
            order: Order::default(),
        }
    }

    /// What is wanted, from the stamp on; `base_from_tool` is the tool's rotation, which only the
    /// base's frame needs.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn wish(
        &mut self,
        message: &TwistStamped,
        clocks: &Clocks,
        now_ns: u64,
        base_from_tool: Option<&UnitQuaternion<f64>>,
    ) -> Result<DesiredTwist, Refusal> {
        let twist = self.frames.told(message, base_from_tool)?;
        let instant = clocks.instant(&message.header.stamp, 0, now_ns)?;
        self.order.after(instant)?;
        let mut desired = DesiredTwist::until(twist, instant.saturating_add(self.valid_ns));
        desired.stamp.data_ns = instant;
        Ok(desired)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::of_keys;
    use crate::message::{Header, Twist};
    use crate::stamp::wall;

    const NOW: u64 = 10_000_000_000;
    const MS: u64 = 1_000_000;

    #[test]
    fn a_wish_counts_from_its_stamp_in_the_frame_of_the_camera() {
        let keys = "[policy]\ndesired = \"/wish\"\nvalid_ms = 150\n\
                    [mount]\ntranslation = [0.1, 0, 0]\nrotation_deg = [0, 0, 90]";
        let mut policy = Policy::new(&of_keys(keys));
        let clocks = Clocks::new(0, 200 * MS);
        let mut wish = |frame: &str, at_ns: u64, twist: [f64; 6]| {
            let message = TwistStamped {
                header: Header {
                    stamp: wall(at_ns, 0),
                    frame_id: frame.to_owned(),
                },
                twist: Twist::from_array(twist),
            };
            policy.wish(&message, &clocks, NOW, None)
        };
        let along_x = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
        let desired = wish("camera_optical_frame", NOW - 20 * MS, along_x).unwrap();
        let times = (desired.stamp.data_ns, desired.valid_until_ns);
        assert_eq!(times, (NOW - 20 * MS, NOW + 130 * MS));
        assert_eq!(desired.twist, along_x);
        // The camera is turned on the tool: the tool's x is against its y.
        let twist = wish("tool0", NOW, along_x).unwrap().twist;
        assert!(
            (twist[1] + 0.1).abs() < 1e-12 && twist[0].abs() < 1e-12,
            "{twist:?}"
        );
        let mut refused = |frame, at_ns, vx| {
            let twist = [vx, 0.0, 0.0, 0.0, 0.0, 0.0];
            wish(frame, at_ns, twist).unwrap_err().kind()
        };
        assert_eq!(refused("tool0", NOW, 0.1), "out of order");
        assert_eq!(refused("tool0", NOW - 201 * MS, 0.1), "stamp too old");
        assert_eq!(refused("world", NOW, 0.1), "other frame_id");
        assert_eq!(refused("base_link", NOW, 0.1), "pose missing");
        assert_eq!(refused("tool0", NOW, f64::NAN), "bad number");
    }
}
