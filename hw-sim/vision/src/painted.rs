//! How deep the white pixels of a mask lie.

use scene::Mask;

/// Depths of all pixels of an image.
#[derive(Clone, Debug)]
pub(crate) struct Painted {
    width: usize,
    height: usize,
    /// From each pixel's centre to the edge of what is white, px; 0 if it is black. What lies
    /// outside the image is no edge.
    depth: Vec<f32>,
    deepest: f64,
}

impl Painted {
    pub fn new(mask: &Mask) -> Self {
        let (width, height) = (mask.width(), mask.height());
        // First the way along each column to the nearest black pixel, then the best of the columns
        // for each pixel.
        let far = (width + height) as i64;
        let mut along = vec![far; width * height];
        for u in 0..width {
            for down in [true, false] {
                let mut way = far;
                for k in 0..height {
                    let v = if down { k } else { height - 1 - k };
                    way = if mask.is_forbidden(u, v) {
                        (way + 1).min(far)
                    } else {
                        0
                    };
                    let at = &mut along[v * width + u];
                    *at = way.min(*at);
                }
            }
        }
        let depth = (0..width * height).map(|i| {
            let (u, row) = (i % width, &along[i / width * width..][..width]);
            let mut square = row[u] * row[u];
            for across in 1..width as i64 {
                if across * across >= square {
                    break;
                }
                for column in [u as i64 - across, u as i64 + across] {
                    let way = usize::try_from(column).ok().and_then(|c| row.get(c));
                    square = way.map_or(square, |way| square.min(across * across + way * way));
                }
            }
            // From centre to centre; the edge is half a pixel nearer.
            ((square as f32).sqrt() - 0.5).max(0.0)
        });
        let depth: Vec<f32> = depth.collect();
        Self {
            width,
            height,
            deepest: f64::from(depth.iter().copied().fold(0.5, f32::max)),
            depth,
        }
    }

    /// The depth of the pixel about a point, px; 0 outside the image.
    pub fn depth(&self, u: f64, v: f64) -> f64 {
        // The casts saturate.
        let (column, row) = ((u + 0.5) as usize, (v + 0.5) as usize);
        if u > -0.5 && v > -0.5 && column < self.width && row < self.height {
            f64::from(self.depth[row * self.width + column])
        } else {
            0.0
        }
    }

    /// The greatest depth, px.
    pub fn deepest(&self) -> f64 {
        self.deepest
    }

    /// Least and greatest column and row of the white pixels.
    pub fn window(&self) -> [[usize; 2]; 2] {
        let mut window = [[usize::MAX; 2], [0; 2]];
        for i in (0..self.depth.len()).filter(|i| self.depth[*i] > 0.0) {
            for (k, x) in [i % self.width, i / self.width].into_iter().enumerate() {
                window[0][k] = window[0][k].min(x);
                window[1][k] = window[1][k].max(x);
            }
        }
        window
    }
}

/// Whether a point (px) lies on a white pixel: the square of side 1 about its whole-numbered
/// centre.
pub(crate) fn is_white(mask: &Mask, u: f64, v: f64) -> bool {
    let (column, row) = ((u + 0.5).floor(), (v + 0.5).floor());
    // The casts saturate; what lies left of or above the image must not count as its first pixel.
    column >= 0.0 && row >= 0.0 && mask.is_forbidden(column as usize, row as usize)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use scene::{Occlusion, Scene};

    /// The robot's scene with one painted occlusion in place of its own.
    pub(crate) fn masked(is_white: impl Fn(u32, u32) -> bool) -> Scene {
        let own = format!(
            "vision-{}-{:?}",
            std::process::id(),
            std::thread::current().id()
        );
        let directory = std::env::temp_dir().join(own);
        std::fs::create_dir_all(&directory).unwrap();
        scene::write_mask(&directory.join("mask.png"), 640, 480, is_white).unwrap();
        let (head, _) = scene::TAGS_ROBOT.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
        std::fs::write(directory.join("scene.toml"), text).unwrap();
        let scene = Scene::read(&directory.join("scene.toml")).unwrap();
        std::fs::remove_dir_all(directory).unwrap();
        scene
    }

    fn mask(is_white: impl Fn(u32, u32) -> bool) -> Mask {
        let scene = masked(is_white);
        let occlusion: &Occlusion = &scene.occlusions[0];
        occlusion.mask.unwrap()
    }

    #[test]
    fn depths_in_a_box_and_a_disc_are_the_distances_to_their_edges() {
        let painted = Painted::new(&mask(|i, j| {
            (100..141).contains(&i) && (50..91).contains(&j)
        }));
        assert_eq!(painted.window(), [[100, 50], [140, 90]]);
        assert_eq!(
            (painted.depth(99.0, 70.0), painted.depth(100.0, 70.0)),
            (0.0, 0.5)
        );
        assert_eq!(painted.depth(120.0, 70.0), 20.5);
        assert_eq!(painted.deepest(), 20.5);
        let disc = |i: u32, j: u32| (f64::from(i) - 300.0).hypot(f64::from(j) - 200.0) < 60.0;
        let painted = Painted::new(&mask(disc));
        for (column, row) in [(300, 200), (330, 220), (290, 250)] {
            let expected = 60.0 - (f64::from(column) - 300.0).hypot(f64::from(row) - 200.0);
            let found = painted.depth(f64::from(column), f64::from(row));
            assert!((found - expected).abs() < 0.8, "{found} {expected}");
        }
    }

    #[test]
    fn the_edge_of_the_image_is_no_edge_of_what_is_white_there() {
        let painted = Painted::new(&mask(|i, _| i < 30));
        assert_eq!(
            (painted.depth(0.0, 0.0), painted.depth(29.0, 479.0)),
            (29.5, 0.5)
        );
    }

    #[test]
    fn a_pixel_is_the_square_about_its_centre() {
        let mask = mask(|i, j| (i, j) == (10, 20));
        for (u, v, white) in [
            (10.0, 20.0, true),
            (9.51, 20.49, true),
            (9.49, 20.0, false),
            (10.0, 20.51, false),
            (-3.0, 20.0, false),
        ] {
            assert_eq!(is_white(&mask, u, v), white, "({u}, {v})");
        }
        let corner = self::mask(|i, j| i < 2 && j < 2);
        assert!(is_white(&corner, -0.4, -0.4) && !is_white(&corner, -0.6, 0.0));
    }
}
