//! Euclidean distances of image points from the occlusions: what a scene's `clearance_px` is
//! measured in.
//!
//! The control law has a first-order clearance, cheap and differentiable, which falls short of the
//! distance near the corners of a part: fit for a constraint, too strict for choosing starts.
//!
//! A part is a convex set, and the distance of a point q from a convex set is the greatest of n.q -
//! h(n) over unit normals n, where h, the support function, is the dual norm of the part's half
//! sizes (exponent p / (p - 1)). By symmetry n may be taken in the quadrant of q, so that one angle
//! is left. For a point outside the derivative over that angle changes its sign once: a second
//! stationary normal would make q a border point minus a multiple of that normal, and so a point
//! inside.

use scene::{Part, Scene};
use vpc::field;

/// Bound of the error of a distance, px.
const TOLERANCE: f64 = 1e-9;
/// Halvings and Newton steps together, at most; bisection alone reaches the last bit of the angle
/// within them.
const MAX_STEPS: usize = 60;

/// Least Euclidean distance of a pixel (u, v) from the occlusions of a scene, px: zero inside one,
/// infinite in a scene without any.
pub fn of_pixel(scene: &Scene, pixel: [f64; 2]) -> f64 {
    let parts = scene.parts().fold(f64::INFINITY, |least, part| {
        if distance_from_box(part, pixel) < least {
            least.min(distance(part, pixel))
        } else {
            least
        }
    });
    // The field of a mask is the Euclidean distance already, within 0.1 px where starts are
    // measured, and not above.
    scene.areas().fold(parts, |least, area| {
        least.min(field::clearance(area, pixel).distance.max(0.0))
    })
}

/// Euclidean distance of a pixel (u, v) from the area that a part covers, px: zero inside.
pub fn distance(part: &Part, pixel: [f64; 2]) -> f64 {
    if part.covers(pixel) {
        return 0.0;
    }
    let q = offset(part, pixel);
    let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
    let mut angle: f64 = 0.25 * std::f64::consts::PI;
    let mut distance: f64 = 0.0;
    for _ in 0..MAX_STEPS {
        let tangent = Tangent::at(part, angle);
        let (sin, cos) = angle.sin_cos();
        let (u, v) = (q[0] - tangent.touch[0], q[1] - tangent.touch[1]);
        let (across, along) = (u * cos + v * sin, v * cos - u * sin);
        // Any tangent bounds the distance from below, any border point from above.
        distance = distance.max(across);
        if u.hypot(v) - distance <= TOLERANCE {
            break;
        }
        if along > 0.0 {
            low = angle;
        } else {
            high = angle;
        }
        // Newton's step on the slope; not a number where the border has a corner, and then halving
        // takes over.
        let newton = angle + along / (across + tangent.radius);
        let third = (high - low) / 3.0;
        angle = if newton > low && newton < high && (newton - angle).abs() < third {
            newton
        } else {
            0.5 * (low + high)
        };
    }
    distance
}

/// The tangent of a part's border with a given direction of its normal.
struct Tangent {
    /// Where it touches, relative to the centre, px.
    touch: [f64; 2],
    /// Radius of curvature there, px.
    radius: f64,
}

impl Tangent {
    /// With the outward normal (cos, sin) of an angle in [0, pi/2].
    fn at(part: &Part, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        // Exponent of the dual norm, less one: infinite for a rhombus.
        let dual = 1.0 / (part.p - 1.0);
        let scaled = [part.half[0] * cos, part.half[1] * sin];
        let most = scaled[0].max(scaled[1]);
        let share = scaled.map(|x| (x / most).powf(dual + 1.0));
        let support = most * (share[0] + share[1]).powf(1.0 / (dual + 1.0));
        let touch: [f64; 2] =
            std::array::from_fn(|k| part.half[k] * (scaled[k] / support).powf(dual));
        let slope = (touch[1] * cos - touch[0] * sin) / support;
        let radius =
            dual * (touch[0] * sin * (sin / cos + slope) + touch[1] * cos * (cos / sin - slope));
        Self { touch, radius }
    }
}

/// Distance of a pixel from the bounding box of a part, px: never above the distance from the part.
fn distance_from_box(part: &Part, pixel: [f64; 2]) -> f64 {
    let [low, high] = part.bounds();
    let out = |k: usize| (low[k] - pixel[k]).max(pixel[k] - high[k]).max(0.0);
    out(0).hypot(out(1))
}

