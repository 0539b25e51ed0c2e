//! Nearness to a singularity, by what the shaper's ramps would ask of the joints there.

use crate::ik::square;
use crate::kinematics::{Chain, JOINTS, Joints};
use crate::limits::Limits;
use crate::shaper::{LEAST, ShaperSettings};

/// The most of a joint's acceleration and jerk that the ramps may take; the rest is for the
/// curvature of the way.
const MOST: f64 = 0.7;
/// Rate at which the rest may shrink, 1/s, as a share of it.
const RATE: f64 = 2.0;
/// Rate at which the nearness may grow all the same, 1/s, as a share of it, so that a singularity
/// is never reached: a motion along the bound is curved, and is not stopped for that.
const CREEP: f64 = 0.03;
/// Time over which it is foreseen, s.
const STEP: f64 = 1e-3;

/// The largest share of a joint's acceleration or jerk that the shaper's ramps may take at `q`, all
/// axes at once, by the inverse without damping: with it, the worst postures would seem good.
pub fn strain(chain: &Chain, limits: &Limits, shaper: &ShaperSettings, q: &Joints) -> f64 {
    let jacobian = chain.jacobian(q);
    let inverse = jacobian.transpose() * square(&jacobian).unwrap_or_default();
    let ramps = [shaper.linear, shaper.angular];
    let (mut accelerations, mut jerks) = (Joints::zeros(), Joints::zeros());
    for (axis, joints) in inverse.column_iter().enumerate() {
        accelerations += joints.abs() * ramps[axis / 3].acceleration;
        jerks += joints.abs() * ramps[axis / 3].jerk;
    }
    let share = |k: usize| {
        let joint = &limits.0[k];
        (accelerations[k] / joint.acceleration).max(jerks[k] / joint.jerk)
    };
    (0..JOINTS).map(share).fold(0.0, f64::max)
}

/// How much of the ramps the joints have room for where all of them would take this share of a
/// joint's acceleration; 0.01 to 1. All of them, except where they would take more than this module
/// leaves them.
pub fn ramps(strain: f64) -> f64 {
    match strain > MOST {
        true => (MOST / strain).max(LEAST),
        false => 1.0,
    }
}

/// How much of a motion, joint velocities `dq`, keeps the arm clear of its singularities, where the
/// shaper's ramps would take more than the joints may; 0 to 1. A motion out of one is never slowed.
/// Source of the form: A. Ames et al., "Control barrier functions: theory and applications", ECC
/// 2019.
pub fn share(
    chain: &Chain,
    limits: &Limits,
    shaper: &ShaperSettings,
    q: &Joints,
    dq: &Joints,
) -> f64 {
    let now = strain(chain, limits, shaper, q);
    let growth = (strain(chain, limits, shaper, &(q + dq * STEP)) - now) / STEP;
    let allowed = (RATE * (MOST - now)).max(CREEP * now);
    match growth > allowed {
        true => allowed / growth,
        false => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ik::inverse;
    use crate::kinematics::Twist;
    use crate::limits::Model;

    fn strained(q: [f64; 7]) -> f64 {
        let (limits, shaper) = (Model::Panda.limits(), ShaperSettings::default());
        strain(&Chain::FRANKA, limits, &shaper, &Joints::from(q))
    }

    #[test]
    fn an_arm_that_stretches_is_strained() {
        let all = [-1.82, -1.24, -1.0, -0.83].map(|elbow| {
            let bend = 0.5 * (elbow + 1.82);
            strained([0.3, -0.1 + bend, 0.0, elbow, -0.1, 1.6 - bend, 0.6])
        });
        assert!(strained(crate::READY) < 0.35);
        assert!(all.windows(2).all(|pair| pair[0] < pair[1]), "{all:?}");
        assert!(all[0] < 0.5 && all[3] > 1.0, "{all:?}");
    }

    #[test]
    fn the_way_into_a_singularity_slows_and_the_way_out_does_not() {
        let (chain, limits) = (Chain::FRANKA, Model::Panda.limits());
        let shaper = ShaperSettings::default();
        let up = Twist::z() * 0.1;
        let mut q = Joints::from(crate::READY);
        let mut now = strain(&chain, limits, &shaper, &q);
        for _ in 0..30_000 {
            let dq = inverse(&chain.jacobian(&q)) * up;
            q += dq * share(&chain, limits, &shaper, &q, &dq) * STEP;
            let next = strain(&chain, limits, &shaper, &q);
            assert!(next < MOST || next < now * (1.0 + 1.01 * CREEP * STEP));
            now = next;
        }
        assert!((1.0..3.0).contains(&now), "{now}");
        let dq = inverse(&chain.jacobian(&q)) * up;
        assert!(share(&chain, limits, &shaper, &q, &dq) < 0.05);
        assert_eq!(share(&chain, limits, &shaper, &q, &-dq), 1.0);
    }
}
