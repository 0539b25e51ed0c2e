//! The rule by which joint 3, the elbow, of an arm with seven joints turns while the camera goes
//! its own way: away from the ends of the joints' ranges, and from singular postures.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | s | [`elbow`](crate::ik::elbow) | joints' velocities: elbow at 1 rad/s, camera at rest |
//! | w | `rate` | velocity of the elbow, rad/s |
//! | c_k | `crowding` | how near joint k is to an end of its range, -1 to 1; positive: the lower |
//! | P | `PUSH` | velocity that an end asks for |
//! | e | `strain` | nearness to a singular posture |
//! | e_0, E | `STRAINED`, `EASE` | from where on it counts, and how much |
//!
//! w = s . (P c - E (e - e_0) grad e) / |s|^2, with e above e_0, and no faster than [`FASTEST`].
//! Along s a gradient counts as at most 1/rad.
//!
//! Source: A. Liegeois, "Automatic supervisory control of the configuration and behavior of
//! multibody mechanisms", IEEE SMC 7(12), 1977.

use nalgebra::RowSVector;

use crate::kinematics::{JOINTS, Joints};
use crate::limits::Limits;

/// Part of a joint's range, at each of its ends, that the elbow leaves if it can.
const ZONE: f64 = 0.25;
/// Velocity that an end asks for in its margin, rad/s.
const PUSH: f64 = 0.5;
/// The greatest velocity of the elbow, rad/s: a small share of any joint's.
pub const FASTEST: f64 = 0.3;
/// Strain from which the elbow evades a singular posture.
const STRAINED: f64 = 0.4;
/// Velocity that a unit of strain above this asks for per unit of its gradient, rad/s.
const EASE: f64 = 0.5;

/// The velocity of the elbow in these of the joints, rad/s.
pub(crate) fn along(free: &Joints, dq: &Joints) -> f64 {
    let square = free.norm_squared();
    match square > 1e-18 {
        true => dq.dot(free) / square,
        false => 0.0,
    }
}

/// The velocity of the elbow, rad/s; zero where these are not finite. `free` is s; `gradient` is
/// that of the strain by each joint, 1/rad.
pub(crate) fn rate(
    limits: &Limits,
    margin: f64,
    q: &Joints,
    free: &Joints,
    strain: f64,
    gradient: &RowSVector<f64, JOINTS>,
) -> f64 {
    let length = free.norm();
    if length < 1e-9 {
        return 0.0;
    }
    let along = free / length;
    let away = Joints::from_fn(|k, _| crowding(limits, margin, q, k));
    let excess = (strain - STRAINED).clamp(0.0, 1.0);
    let wanted = PUSH * along.dot(&away) - EASE * excess * (gradient * along)[0].clamp(-1.0, 1.0);
    match wanted.is_finite() {
        true => (wanted / length).clamp(-FASTEST, FASTEST),
        false => 0.0,
    }
}

/// How near a joint is to an end of its range, squared, signed away from it; zero but in the
/// [`ZONE`].
fn crowding(limits: &Limits, margin: f64, q: &Joints, k: usize) -> f64 {
    let room = limits.0[k].room(q[k]);
    let zone = ZONE * (room[0] + room[1] - 2.0 * margin);
    if !zone.is_finite() || zone <= 0.0 {
        return 0.0;
    }
    let near = room.map(|room| (1.0 - (room - margin) / zone).clamp(0.0, 1.0));
    near[0] * near[0] - near[1] * near[1]
}