/// The pixel relative to the part's centre, mirrored into the quadrant u, v >= 0.
fn offset(part: &Part, pixel: [f64; 2]) -> [f64; 2] {
    std::array::from_fn(|k| (pixel[k] - part.center[k]).abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(half: [f64; 2], p: f64) -> Part {
        let center = [300.0, 200.0];
        Part { center, half, p }
    }

    /// Least distance from points set densely on the border, both by u and by v, so that no stretch
    /// is left thin.
    fn sampled(part: &Part, pixel: [f64; 2]) -> f64 {
        let q = offset(part, pixel);
        let other = |t: f64| (1.0 - t.powf(part.p)).max(0.0).powf(1.0 / part.p);
        (0..=40_000)
            .map(|i| f64::from(i) / 40_000.0)
            .flat_map(|t| [[t, other(t)], [other(t), t]])
            .map(|[u, v]| (part.half[0] * u - q[0]).hypot(part.half[1] * v - q[1]))
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn distances_are_those_from_the_densely_sampled_border() {
        let mut worst: f64 = 0.0;
        for p in [1.0, 1.05, 1.5, 2.0, 3.0, 8.0, 20.0, 64.0] {
            for half in [[75.0, 75.0], [150.0, 50.0], [10.0, 200.0]] {
                let part = part(half, p);
                for (k, out) in [0.001, 0.3, 5.0, 20.0, 400.0].into_iter().enumerate() {
                    for i in 0..10 {
                        // Beyond the border of the box, the axes and a corner among the places.
                        let turn = f64::from(i) / 9.0 * std::f64::consts::FRAC_PI_2;
                        let scale = if k % 2 == 0 { 1.0 } else { -1.0 };
                        let (sin, cos) = turn.sin_cos();
                        let radius = (cos.powf(p) + sin.powf(p)).powf(-1.0 / p);
                        let pixel = [
                            300.0 + scale * cos * (half[0] * radius + out),
                            200.0 - scale * sin * (half[1] * radius + out),
                        ];
                        let (found, expected) = (distance(&part, pixel), sampled(&part, pixel));
                        // Samples lie on the border, so they can only be too far: by half their
                        // spacing along the border for a point near it.
                        assert!(
                            found <= expected + 1e-8,
                            "{part:?} {pixel:?}: {found}, {expected}"
                        );
                        worst = worst.max(expected - found);
                    }
                }
            }
        }
        assert!(worst < 3e-3, "{worst}");
    }

    #[test]
    fn distances_from_a_circle_and_a_rhombus_are_known() {
        let circle = part([30.0, 30.0], 2.0);
        assert!((distance(&circle, [330.0, 240.0]) - 20.0).abs() < 1e-9);
        assert!((distance(&circle, [250.0, 200.0]) - 20.0).abs() < 1e-9);
        let rhombus = part([30.0, 40.0], 1.0);
        // Beside an edge, whose normal is (4, 3) / 5, and past the corners.
        assert!((distance(&rhombus, [300.0 + 15.0 + 8.0, 200.0 - 20.0 - 6.0]) - 10.0).abs() < 1e-9);
        assert!((distance(&rhombus, [345.0, 200.0]) - 15.0).abs() < 1e-9);
        assert!((distance(&rhombus, [300.0, 147.0]) - 13.0).abs() < 1e-9);
    }

    #[test]
    fn no_pixel_that_a_part_covers_has_a_distance() {
        let part = part([150.0, 50.0], 8.0);
        for pixel in [
            [300.0, 200.0],
            [449.0, 200.0],
            [300.0, 151.0],
            [430.0, 240.0],
        ] {
            assert_eq!(distance(&part, pixel), 0.0, "{pixel:?}");
        }
    }

    #[test]
    fn the_least_distance_is_that_of_the_nearest_part() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        for pixel in [
            [512.0, 512.0],
            [350.0, 400.0],
            [700.0, 800.0],
            [1000.0, 10.0],
        ] {
            let each = scene.parts().map(|part| distance(part, pixel));
            let nearest = each.fold(f64::INFINITY, f64::min);
            assert_eq!(of_pixel(&scene, pixel), nearest);
        }
    }

    #[test]
    fn the_clearance_of_the_law_is_never_above_the_distance() {
        let part = part([90.0, 35.0], 8.0);
        let mut gap: f64 = 0.0;
        for u in (150..450).step_by(7) {
            for v in (100..300).step_by(7) {
                let pixel = [f64::from(u), f64::from(v)];
                let first_order = vpc::obstacle::Obstacle::Part(&part)
                    .clearance(pixel)
                    .distance;
                let euclidean = distance(&part, pixel);
                if euclidean > 0.0 {
                    assert!(first_order <= euclidean + 1e-6, "{pixel:?}");
                    gap = gap.max(euclidean - first_order);
                }
            }
        }
        // Near the corners it falls far short: why there is this module.
        assert!(gap > 5.0, "{gap}");
    }
}
