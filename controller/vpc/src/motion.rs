//! Rigid motion of what a moving camera sees: the exponential of SE(3) and its left Jacobian.
//!
//! Under a constant camera velocity v = (nu, omega), in the camera frame, a fixed point X (camera
//! frame) moves by X' = -nu - omega x X. After the time t it is at exp(tau) X with tau = -t (nu,
//! omega).
//!
//! Source: T. Barfoot, "State Estimation for Robotics", Sect. 7.1 (left Jacobian and its block Q).

use libm::{cos, sin, sqrt};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::{DOF, Twist};

/// A rigid motion over one sampling time.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Rotation R.
    pub rotation: Matrix3<f64>,
    /// Translation t, m.
    pub translation: Vector3<f64>,
}

impl Motion {
    /// No motion.
    pub const REST: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    /// The motion of a fixed point in the camera frame while the camera moves at `v` for `ts`
    /// seconds.
    pub fn of_camera(v: &Twist, ts: f64) -> Self {
        let (rho, phi) = exponent(v, ts);
        let series = Coefficients::at(phi.norm_squared());
        let f = phi.cross_matrix();
        let ff = f * f;
        let jacobian = Matrix3::identity() + f * series.versine + ff * series.sine_gap;
        Self {
            rotation: Matrix3::identity() + f * series.sine + ff * series.versine,
            translation: jacobian * rho,
        }
    }

    /// Where the point `x` (camera frame, m) is after the motion.
    pub fn apply(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * x + self.translation
    }

    /// This motion and then another one.
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rotation: next.rotation * self.rotation,
            translation: next.apply(&self.translation),
        }
    }

    /// The motion back.
    pub fn inverse(&self) -> Self {
        let back = self.rotation.transpose();
        Self {
            rotation: back,
            translation: -(back * self.translation),
        }
    }

    /// How a small motion before this one acts after it: exp(Ad tau) M = M exp(tau).
    pub fn adjoint(&self) -> Matrix6<f64> {
        let mut adjoint = Matrix6::zeros();
        adjoint
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.rotation);
        adjoint
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&self.rotation);
        let mixed = self.translation.cross_matrix() * self.rotation;
        adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed);
        adjoint
    }

    /// tau of the motion, which is exp(tau); of a rotation by less than half a turn.
    pub fn logarithm(&self) -> Vector6<f64> {
        let r = &self.rotation;
        let twice = Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
        let (sine, cosine) = (0.5 * twice.norm(), 0.5 * (r.trace() - 1.0));
        let angle = libm::atan2(sine, cosine);
        let scale = if sine < 1e-9 { 0.5 } else { 0.5 * angle / sine };
        let phi = twice * scale;
        let square = angle * angle;
        // (1 - (angle / 2) cot(angle / 2)) / angle^2
        let gap = match square < 1e-4 {
            true => 1.0 / 12.0 + square / 720.0,
            false => (1.0 - 0.5 * angle * sin(angle) / (1.0 - cos(angle))) / square,
        };
        let f = phi.cross_matrix();
        let rho = self.translation - f * self.translation * 0.5 + f * f * self.translation * gap;
        Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
    }

    /// The twist of something that moves at `twist` (camera frame), in the frame after the motion.
    pub fn carry(&self, twist: &Twist) -> Twist {
        if *twist == [0.0; DOF] {
            return *twist;
        }
        let [vx, vy, vz, wx, wy, wz] = *twist;
        let turning = self.rotation * Vector3::new(wx, wy, wz);
        let velocity = self.rotation * Vector3::new(vx, vy, vz) + self.translation.cross(&turning);
        let ([vx, vy, vz], [wx, wy, wz]) = (velocity.into(), turning.into());
        [vx, vy, vz, wx, wy, wz]
    }
}

/// A motion of the pattern by itself, in the camera frame. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Own {
    /// Its twist, m/s and rad/s.
    pub twist: Twist,
    /// Rate of its twist, m/s^2 and rad/s^2.
    pub rate: Twist,
}

impl Own {
    /// Rest.
    pub const NONE: Self = Self {
        twist: [0.0; DOF],
        rate: [0.0; DOF],
    };

    /// Whether the pattern rests.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// The same after some time, in the same frame.
    pub fn after(mut self, seconds: f64) -> Self {
        let pairs = self.twist.iter_mut().zip(self.rate);
        pairs.for_each(|(v, rate)| *v += seconds * rate);
        self
    }

    /// The same in the frame of a camera after a motion of it.
    pub fn carried(&self, motion: &Motion) -> Self {
        if self.is_none() {
            return *self;
        }
        Self {
            twist: motion.carry(&self.twist),
            rate: motion.carry(&self.rate),
        }
    }
}

