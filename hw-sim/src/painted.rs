//! Exact distances between image points and the white pixels of a mask, for the referee.
//!
//! Source: T. Saito, J.-I. Toriwaki, "New algorithms for Euclidean distance transformation of an
//! n-dimensional digitized picture", Pattern Recognition 27, 1994: a distance transform goes through
//! the columns first, and then takes the least over the columns of a row. Here the first pass is
//! made once, for the image. The second is made for the point that is asked about: a point lies
//! between pixels, and a transform that ends at the pixels' centres errs by up to half a diagonal.

use scene::Mask;

/// A mask, prepared for distances.
#[derive(Clone, Debug)]
pub struct Painted {
    mask: Mask,
    /// For each pixel, row by row: how many pixels of its own colour its column has from it
    /// upwards, itself included, and how many downwards.
    runs: Vec<[u16; 2]>,
}

impl Painted {
    /// Goes through the columns of a mask: takes a few milliseconds for a megapixel.
    pub fn new(mask: &Mask) -> Self {
        let (width, pixels) = (mask.width(), mask.pixels());
        let mut runs = vec![[1, 1]; pixels.len()];
        for pixel in width..pixels.len() {
            if pixels[pixel] == pixels[pixel - width] {
                runs[pixel][0] = runs[pixel - width][0] + 1;
            }
        }
        for pixel in (0..pixels.len().saturating_sub(width)).rev() {
            if pixels[pixel] == pixels[pixel + width] {
                runs[pixel][1] = runs[pixel + width][1] + 1;
            }
        }
        Self { mask: *mask, runs }
    }

    /// Whether a point is on a white pixel.
    pub fn covers(&self, [u, v]: [f64; 2]) -> bool {
        let (u, v) = ((u + 0.5).floor(), (v + 0.5).floor());
        u >= 0.0 && v >= 0.0 && self.mask.is_forbidden(u as usize, v as usize)
    }

    /// Signed distance of a point from the white pixels, px, where it is below `bound`; else some
    /// number at or above it. On a white pixel it is negative and always told: the way to the next
    /// black one. What lies outside the image is neither forbidden nor a way out.
    pub fn distance_below(&self, point: [f64; 2], bound: f64) -> f64 {
        if self.covers(point) {
            -self.distance(point, false, f64::INFINITY)
        } else {
            self.distance(point, true, bound)
        }
    }

