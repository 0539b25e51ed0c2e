//! Euclidean distances between image points and occlusions, for the referee.

use scene::{Mask, Occlusion, Part};

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

/// Signed distance of a pixel from an occlusion, px, where it is below `bound`; else some number at
/// or above it. Outside the union it is exact. Inside, the depth is that of the deepest part that
/// covers the pixel: a lower bound of the way out of the union, exact where parts do not overlap.
pub fn distance_below(occlusion: &Occlusion, pixel: [f64; 2], bound: f64) -> f64 {
    let parts = occlusion.parts.iter().fold(bound, |least, part| {
        if box_distance(part, pixel) < least {
            least.min(signed_distance(part, pixel))
        } else {
            least
        }
    });
    match &occlusion.mask {
        Some(mask) => parts.min(mask_distance_below(mask, pixel, parts)),
        None => parts,
    }
}

/// Signed distance of a point from the white pixels of a mask, px, negative on one, where it is
/// below `bound`; else some number at or above it. Straight from the pixels: rings of them about
/// the point's own (for a point outside the image: about the nearest one), until no pixel of the
/// next ring can be nearer. What lies outside the image is neither forbidden nor a way out.
pub fn mask_distance_below(mask: &Mask, [u, v]: [f64; 2], bound: f64) -> f64 {
    let (width, height) = (mask.width() as i64, mask.height() as i64);
    // From the corner of the first pixel, whose centre is (0, 0): pixels begin at whole numbers.
    let (u, v) = (u + 0.5, v + 0.5);
    let own = [
        (u.floor() as i64).clamp(0, width - 1),
        (v.floor() as i64).clamp(0, height - 1),
    ];
    let is_white = |i: i64, j: i64| mask.is_forbidden(i as usize, j as usize);
    let on_white = is_white(own[0], own[1])
        && (0.0..=width as f64).contains(&u)
        && (0.0..=height as f64).contains(&v);
    // From a white pixel the way to a black one, without a bound: how deep is always told.
    let (mut nearest, wanted) = if on_white {
        (f64::INFINITY, false)
    } else {
        (bound, true)
    };
    let gap = |x: f64, k: i64| (k as f64 - x).max(x - (k + 1) as f64).max(0.0);
    for ring in 0..width.max(height) {
        // Every pixel of this ring is at least this far from the point.
        if (ring - 1) as f64 >= nearest {
            break;
        }
        let (left, right) = (own[0] - ring, own[0] + ring);
        for j in (own[1] - ring).max(0)..=(own[1] + ring).min(height - 1) {
            let whole = (j - own[1]).abs() == ring;
            let step = if whole { 1 } else { (2 * ring).max(1) };
            let mut i = left;
            while i <= right {
                if (0..width).contains(&i) && is_white(i, j) == wanted {
                    nearest = nearest.min(gap(u, i).hypot(gap(v, j)));
                }
                i += step;
            }
        }
    }
    if on_white { -nearest } else { nearest }
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

    fn painted(is_white: impl Fn(u32, u32) -> bool) -> Mask {
        let directory = tempfile::TempDir::new().unwrap();
        scene::write_mask(&directory.path().join("mask.png"), 1024, 1024, is_white).unwrap();
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
        let path = directory.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        let scene = scene::Scene::read(&path).unwrap();
        *scene.masks().next().unwrap()
    }

    #[test]
    fn distances_to_a_painted_rectangle_are_exact() {
        // White from (299.5, 199.5) to (399.5, 259.5).
        let mask = painted(|i, j| (300..400).contains(&i) && (200..260).contains(&j));
        for (point, expected) in [
            ([290.0, 229.8], 9.5),
            ([349.7, 264.5], 5.0),
            ([402.5, 263.5], 5.0),
            ([349.7, 245.2], -14.3),
            ([389.75, 228.5], -9.75),
            ([399.5, 229.5], 0.0),
            ([-30.5, 155.5], 44f64.hypot(330.0)),
        ] {
            let found = mask_distance_below(&mask, point, 1e4);
            assert!((found - expected).abs() < 1e-9, "{point:?}: {found}");
        }
        assert!(mask_distance_below(&mask, [290.0, 229.8], 5.0) >= 5.0);
        // A bound below tells a violation none the less.
        assert!((mask_distance_below(&mask, [349.7, 245.2], -10.0) + 14.3).abs() < 1e-9);
    }

    #[test]
    fn white_at_the_edge_of_the_image_offers_no_way_out_beyond_it() {
        let mask = painted(|i, _| i < 100);
        assert!((mask_distance_below(&mask, [2.5, 500.0], 1e4) + 97.0).abs() < 1e-9);
        assert!((mask_distance_below(&mask, [-4.5, 500.0], 1e4) - 4.0).abs() < 1e-9);
    }

    #[test]
    fn distances_to_a_near_rectangle_are_those_to_its_finely_sampled_border() {
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
