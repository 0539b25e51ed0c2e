//! One disc, measured from a seed pixel inside it: where it is, and whether all of it is seen.

use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

use crate::homography::{Point, distance};
use crate::image::Image;

/// Rays from the centre along which the rim is found.
const RAYS: usize = 48;
/// Cosine and sine of each ray's angle, and of twice the angle.
static DIRECTIONS: LazyLock<[[f64; 4]; RAYS]> = LazyLock::new(|| {
    std::array::from_fn(|ray| {
        let angle = TAU * ray as f64 / RAYS as f64;
        [
            angle.cos(),
            angle.sin(),
            (2.0 * angle).cos(),
            (2.0 * angle).sin(),
        ]
    })
});
/// How far outside the rim the background is taken, px.
const RING: f64 = 3.0;

/// Least contrast of a disc to its background, levels.
pub(crate) const CONTRAST: f64 = 50.0;
/// Greatest distance of the rim of a whole disc from an ellipse, px. Smaller refuses discs that are
/// barely touched by an occlusion, larger bears more noise.
const RIM_PX: f64 = 0.3;

/// A disc that is seen whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Disc {
    /// Centroid, px.
    pub center: Point,
    /// Mean radius, px.
    pub radius: f64,
    /// Level of the disc, and of the background about it.
    pub levels: [f64; 2],
}

/// An ellipse about a centre by 1 / r^2 = a + b cos 2t + c sin 2t.
#[derive(Clone, Copy)]
struct Shape {
    a: f64,
    b: f64,
    c: f64,
}

impl Shape {
    fn circle(radius: f64) -> Self {
        Self {
            a: 1.0 / (radius * radius),
            b: 0.0,
            c: 0.0,
        }
    }

    /// The best one through radii on evenly spaced rays.
    fn through(radii: &[f64; RAYS]) -> Self {
        let mut shape = Self {
            a: 0.0,
            b: 0.0,
            c: 0.0,
        };
        for (ray, radius) in radii.iter().enumerate() {
            let q = 1.0 / (radius * radius * RAYS as f64);
            let [_, _, cos, sin] = DIRECTIONS[ray];
            shape.a += q;
            shape.b += 2.0 * q * cos;
            shape.c += 2.0 * q * sin;
        }
        shape
    }

    fn radius(&self, ray: usize) -> f64 {
        let [_, _, cos, sin] = DIRECTIONS[ray];
        1.0 / (self.a + self.b * cos + self.c * sin).max(1e-9).sqrt()
    }

    /// (x/r)^2 of an offset: 1 on the rim.
    fn square(&self, x: f64, y: f64) -> f64 {
        (self.a + self.b) * x * x + (self.a - self.b) * y * y + 2.0 * self.c * x * y
    }

    /// Least and greatest half axis, px.
    fn axes(&self) -> [f64; 2] {
        let d = self.b.hypot(self.c);
        [(self.a + d).powf(-0.5), (self.a - d).max(1e-9).powf(-0.5)]
    }
}

/// The level on a ray from a centre.
fn on_ray(image: &Image, center: Point, ray: usize, radius: f64) -> Option<f64> {
    let [cos, sin, ..] = DIRECTIONS[ray];
    image.level(center[0] + radius * cos, center[1] + radius * sin)
}

/// Mean of 3 x 3 pixels.
fn smooth(image: &Image, [u, v]: Point) -> Option<f64> {
    let mut sum = 0.0;
    for k in 0..9 {
        sum += image.level(u + f64::from(k % 3) - 1.0, v + f64::from(k / 3) - 1.0)?;
    }
    Some(sum / 9.0)
}

/// The median of levels on every ray at a share of the shape's radius, and px beyond.
fn median(image: &Image, center: Point, shape: &Shape, share: f64, beyond: f64) -> Option<f64> {
    let mut levels = [0.0; RAYS];
    for (ray, level) in levels.iter_mut().enumerate() {
        *level = on_ray(image, center, ray, share * shape.radius(ray) + beyond)?;
    }
    levels.sort_unstable_by(f64::total_cmp);
    Some(0.5 * (levels[RAYS / 2 - 1] + levels[RAYS / 2]))
}

