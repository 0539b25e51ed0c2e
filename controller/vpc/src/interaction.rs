//! The interaction matrix of an image point, and how it changes with the point.
//!
//! Source: paper, Eq. (model); F. Chaumette and S. Hutchinson, "Visual servo control, part I", Eq.
//! (11).

use crate::Twist;

/// Interaction matrix of a point in normalised image coordinates (x, y) at depth `z` (m): (x', y')
/// = L v.
pub fn of_point([x, y]: [f64; 2], z: f64) -> [Twist; 2] {
    [
        [-1.0 / z, 0.0, x / z, x * y, -(1.0 + x * x), y],
        [0.0, -1.0 / z, y / z, 1.0 + y * y, -x * y, -x],
    ]
}

/// Velocity (x', y') of a point under the camera velocity `v`, and its derivative with respect to
/// (x, y).
pub fn flow([x, y]: [f64; 2], z: f64, v: &Twist) -> ([f64; 2], [[f64; 2]; 2]) {
    let [vx, vy, vz, wx, wy, wz] = *v;
    let velocity = [
        (x * vz - vx) / z + x * y * wx - (1.0 + x * x) * wy + y * wz,
        (y * vz - vy) / z + (1.0 + y * y) * wx - x * y * wy - x * wz,
    ];
    let derivative = [
        [vz / z + y * wx - 2.0 * x * wy, x * wx + wz],
        [-y * wy - wz, vz / z + 2.0 * y * wx - x * wy],
    ];
    (velocity, derivative)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flow_and_its_derivative_match_the_matrix() {
        let (p, z, v) = ([0.2, -0.3], 0.7, [0.1, -0.2, 0.3, 0.4, -0.5, 0.6]);
        let (velocity, derivative) = flow(p, z, &v);
        for (row, value) in of_point(p, z).iter().zip(velocity) {
            let product: f64 = row.iter().zip(&v).map(|(l, v)| l * v).sum();
            assert!((product - value).abs() < 1e-15);
        }
        let h = 1e-6;
        for j in 0..2 {
            let (mut plus, mut minus) = (p, p);
            plus[j] += h;
            minus[j] -= h;
            for i in 0..2 {
                let numeric = (flow(plus, z, &v).0[i] - flow(minus, z, &v).0[i]) / (2.0 * h);
                assert!((numeric - derivative[i][j]).abs() < 1e-9);
            }
        }
    }
}