    /// Distance from a point to the nearest pixel of a colour, px, or `bound`, which is less.
    fn distance(&self, [u, v]: [f64; 2], is_white: bool, bound: f64) -> f64 {
        let (width, height) = (self.mask.width() as i64, self.mask.height() as i64);
        // From the corner of the first pixel, whose centre is (0, 0): pixels begin at whole numbers.
        let (u, v) = (u + 0.5, v + 0.5);
        let own = (u.floor() as i64).clamp(0, width - 1);
        let row = (v.floor() as i64).clamp(0, height - 1);
        let gap = |x: f64, k: i64| (k as f64 - x).max(x - (k + 1) as f64).max(0.0);
        // The distance along a column from its row that is nearest to the point.
        let along = |column: i64| {
            let pixel = (row * width + column) as usize;
            if self.mask.is_forbidden(column as usize, row as usize) == is_white {
                return gap(v, row);
            }
            let [up, down] = self.runs[pixel].map(i64::from);
            let far = |end: i64| match (0..height).contains(&end) {
                true => gap(v, end),
                false => f64::INFINITY,
            };
            far(row - up).min(far(row + down))
        };
        let mut square = bound.max(0.0).powi(2);
        for columns in [own..width, 0..own] {
            let is_backward = columns.end == own;
            let (first, count) = (columns.start, columns.end - columns.start);
            for step in 0..count {
                let column = match is_backward {
                    true => own - 1 - step,
                    false => first + step,
                };
                let across = gap(u, column).powi(2);
                // Columns further on are not nearer.
                if across >= square {
                    break;
                }
                square = square.min(across + along(column).powi(2));
            }
        }
        if square < bound.max(0.0).powi(2) {
            square.sqrt()
        } else {
            bound
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn painted(width: u32, height: u32, is_white: impl Fn(u32, u32) -> bool) -> Painted {
        let directory = tempfile::TempDir::new().unwrap();
        let path = directory.path().join("mask.png");
        scene::write_mask(&path, width, height, is_white).unwrap();
        let mask = Mask::decode(&std::fs::read(path).unwrap(), width, height).unwrap();
        Painted::new(&mask)
    }

    #[test]
    fn distances_to_a_rectangle_are_exact() {
        // White from (299.5, 199.5) to (399.5, 259.5).
        let painted = painted(1024, 1024, |i, j| {
            (300..400).contains(&i) && (200..260).contains(&j)
        });
        for (point, expected) in [
            ([290.0, 229.8], 9.5),
            ([349.7, 264.5], 5.0),
            ([402.5, 263.5], 5.0),
            ([349.7, 245.2], -14.3),
            ([389.75, 228.5], -9.75),
            ([399.5, 229.5], 0.0),
            ([-30.5, 155.5], 44f64.hypot(330.0)),
        ] {
            let found = painted.distance_below(point, 1e4);
            assert!((found - expected).abs() < 1e-9, "{point:?}: {found}");
        }
        assert!(painted.distance_below([290.0, 229.8], 5.0) >= 5.0);
        assert_eq!(painted.distance_below([290.0, 229.8], -3.0), -3.0);
        // A bound below tells a violation none the less.
        assert!((painted.distance_below([349.7, 245.2], -10.0) + 14.3).abs() < 1e-9);
    }

    #[test]
    fn white_at_the_edge_of_the_image_offers_no_way_out_beyond_it() {
        let painted = painted(1024, 1024, |i, _| i < 100);
        assert!((painted.distance_below([2.5, 500.0], 1e4) + 97.0).abs() < 1e-9);
        assert!((painted.distance_below([-4.5, 500.0], 1e4) - 4.0).abs() < 1e-9);
        assert!(painted.covers([-0.4, 500.0]) && !painted.covers([-0.6, 500.0]));
    }

    #[test]
    fn distances_are_those_to_the_nearest_of_all_pixels() {
        // A ring, a slanted bar and a corner of the image, 97 x 61 px.
        let is_white = |i: u32, j: u32| {
            let (u, v) = (f64::from(i), f64::from(j));
            let from_ring = (u - 40.0).hypot(v - 30.0);
            (12.0..20.0).contains(&from_ring)
                || (u + 2.0 * v - 150.0).abs() < 8.0
                || (i < 9 && j < 5)
        };
        let painted = painted(97, 61, is_white);
        let pixels = || (0..61).flat_map(|j| (0..97).map(move |i| (i, j)));
        let gap = |x: f64, k: u32| ((x - f64::from(k)).abs() - 0.5).max(0.0);
        let mut seen = [0; 2];
        for n in 0..4000_u32 {
            // Points of a lattice that fits no pixel, up to 12 px outside.
            let [u, v] = [0.618_034, 0.754_878].map(|x| (x * f64::from(n)).fract());
            let point = [121.0 * u - 12.0, 85.0 * v - 12.0];
            let nearest = |wanted: bool| {
                let found = pixels().filter(|&(i, j)| is_white(i, j) == wanted);
                let found = found.map(|(i, j)| gap(point[0], i).hypot(gap(point[1], j)));
                found.fold(f64::INFINITY, f64::min)
            };
            let is_inside = nearest(true) == 0.0;
            let expected = if is_inside {
                -nearest(false)
            } else {
                nearest(true)
            };
            let found = painted.distance_below(point, 1e4);
            assert!(
                (found - expected).abs() < 1e-9,
                "{point:?}: {found}, not {expected}"
            );
            assert_eq!(painted.covers(point), is_inside, "{point:?}");
            seen[usize::from(is_inside)] += 1;
        }
        assert!(seen.iter().all(|count| *count > 500), "{seen:?}");
    }
}