/// Measures the disc around a seed pixel that `threshold` separates from the background.
/// None if there is no disc, or not all of one.
pub(crate) fn measure(
    image: &Image,
    seed: Point,
    threshold: f64,
    radius_px: [f64; 2],
) -> Option<Disc> {
    let (center, radius) = rough(image, seed, threshold, radius_px)?;
    let mut shape = Shape::circle(radius);
    let mut center = center;
    let mut levels = [
        median(image, center, &shape, 0.5, 0.0)?,
        median(image, center, &shape, 1.0, RING)?,
    ];
    // First the rim's centre, then the centroid of the pixels within the rim.
    let radii = rim(image, center, &shape, levels, radius_px)?;
    center = rim_center(center, &radii);
    shape = Shape::through(&rim(image, center, &shape, levels, radius_px)?);
    levels = [
        median(image, center, &shape, 0.6, 0.0)?,
        median(image, center, &shape, 1.0, RING)?,
    ];
    if levels[0] - levels[1] < CONTRAST {
        return None;
    }
    let (centroid, area, holes) = centroid(image, center, &shape, levels)?;
    let radii = rim(image, centroid, &shape, levels, radius_px)?;
    let shape = Shape::through(&radii);
    let [minor, major] = shape.axes();
    let radius = (minor * major).sqrt();
    let whole = (radius_px[0]..=radius_px[1]).contains(&radius)
        && minor > 0.5 * major
        && holes < 0.02
        && (area / (PI * minor * major) - 1.0).abs() < 0.03 + 0.3 / radius
        && (0..RAYS).all(|ray| (radii[ray] - shape.radius(ray)).abs() < RIM_PX)
        && distance(rim_center(centroid, &radii), centroid) < 0.5 * RIM_PX
        && clear(image, centroid, &shape, levels);
    whole.then_some(Disc {
        center: centroid,
        radius,
        levels,
    })
}

/// Centre and radius by where the level falls below the threshold, right and left, down and up;
/// twice.
fn rough(image: &Image, seed: Point, threshold: f64, radius_px: [f64; 2]) -> Option<(Point, f64)> {
    // Specks of noise are not worth a look.
    if smooth(image, seed)? < threshold + 0.2 * CONTRAST {
        return None;
    }
    let reach = 2.0 * radius_px[1] + 2.0;
    let mut center = seed;
    let mut radius = [0.0; 2];
    for pass in 0..4 {
        let axis = pass % 2;
        let end = |step: f64| {
            let mut at = center;
            let mut length = 0.0;
            while length <= reach {
                at[axis] += step;
                length += 1.0;
                if image.level(at[0], at[1])? < threshold {
                    return Some(at[axis]);
                }
            }
            None
        };
        let (upper, lower) = (end(1.0)?, end(-1.0)?);
        center[axis] = 0.5 * (upper + lower);
        radius[axis] = 0.5 * (upper - lower - 1.0);
    }
    let mean = (radius[0] * radius[1]).max(1.0).sqrt();
    let plausible = mean > 0.6 * radius_px[0] && mean < 1.4 * radius_px[1];
    plausible.then_some((center, mean))
}