/// How a motion changes with the camera velocity: the left Jacobian of SE(3), times -ts.
#[derive(Clone, Copy, Debug)]
pub struct Sensitivity {
    /// The diagonal block: the left Jacobian of SO(3), times -ts.
    linear: Matrix3<f64>,
    /// The block above it, times -ts.
    coupling: Matrix3<f64>,
}

impl Sensitivity {
    /// That of no motion in no time.
    pub const REST: Self = Self {
        linear: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        coupling: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// The sensitivity of [`Motion::of_camera`].
    pub fn of_camera(v: &Twist, ts: f64) -> Self {
        let (rho, phi) = exponent(v, ts);
        let series = Coefficients::at(phi.norm_squared());
        let (f, r) = (phi.cross_matrix(), rho.cross_matrix());
        let (ff, fr, rf) = (f * f, f * r, r * f);
        let frf = fr * f;
        let jacobian = Matrix3::identity() + f * series.versine + ff * series.sine_gap;
        let coupling = r * 0.5
            + (fr + rf + frf) * series.sine_gap
            + (f * fr + rf * f - frf * 3.0) * series.cosine_gap
            + (frf * f + f * frf) * series.mixed;
        Self {
            linear: jacobian * -ts,
            coupling: coupling * -ts,
        }
    }

    /// J, by which a change of the velocity acts after the motion: it becomes exp(J dv) M.
    pub fn square(&self) -> Matrix6<f64> {
        let mut square = Matrix6::zeros();
        square.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.linear);
        square.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.linear);
        square
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&self.coupling);
        square
    }

    /// Derivative of the moved point `moved` with respect to the camera velocity: 3 rows of (nu,
    /// omega).
    #[expect(
        clippy::indexing_slicing,
        reason = "from_fn gives indices inside the two 3 x 3 blocks"
    )]
    pub fn at(&self, moved: &Vector3<f64>) -> [Twist; 3] {
        // d(exp(tau) X) = [I, -[X']x] J_l d tau, and d tau = -ts d v.
        let angular = self.coupling - moved.cross_matrix() * self.linear;
        core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                if j < 3 {
                    self.linear[(i, j)]
                } else {
                    angular[(i, j - 3)]
                }
            })
        })
    }
}

/// tau = -ts v, its translation and its rotation.
fn exponent(v: &Twist, ts: f64) -> (Vector3<f64>, Vector3<f64>) {
    (
        Vector3::new(v[0], v[1], v[2]) * -ts,
        Vector3::new(v[3], v[4], v[5]) * -ts,
    )
}

/// Coefficients of the exponential and of the left Jacobian at the angle theta.
struct Coefficients {
    /// sin(theta) / theta
    sine: f64,
    /// (1 - cos(theta)) / theta^2
    versine: f64,
    /// (theta - sin(theta)) / theta^3
    sine_gap: f64,
    /// (theta^2 + 2 cos(theta) - 2) / (2 theta^4)
    cosine_gap: f64,
    /// (2 theta - 3 sin(theta) + theta cos(theta)) / (2 theta^5)
    mixed: f64,
}

impl Coefficients {
    fn at(square: f64) -> Self {
        // Below 0.5 rad the closed forms lose digits to cancellation; six terms of the series are
        // exact to 1e-13.
        if square < 0.25 {
            let at = |terms: &[f64; TERMS]| terms.iter().rev().fold(0.0, |sum, c| sum * square + c);
            Self {
                sine: at(&const { series(1, false) }),
                versine: at(&const { series(2, false) }),
                sine_gap: at(&const { series(3, false) }),
                cosine_gap: at(&const { series(4, false) }),
                mixed: at(&const { series(5, true) }),
            }
        } else {
            let theta = sqrt(square);
            let (sin, cos) = (sin(theta), cos(theta));
            Self {
                sine: sin / theta,
                versine: (1.0 - cos) / square,
                sine_gap: (theta - sin) / (square * theta),
                cosine_gap: (square + 2.0 * cos - 2.0) / (2.0 * square * square),
                mixed: (2.0 * theta - 3.0 * sin + theta * cos) / (2.0 * square * square * theta),
            }
        }
    }
}

/// Terms of a series in theta^2.
const TERMS: usize = 6;

