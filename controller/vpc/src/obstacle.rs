//! An obstacle for a feature: a convex part of an occlusion, or a painted area.
//!
//! A part covers a convex area; the paper's "left of it OR right of it" is one inequality for the
//! scaled offset d from its centre, ||d||_p >= 1. An area of a mask has a signed distance of its
//! own, in [`crate::field`].
//!
//! Source: paper, Eq. (visibility_const_b).

use libm::{pow, sqrt};
use scene::{Area, Part};

use crate::clearance::Clearance;
use crate::field;

/// A part of an occlusion, or an area of a mask.
#[derive(Clone, Copy, Debug)]
pub enum Obstacle<'a> {
    /// Convex, a ball of a p-norm.
    Part(&'a Part),
    /// Of any shape, by its field of distances.
    Area(&'a Area),
}

impl Obstacle<'_> {
    /// The clearance of pixel (u, v).
    pub fn clearance(self, pixel: [f64; 2]) -> Clearance {
        match self {
            Self::Part(part) => clearance(part, pixel),
            Self::Area(area) => field::clearance(area, pixel),
        }
    }

    /// The least and the greatest (u, v) of the box that holds every point of negative clearance,
    /// px.
    pub fn bounding_box(self) -> [[f64; 2]; 2] {
        match self {
            Self::Part(Part {
                center: [u, v],
                half: [h, k],
                ..
            }) => [[u - h, v - k], [u + h, v + k]],
            Self::Area(area) => [area.low, area.high],
        }
    }

    /// How far a pixel lies outside that box (largest component), px: cheap, and never above the
    /// true distance; negative inside.
    pub fn outside_box(self, pixel: [f64; 2]) -> f64 {
        let [low, high] = self.bounding_box();
        let gap = |x: f64, low: f64, high: f64| (low - x).max(x - high);
        gap(pixel[0], low[0], high[0]).max(gap(pixel[1], low[1], high[1]))
    }

    /// What a clearance from it takes, [work](crate::work).
    pub(crate) fn price_ns(self) -> u32 {
        match self {
            Self::Part(part) => match Exponent::of(part.p) {
                Exponent::PowerOfTwo(_) => 4,
                Exponent::Any(_) => 140,
            },
            Self::Area(_) => 20,
        }
    }

    /// Whether a pixel lies inside.
    pub fn hides(self, pixel: [f64; 2]) -> bool {
        self.outside_box(pixel) < 0.0 && self.clearance(pixel).distance < 0.0
    }

    /// A cheap lower bound of the clearance of a pixel; none inside a part's bounding box.
    pub(crate) fn at_least(self, pixel: [f64; 2]) -> f64 {
        match self {
            Self::Part(part) => at_least(part, pixel),
            Self::Area(_) => self.outside_box(pixel),
        }
    }
}

/// The clearance of pixel (u, v) from a part: (||d||_p - 1) / |gradient|.
fn clearance(part: &Part, [u, v]: [f64; 2]) -> Clearance {
    let inverse = [1.0 / part.half[0], 1.0 / part.half[1]];
    let offset = [
        (u - part.center[0]) * inverse[0],
        (v - part.center[1]) * inverse[1],
    ];
    let size = [offset[0].abs(), offset[1].abs()];
    let largest = size[0].max(size[1]);
    if largest < 1e-9 {
        // The centre has no gradient: leave along the shorter half size.
        let [half_u, half_v] = part.half;
        let normal = if half_v < half_u {
            [0.0, 1.0]
        } else {
            [1.0, 0.0]
        };
        return Clearance {
            distance: -half_u.min(half_v),
            normal,
        };
    }
    // Scaled by the largest entry, no power overflows or vanishes.
    let exponent = Exponent::of(part.p);
    let scale = 1.0 / largest;
    let [(power_u, slope_u), (power_v, slope_v)] = size.map(|size| exponent.power(size * scale));
    let sum = power_u + power_v;
    let root = exponent.root(sum);
    let norm = largest * root;
    // d||d||_p / d offset_k = sign (|offset_k| / norm)^(p-1) = sign ratio_k^(p-1) / sum^((p-1)/p)
    let steep = root / sum;
    let gradient = [
        steep * slope_u * offset[0].signum() * inverse[0],
        steep * slope_v * offset[1].signum() * inverse[1],
    ];
    let flat = 1.0 / sqrt(gradient[0] * gradient[0] + gradient[1] * gradient[1]);
    Clearance {
        distance: (norm - 1.0) * flat,
        normal: [gradient[0] * flat, gradient[1] * flat],
    }
}