/// The radius on each ray where the level falls to the half; none if it does not, or not
/// sharply.
fn rim(
    image: &Image,
    center: Point,
    shape: &Shape,
    levels: [f64; 2],
    radius_px: [f64; 2],
) -> Option<[f64; RAYS]> {
    const STEP: f64 = 0.5;
    /// The fall from 80 % to 20 % of the contrast takes at most this, px.
    const SHARP: f64 = 3.5;
    let at = |share: f64| levels[1] + share * (levels[0] - levels[1]);
    let [high, half, low] = [0.8, 0.5, 0.2].map(at);
    let mut radii = [0.0; RAYS];
    for (ray, radius) in radii.iter_mut().enumerate() {
        let about = shape.radius(ray);
        let mut r = 0.6 * about - 0.5;
        let end = 1.6 * about + 3.0;
        let (mut fell, mut crossed) = (None, None);
        let mut before = on_ray(image, center, ray, r)?;
        if before < high {
            return None;
        }
        loop {
            r += STEP;
            if r > end || r > 2.0 * radius_px[1] {
                return None;
            }
            let level = on_ray(image, center, ray, r)?;
            if level < high && fell.is_none() {
                fell = Some(r);
            }
            if level < half && crossed.is_none() {
                crossed = Some(r - STEP * (half - level) / (before - level));
            }
            if level < low {
                break;
            }
            before = level;
        }
        if r - fell? > SHARP {
            return None;
        }
        *radius = crossed?;
    }
    Some(radii)
}

/// The centre of the rim: the radii's first harmonic.
fn rim_center(center: Point, radii: &[f64; RAYS]) -> Point {
    let mut shift = [0.0; 2];
    for (ray, radius) in radii.iter().enumerate() {
        let [cos, sin, ..] = DIRECTIONS[ray];
        shift[0] += 2.0 * radius * cos / RAYS as f64;
        shift[1] += 2.0 * radius * sin / RAYS as f64;
    }
    [center[0] + shift[0], center[1] + shift[1]]
}

/// Centroid and area of the pixels by their share of the contrast, cut off below 15 % and above 85
/// % so that neither texture nor noise counts; and the share of the inner pixels that are missing.
fn centroid(
    image: &Image,
    center: Point,
    shape: &Shape,
    levels: [f64; 2],
) -> Option<(Point, f64, f64)> {
    let [minor, major] = shape.axes();
    let reach = major + 3.0;
    let beyond = (1.0 + 2.0 / minor).powi(2);
    let within = (1.0 - 2.0 / minor).max(0.0).powi(2);
    let [from, to] = [center.map(|x| x - reach), center.map(|x| x + reach)];
    let sides = [image.width(), image.height()];
    if (0..2).any(|k| from[k] < 0.0 || to[k] > (sides[k] - 1) as f64) {
        return None;
    }
    let (floor, span) = (
        levels[1] + 0.15 * (levels[0] - levels[1]),
        0.7 * (levels[0] - levels[1]),
    );
    let (mut sum, mut sums) = (0.0, [0.0; 2]);
    let (mut inner, mut missing) = (0.0, 0.0);
    for v in from[1] as usize..=to[1] as usize {
        for u in from[0] as usize..=to[0] as usize {
            let (x, y) = (u as f64 - center[0], v as f64 - center[1]);
            let square = shape.square(x, y);
            if square > beyond {
                continue;
            }
            let level = f64::from(image.at(u, v));
            let weight = ((level - floor) / span).clamp(0.0, 1.0);
            sum += weight;
            sums = [sums[0] + weight * x, sums[1] + weight * y];
            if square < within {
                inner += 1.0;
                missing += 1.0 - weight;
            }
        }
    }
    (sum > 1.0).then(|| {
        let centroid = [center[0] + sums[0] / sum, center[1] + sums[1] / sum];
        (centroid, sum, missing / f64::max(inner, 1.0))
    })
}