/// The coefficients (-1)^k / (2 k + n)!, each times k + 1 where `rising`.
#[expect(
    clippy::indexing_slicing,
    reason = "k is below TERMS; a const fn has no iterators"
)]
const fn series(n: usize, rising: bool) -> [f64; TERMS] {
    let mut coefficients = [0.0; TERMS];
    let mut k = 0;
    while k < TERMS {
        let (mut factorial, mut i) = (1.0, 2);
        while i <= 2 * k + n {
            factorial *= i as f64;
            i += 1;
        }
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        let share = if rising { (k + 1) as f64 } else { 1.0 };
        coefficients[k] = sign * (share / factorial);
        k += 1;
    }
    coefficients
}

/// The rotation matrix of a rotation vector (rad).
pub fn rotation(vector: [f64; 3]) -> Matrix3<f64> {
    let phi = Vector3::from(vector);
    let series = Coefficients::at(phi.norm_squared());
    let f = phi.cross_matrix();
    Matrix3::identity() + f * series.sine + f * f * series.versine
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_meets_the_closed_form() {
        let (below, above) = (
            Coefficients::at(0.25 - 1e-12),
            Coefficients::at(0.25 + 1e-12),
        );
        for (a, b) in [
            (below.sine, above.sine),
            (below.versine, above.versine),
            (below.sine_gap, above.sine_gap),
            (below.cosine_gap, above.cosine_gap),
            (below.mixed, above.mixed),
        ] {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }

    #[test]
    fn a_motion_solves_its_differential_equation() {
        let v = [0.3, -0.2, 0.4, 0.7, -0.9, 1.1];
        let (nu, omega) = (
            Vector3::new(v[0], v[1], v[2]),
            Vector3::new(v[3], v[4], v[5]),
        );
        let rate = |x: &Vector3<f64>| -nu - omega.cross(x);
        let mut x = Vector3::new(0.1, 0.2, 0.8);
        let expected = Motion::of_camera(&v, 0.8).apply(&x);
        let h = 0.8 / 2000.0;
        for _ in 0..2000 {
            let k1 = rate(&x);
            let k2 = rate(&(x + k1 * (h / 2.0)));
            let k3 = rate(&(x + k2 * (h / 2.0)));
            let k4 = rate(&(x + k3 * h));
            x += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0);
        }
        assert!((x - expected).norm() < 1e-12);
    }

    #[test]
    fn the_logarithm_undoes_the_exponential() {
        for size in [1e-9, 1e-3, 0.5, 2.0] {
            let tau = [0.3, -0.2, 0.4, 0.7, -0.9, 0.6].map(|x| size * x);
            let motion = Motion::of_camera(&tau.map(|tau| -tau), 1.0);
            let off = motion.logarithm() - Vector6::from(tau);
            assert!(off.amax() < 1e-12 + 1e-9 * size, "{size} {off}");
            assert!(motion.then(&motion.inverse()).logarithm().amax() < 1e-12);
        }
    }

    #[test]
    fn adjoint_and_sensitivity_tell_how_small_motions_act() {
        let v = [0.3, -0.2, 0.4, 0.7, -0.9, 1.1];
        let motion = Motion::of_camera(&v, 0.7);
        let small = [1e-6, -2e-6, 1e-6, 2e-6, 1e-6, -1e-6];
        let tau = Vector6::from(small);
        let exp = |tau: Vector6<f64>| Motion::of_camera(&(-tau).into(), 1.0);
        let before = exp(tau).then(&motion);
        let after = motion.then(&exp(motion.adjoint() * tau));
        assert!(before.inverse().then(&after).logarithm().amax() < 1e-10);
        let faster = core::array::from_fn(|k| v[k] + small[k]);
        let faster = Motion::of_camera(&faster, 0.7);
        let by = Sensitivity::of_camera(&v, 0.7).square() * tau;
        let off = motion.then(&exp(by)).inverse().then(&faster).logarithm();
        assert!(off.amax() < 1e-10, "{off}");
    }

    #[test]
    fn its_derivative_matches_finite_differences_small_and_large() {
        for ts in [1.0 / 30.0, 1.0] {
            let v = [0.3, -0.2, 0.4, 0.7, -0.9, 1.1];
            let x = Vector3::new(0.1, 0.2, 0.8);
            let moved = Motion::of_camera(&v, ts).apply(&x);
            let exact = Sensitivity::of_camera(&v, ts).at(&moved);
            for j in 0..6 {
                let h = 1e-6;
                let (mut plus, mut minus) = (v, v);
                plus[j] += h;
                minus[j] -= h;
                let numeric = (Motion::of_camera(&plus, ts).apply(&x)
                    - Motion::of_camera(&minus, ts).apply(&x))
                    / (2.0 * h);
                for i in 0..3 {
                    assert!((numeric[i] - exact[i][j]).abs() < 1e-9, "{i} {j}");
                }
            }
        }
    }
}
