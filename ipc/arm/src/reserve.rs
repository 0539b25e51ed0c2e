//! What a bridge keeps of the joints' limits for itself, so that the robot never has to stop it.

use libm::sqrt;

use crate::bridge::Room;
use crate::ik::{elbow, held, inverse};
use crate::kinematics::{Chain, JOINTS, Joints, Twist};
use crate::limits::Limits;
use crate::shaper::ShaperSettings;
use crate::singularity;

/// Deceleration with which joints near the ends of their ranges, rad/s^2.
const DECELERATION: f64 = 0.5;

/// Rate at which a joint may use up what is left of its margin, 1/s, so that it never reaches its
/// end: a motion along the margin is curved, and is not stopped for that.
const CREEP: f64 = 0.03;

/// Distances and speeds that a bridge keeps to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reserve {
    /// Distance that joints keep from the ends of their ranges, rad.
    pub margin: f64,
    /// Greatest share of a joint's speed limit, 0 to 1.
    pub speed: f64,
}

impl Reserve {
    /// How much of a motion of the end effector (base axes), and of its ramps, the joints at `q`,
    /// rad, allow: by the ends of their ranges, their speeds, and the nearness to a singularity.
    pub fn room(
        &self,
        chain: &Chain,
        limits: &Limits,
        shaper: &ShaperSettings,
        q: &Joints,
        twist: &Twist,
    ) -> Room {
        let jacobian = chain.jacobian(q);
        let inverse = inverse(&jacobian);
        let dq = held(&inverse, &elbow(&inverse, &jacobian)) * twist;
        let clear = singularity::share(chain, limits, shaper, q, &dq);
        Room {
            joints: clear.min(self.share(limits, q, &dq)),
            ramps: singularity::ramps(singularity::strain(chain, limits, shaper, q)),
            ..Room::FULL
        }
    }

    /// How much of the joint velocities `dq`, rad/s, at `q`, rad, it allows; 0 to 1. A joint may
    /// always move away from the end of its range.
    pub fn share(&self, limits: &Limits, q: &Joints, dq: &Joints) -> f64 {
        let share = |k: usize| {
            let joint = &limits.0[k];
            let towards = usize::from(dq[k] > 0.0);
            let room = joint.room(q[k])[towards];
            let fastest = self.speed * joint.speeds(q[k])[towards];
            let near = nearing(room - self.margin, DECELERATION).max(CREEP * room);
            part(dq[k], near.min(fastest))
        };
        (0..JOINTS).map(share).fold(1.0, f64::min)
    }
}

/// The greatest speed from which `room` is enough to come to rest; units of the two.
pub fn nearing(room: f64, deceleration: f64) -> f64 {
    sqrt(2.0 * deceleration * room.max(0.0))
}

/// The part of this speed that is allowed, 0 to 1.
pub fn part(speed: f64, allowed: f64) -> f64 {
    match speed.abs() > allowed {
        true => allowed / speed.abs(),
        false => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Model;

    const RESERVE: Reserve = Reserve {
        margin: 0.15,
        speed: 0.3,
    };

    /// The share that a velocity of joint 4 (index 3) has at a distance from its upper end.
    fn share(model: Model, distance: f64, dq: f64) -> f64 {
        let limits = model.limits();
        let mut q = Joints::from(crate::READY);
        q[3] = limits.0[3].range[1] - distance;
        let mut velocities = Joints::zeros();
        velocities[3] = dq;
        RESERVE.share(limits, &q, &velocities)
    }

    #[test]
    fn a_joint_slows_down_towards_its_margin_and_leaves_it_freely() {
        for model in [Model::Panda, Model::Fr3] {
            for room in [0.15, 0.10, 0.07] {
                assert!((share(model, room, 0.1) - CREEP * room / 0.1).abs() < 1e-12);
            }
            assert_eq!(share(model, 0.0, 0.1), 0.0);
            assert_eq!(share(model, -0.01, 0.1), 0.0);
            assert_eq!(share(model, 0.10, -0.1), 1.0);
            let speed = 0.5 * share(model, 0.15 + 0.01, 0.5);
            assert!(
                (speed - (2.0 * DECELERATION * 0.01f64).sqrt()).abs() < 1e-9,
                "{speed}"
            );
        }
    }

    #[test]
    fn a_joint_takes_its_share_of_its_speed_limit() {
        let most = RESERVE.speed * Model::Panda.limits().0[3].velocity;
        assert!((2.0 * share(Model::Panda, 1.5, 2.0) - most).abs() < 1e-12);
        assert_eq!(share(Model::Panda, 1.5, most), 1.0);
    }
}