/// Whether disc and background have one level all around.
fn clear(image: &Image, center: Point, shape: &Shape, levels: [f64; 2]) -> bool {
    let contrast = levels[0] - levels[1];
    (0..RAYS).all(|ray| {
        let radius = shape.radius(ray);
        let near = |r: f64, level: f64, share: f64| {
            on_ray(image, center, ray, r).is_some_and(|x| (x - level).abs() < share * contrast)
        };
        near(0.6 * radius, levels[0], 0.3) && near(radius + RING, levels[1], 0.6)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS_PX: [f64; 2] = [4.0, 24.0];

    /// An anti-aliased ellipse of half sizes (`a`, `b`) turned by `turn`, seen through `shade` (0
    /// black, 1 clear).
    fn ellipse(
        center: Point,
        [a, b]: [f64; 2],
        turn: f64,
        shade: impl Fn(f64, f64) -> f64,
    ) -> Image {
        let mut image = Image::new(64, 64);
        for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let mut sum = 0.0;
            for k in 0..256 {
                let u = (i % 64) as f64 + (f64::from(k % 16) + 0.5) / 16.0 - 0.5;
                let v = (i / 64) as f64 + (f64::from(k / 16) + 0.5) / 16.0 - 0.5;
                let (x, y) = (u - center[0], v - center[1]);
                let (x, y) = (
                    x * turn.cos() + y * turn.sin(),
                    y * turn.cos() - x * turn.sin(),
                );
                let inside = (x / a).powi(2) + (y / b).powi(2) < 1.0;
                let level = if inside { 200.0 } else { 70.0 };
                let clear = shade(u, v);
                sum += clear * level + (1.0 - clear) * 40.0;
            }
            *pixel = (sum / 256.0).round() as u8;
        }
        image
    }

    #[test]
    fn a_whole_ellipse_is_found_to_a_twentyfifth_of_a_pixel() {
        for (center, axes, turn) in [
            ([30.3, 29.8], [10.0, 10.0], 0.0),
            ([31.77, 33.21], [8.0, 6.0], 0.7),
            ([28.5, 30.5], [5.0, 4.5], 2.0),
        ] {
            let image = ellipse(center, axes, turn, |_, _| 1.0);
            let disc = measure(&image, [31.0, 30.0], 135.0, RADIUS_PX).unwrap();
            assert!(distance(disc.center, center) < 0.04, "{disc:?} {center:?}");
            assert!((disc.radius - (axes[0] * axes[1]).sqrt()).abs() < 0.1);
        }
    }

    #[test]
    fn a_disc_that_is_cut_is_none_before_its_centroid_moves_by_half_a_pixel() {
        for radius in [5.0, 7.0, 10.0, 14.0] {
            for step in 0..40 {
                let edge = 30.0 + radius - 0.1 * f64::from(step) * radius / 4.0;
                let cut = |u: f64, _: f64| if u < edge { 1.0 } else { 0.0 };
                let image = ellipse([30.3, 29.8], [radius, radius], 0.0, cut);
                if let Some(disc) = measure(&image, [29.0, 30.0], 135.0, RADIUS_PX) {
                    let error = distance(disc.center, [30.3, 29.8]);
                    assert!(error < 0.35, "radius {radius}, edge {edge}: {error}");
                }
            }
        }
    }

    #[test]
    fn a_stripe_across_or_a_low_contrast_is_none() {
        let stripe = |u: f64, _: f64| if (u - 29.0).abs() < 1.0 { 0.0 } else { 1.0 };
        let image = ellipse([30.3, 29.8], [10.0, 10.0], 0.0, stripe);
        assert_eq!(measure(&image, [34.0, 30.0], 135.0, RADIUS_PX), None);
        let veil = |_: f64, _: f64| 0.25;
        let image = ellipse([30.3, 29.8], [10.0, 10.0], 0.0, veil);
        assert_eq!(measure(&image, [31.0, 30.0], 60.0, RADIUS_PX), None);
    }

    #[test]
    fn a_disc_at_the_border_of_the_image_is_none() {
        for center in [[6.0, 30.0], [30.0, 58.0], [2.0, 2.0], [63.5, 30.0]] {
            let image = ellipse(center, [8.0, 8.0], 0.0, |_, _| 1.0);
            assert_eq!(measure(&image, center, 135.0, RADIUS_PX), None);
        }
    }
}
