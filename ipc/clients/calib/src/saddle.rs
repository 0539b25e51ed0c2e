//! Where four squares of a chessboard meet, to a fraction of a pixel.
//!
//! Source: W. Förstner and E. Gülch, "A fast operator for detection and precise location of distinct
//! points" (1987), as OpenCV's `cornerSubPix` iterates it.

use nalgebra::{Matrix2, Vector2};
use vpc_camera::grey::Grey;

use crate::target::Point;

/// Most and fewest pixels on each side that are looked at.
const REACH: [f64; 2] = [7.0, 2.0];
/// Passes, and the step that ends them, px.
const PASSES: usize = 30;
const STEP: f64 = 1e-3;
/// Farther from the start it is another corner, in reaches.
const AWAY: f64 = 0.7;

/// The corner near `start`, px. It looks at pixels up to `reach` px away: other edges must be
/// farther. `None` if there is no corner, or if `reach` is too short.
pub fn refine(image: &Grey, start: Point, reach: f64) -> Option<Point> {
    let [most, fewest] = REACH;
    let side = reach.min(most).floor();
    if side < fewest {
        return None;
    }
    let side = side as i32;
    let level = |at: Vector2<f64>| image.level(at.into());
    let mut found = Vector2::from(start);
    for _ in 0..PASSES {
        // The gradient at each place p is across the line from the corner c to it: g g' (p - c) = 0.
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for (i, j) in (-side..=side).flat_map(|j| (-side..=side).map(move |i| (i, j))) {
            let off = Vector2::new(f64::from(i), f64::from(j));
            let at = found + off;
            let across = |step: Vector2<f64>| Some(level(at + step)? - level(at - step)?);
            let gradient = Vector2::new(across(Vector2::x())?, across(Vector2::y())?);
            let weight = (-off.norm_squared() / f64::from(side * side)).exp();
            let square = weight * gradient * gradient.transpose();
            normal += square;
            right += square * off;
        }
        let step = normal.try_inverse()? * right;
        found += step;
        let is_near = (found - Vector2::from(start)).norm() < AWAY * reach.min(most);
        if !is_near {
            return None;
        }
        if step.norm() < STEP {
            return Some(found.into());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_corner_is_where_it_is_drawn_and_a_flat_image_has_none() {
        let (at, turn) = ([15.3, 14.6], 0.3_f64);
        let level = |k: usize| {
            let p = Vector2::new((k % 30) as f64 - at[0], (k / 30) as f64 - at[1]);
            let along = |angle: f64| (p.x * angle.cos() + p.y * angle.sin()).clamp(-1.0, 1.0);
            (128.0 + 90.0 * along(turn) * along(turn + 1.4)) as u8
        };
        let pixels: Vec<u8> = (0..900).map(level).collect();
        let image = Grey::new(&pixels, 30, 30, 30).unwrap();
        let [u, v] = refine(&image, [16.2, 14.0], 6.0).unwrap();
        // Levels between pixels are bilinear, and these edges are sharper than a lens draws them.
        assert!((u - at[0]).hypot(v - at[1]) < 0.05, "{u} {v}");
        assert_eq!(refine(&image, [16.2, 14.0], 1.9), None);
        assert_eq!(refine(&image, [2.0, 14.0], 6.0), None);
        let pixels = vec![90; 900];
        let image = Grey::new(&pixels, 30, 30, 30).unwrap();
        assert_eq!(refine(&image, at, 6.0), None);
    }
}