/// A cheap lower bound of the clearance of a pixel from a part; none inside the part's bounding
/// box. The p-norm is at least the largest entry of the offset, and no entry of its gradient by the
/// offset is above 1.
fn at_least(part: &Part, [u, v]: [f64; 2]) -> f64 {
    let largest =
        ((u - part.center[0]).abs() / part.half[0]).max((v - part.center[1]).abs() / part.half[1]);
    if largest <= 1.0 {
        return f64::NEG_INFINITY;
    }
    let short = part.half[0].min(part.half[1]);
    (largest - 1.0) * core::f64::consts::FRAC_1_SQRT_2 * short
}

/// The exponent p: for the powers of two that scenes use, powers cost only products and roots only
/// square roots.
#[derive(Clone, Copy)]
enum Exponent {
    PowerOfTwo(u32),
    Any(f64),
}

impl Exponent {
    fn of(p: f64) -> Self {
        const POWERS: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
        match POWERS.iter().position(|power| *power == p) {
            Some(squarings) => Self::PowerOfTwo(squarings as u32),
            None => Self::Any(p),
        }
    }

    /// x^p and x^(p-1) for x in [0, 1]; zeros at 0, the middle of the kink where p = 1.
    fn power(self, x: f64) -> (f64, f64) {
        match self {
            _ if x == 0.0 => (0.0, 0.0),
            Self::PowerOfTwo(squarings) => (0..squarings).fold((x, 1.0), |(square, below), _| {
                (square * square, below * square)
            }),
            Self::Any(p) => (pow(x, p), pow(x, p - 1.0)),
        }
    }

    /// x^(1/p).
    fn root(self, x: f64) -> f64 {
        match self {
            Self::PowerOfTwo(squarings) => (0..squarings).fold(x, |x, _| sqrt(x)),
            Self::Any(p) => pow(x, 1.0 / p),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(p: f64) -> Part {
        Part {
            center: [100.0, 50.0],
            half: [40.0, 20.0],
            p,
        }
    }

    fn norm(part: &Part, [u, v]: [f64; 2]) -> f64 {
        let d = [
            (u - part.center[0]).abs() / part.half[0],
            (v - part.center[1]).abs() / part.half[1],
        ];
        (d[0].powf(part.p) + d[1].powf(part.p)).powf(1.0 / part.p)
    }

    #[test]
    fn distance_and_normal_follow_from_the_p_norm() {
        for p in [1.0, 1.5, 2.0, 3.0, 8.0, 64.0] {
            let part = part(p);
            for pixel in [
                [150.0, 58.0],
                [120.0, 60.0],
                [90.0, 90.0],
                [61.0, 49.0],
                [100.0, 75.0],
            ] {
                let h = 1e-5;
                let slope = |du: f64, dv: f64| {
                    (norm(&part, [pixel[0] + du, pixel[1] + dv])
                        - norm(&part, [pixel[0] - du, pixel[1] - dv]))
                        / (2.0 * h)
                };
                let gradient = [slope(h, 0.0), slope(0.0, h)];
                let length = gradient[0].hypot(gradient[1]);
                let found = clearance(&part, pixel);
                assert!(((norm(&part, pixel) - 1.0) / length - found.distance).abs() < 1e-4);
                assert!((gradient[0] / length - found.normal[0]).abs() < 1e-5);
                assert!((gradient[1] / length - found.normal[1]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_straight_border_gives_the_euclidean_distance() {
        assert!((clearance(&part(8.0), [150.0, 50.0]).distance - 10.0).abs() < 1e-9);
        assert!((clearance(&part(8.0), [100.0, 25.0]).distance - 5.0).abs() < 1e-9);
        assert!((clearance(&part(2.0), [100.0, 60.0]).distance + 10.0).abs() < 1e-9);
    }

    #[test]
    fn the_cheap_bound_is_never_above_the_clearance() {
        for p in [1.0, 1.3, 2.0, 3.0, 8.0, 64.0] {
            let part = part(p);
            for i in 0..40 {
                for j in 0..40 {
                    let pixel = [f64::from(i) * 5.0, f64::from(j) * 3.0 - 10.0];
                    let exact = clearance(&part, pixel).distance;
                    assert!(at_least(&part, pixel) <= exact + 1e-9, "{p} {pixel:?}");
                }
            }
        }
    }

    #[test]
    fn the_centre_has_a_way_out() {
        let centre = clearance(&part(8.0), [100.0, 50.0]);
        assert_eq!((centre.distance, centre.normal), (-20.0, [0.0, 1.0]));
    }
}
