//! Euclidean distances between image points and occlusions, for the referee.

use scene::{Name, Occlusion, Part};

use crate::painted::Painted;

/// Samples of the parameter in which the closest border point is first looked for.
const SAMPLES: usize = 64;
/// Golden-section steps that then refine it.
const REFINEMENTS: usize = 40;

/// Whether a pixel lies inside a part.
pub fn covers(part: &Part, pixel: [f64; 2]) -> bool {
    let term = |k: usize| ((pixel[k] - part.center[k]).abs() / part.half[k]).powf(part.p);
    term(0) + term(1) < 1.0
}

/// Euclidean distance from a pixel to the border of a part, px, never negative.
///
/// By symmetry the closest border point lies in the pixel's quadrant. The border is taken by its
/// direction from the centre, theta in [0, pi/2], at the radius ((cos/h_u)^p + (sin/h_v)^p)^(-1/p):
/// sampled, then refined about the best.
pub fn border_distance(part: &Part, pixel: [f64; 2]) -> f64 {
    let offset = [
        (pixel[0] - part.center[0]).abs(),
        (pixel[1] - part.center[1]).abs(),
    ];
    let distance = |theta: f64| {
        // Equal steps in the direction of the scaled part, so that slender parts are sampled as
        // densely.
        let (u, v) = (theta.cos(), theta.sin());
        let radius = (u.powf(part.p) + v.powf(part.p)).powf(-1.0 / part.p);
        (part.half[0] * radius * u - offset[0]).hypot(part.half[1] * radius * v - offset[1])
    };
    let parameter = |i: usize| std::f64::consts::FRAC_PI_2 * i as f64 / SAMPLES as f64;
    let best = (0..=SAMPLES)
        .min_by(|&a, &b| distance(parameter(a)).total_cmp(&distance(parameter(b))))
        .unwrap_or(0);
    let mut low = parameter(best.saturating_sub(1));
    let mut high = parameter((best + 1).min(SAMPLES));
    let ratio = 0.618_033_988_749_894_9;
    for _ in 0..REFINEMENTS {
        let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
        if distance(a) < distance(b) {
            high = b
        } else {
            low = a
        }
    }
    distance(0.5 * (low + high)).min(distance(parameter(best)))
}

/// Signed Euclidean distance of a pixel from a part, px: negative inside.
pub fn signed_distance(part: &Part, pixel: [f64; 2]) -> f64 {
    let distance = border_distance(part, pixel);
    if covers(part, pixel) {
        -distance
    } else {
        distance
    }
}

/// An occlusion, prepared for distances.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Its name.
    pub name: Name,
    parts: Vec<Part>,
    painted: Option<Painted>,
}

impl Shape {
    /// Prepares an occlusion: a mask takes a few milliseconds for a megapixel.
    pub fn new(occlusion: &Occlusion) -> Self {
        Self {
            name: occlusion.name.clone(),
            parts: occlusion.parts.to_vec(),
            painted: occlusion.mask.as_ref().map(Painted::new),
        }
    }

    /// Whether a pixel lies inside.
    pub fn covers(&self, pixel: [f64; 2]) -> bool {
        let is_on_mask = |painted: &Painted| painted.covers(pixel);
        self.parts.iter().any(|part| covers(part, pixel))
            || self.painted.as_ref().is_some_and(is_on_mask)
    }

    /// Signed distance of a pixel, px, where it is below `bound`; else some number at or above it.
    /// Outside the union it is exact. Inside, the depth is that of the deepest part that covers the
    /// pixel: a lower bound of the way out of the union, exact where parts do not overlap.
    pub fn distance_below(&self, pixel: [f64; 2], bound: f64) -> f64 {
        let parts = self.parts.iter().fold(bound, |least, part| {
            if box_distance(part, pixel) < least {
                least.min(signed_distance(part, pixel))
            } else {
                least
            }
        });
        match &self.painted {
            Some(painted) => parts.min(painted.distance_below(pixel, parts)),
            None => parts,
        }
    }
}

/// A lower bound of the signed distance of a pixel from a part, px: that from its bounding box, and
/// none inside it.
fn box_distance(part: &Part, pixel: [f64; 2]) -> f64 {
    let gap = |k: usize| ((pixel[k] - part.center[k]).abs() - part.half[k]).max(0.0);
    let inside = gap(0) == 0.0 && gap(1) == 0.0;
    if inside {
        f64::NEG_INFINITY
    } else {
        gap(0).hypot(gap(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_a_circle_are_exact() {
        let circle = Part {
            center: [100.0, 50.0],
            half: [30.0, 30.0],
            p: 2.0,
        };
        for (pixel, expected) in [
            ([150.0, 50.0], 20.0),
            ([100.0, 60.0], -20.0),
            ([130.0, 90.0], 20.0),
            ([100.0, 50.0], -30.0),
        ] {
            assert!((signed_distance(&circle, pixel) - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn distances_to_a_rectangle_match_its_sampled_border() {
        let part = Part {
            center: [0.0, 0.0],
            half: [150.0, 50.0],
            p: 8.0,
        };
        // By u where the border is flat, by v where it is steep.
        let other = |share: f64| (1.0 - share.powi(8)).powf(0.125);
        let border: Vec<[f64; 2]> = (0..200_000)
            .map(|i| f64::from(i) / 200_000.0)
            .flat_map(|t| [[150.0 * t, 50.0 * other(t)], [150.0 * other(t), 50.0 * t]])
            .collect();
        for pixel in [
            [0.0, 20.0],
            [160.0, 10.0],
            [148.0, 44.0],
            [100.0, 70.0],
            [170.0, 80.0],
            [10.0, 0.0],
        ] {
            let sampled = border
                .iter()
                .map(|b| (b[0] - pixel[0]).hypot(b[1] - pixel[1]))
                .fold(f64::INFINITY, f64::min);
            assert!(
                (border_distance(&part, pixel) - sampled).abs() < 0.05,
                "{pixel:?}"
            );
        }
    }
}
