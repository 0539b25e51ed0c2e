//! Occlusions as layers of pixels, drawn once: coverage and light over an occlusion's box.

use scene::{Occlusion, Part};

use crate::lens::Lens;
use crate::painted::{Painted, is_white};

/// Samples along a side of a pixel that the border crosses.
const SAMPLES: usize = 4;

/// Pixels of the image, from column and row, by width and height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Area {
    pub column: usize,
    pub row: usize,
    pub width: usize,
    pub height: usize,
}

impl Area {
    /// The pixels within `margin` of an occlusion's box as a lens shows it, cut at the border of an
    /// image.
    pub fn around(
        occlusion: &Occlusion,
        lens: &Lens,
        margin: f64,
        width: usize,
        height: usize,
    ) -> Self {
        let (mut least, mut most) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for k in 0..2 {
            for part in &occlusion.parts {
                least[k] = least[k].min(part.center[k] - part.half[k]);
                most[k] = most[k].max(part.center[k] + part.half[k]);
            }
            if let Some(mask) = &occlusion.mask {
                let [first, last] = Painted::new(mask).window();
                least[k] = least[k].min(first[k] as f64 - 0.5);
                most[k] = most[k].max(last[k] as f64 + 0.5);
            }
        }
        let [least, most] = lens.distort_box([least, most]);
        let side = |k: usize, size: usize| {
            let size = size as f64;
            let from = (least[k] - margin).floor().clamp(0.0, size);
            let to = (most[k] + margin).ceil() + 1.0;
            (from as usize, (to.clamp(from, size) - from) as usize)
        };
        let (column, columns) = side(0, width);
        let (row, rows) = side(1, height);
        Self {
            column,
            row,
            width: columns,
            height: rows,
        }
    }

    /// Each row: its index within the area, and where its pixels lie in an image of this width.
    pub fn rows(self, width: usize) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> {
        (0..self.height).map(move |row| {
            let from = (self.row + row) * width + self.column;
            (row, from..from + self.width)
        })
    }
}

/// How deep a point lies in a part: the p-norm of its offset in half sizes; below 1 inside.
pub(crate) fn part_norm(part: &Part, u: f64, v: f64) -> f64 {
    let term = |k: usize, x: f64| ((x - part.center[k]).abs() / part.half[k]).powf(part.p);
    (term(0, u) + term(1, v)).powf(1.0 / part.p)
}

/// Whether a point lies inside an occlusion.
pub(crate) fn covers(occlusion: &Occlusion, u: f64, v: f64) -> bool {
    occlusion
        .parts
        .iter()
        .any(|part| part_norm(part, u, v) < 1.0)
        || occlusion.mask.is_some_and(|mask| is_white(&mask, u, v))
}

/// The coverage of each pixel of an area, 0 to 1.
pub(crate) fn coverage(occlusion: &Occlusion, lens: &Lens, area: Area) -> Vec<f32> {
    pixels(area, |u, v| {
        let inside = (0..SAMPLES * SAMPLES).filter(|k| {
            let offset = |i: usize| (i as f64 + 0.5) / SAMPLES as f64 - 0.5;
            let seen = lens.undistort([u + offset(k % SAMPLES), v + offset(k / SAMPLES)]);
            seen.is_some_and(|[u, v]| covers(occlusion, u, v))
        });
        inside.count() as f32 / (SAMPLES * SAMPLES) as f32
    })
}

/// How much a soft-edged layer acts on each pixel of an area: 0 at the border and outside, 1 from
/// `softness` px inside.
pub(crate) fn soft(occlusion: &Occlusion, lens: &Lens, area: Area, softness: f64) -> Vec<f32> {
    let painted = occlusion.mask.as_ref().map(Painted::new);
    pixels(area, |u, v| {
        let Some([u, v]) = lens.undistort([u, v]) else {
            return 0.0;
        };
        let depth = occlusion.parts.iter().map(|part| {
            let least = part.half[0].min(part.half[1]);
            (1.0 - part_norm(part, u, v)) * least / softness.min(0.5 * least)
        });
        let of_mask = painted
            .as_ref()
            .map(|painted| painted.depth(u, v) / softness.min(0.5 * painted.deepest()));
        let x = depth.chain(of_mask).fold(0.0, f64::max).min(1.0);
        (x * x * (3.0 - 2.0 * x)) as f32
    })
}

/// The relief of an opaque object, 0 at its rim to 1 in its middle.
pub(crate) fn relief(occlusion: &Occlusion, lens: &Lens, area: Area) -> Vec<f32> {
    let painted = occlusion.mask.as_ref().map(Painted::new);
    pixels(area, |u, v| {
        let Some([u, v]) = lens.undistort([u, v]) else {
            return 0.0;
        };
        let norm = occlusion.parts.iter().map(|part| part_norm(part, u, v));
        let of_mask = painted
            .as_ref()
            .map(|painted| 1.0 - painted.depth(u, v) / painted.deepest());
        let norm = norm.chain(of_mask).fold(1.0, f64::min);
        (1.0 - norm * norm).sqrt() as f32
    })
}

fn pixels(area: Area, value: impl Fn(f64, f64) -> f32) -> Vec<f32> {
    let count = area.width * area.height;
    let at = |i: usize| {
        let (column, row) = (i % area.width, i / area.width);
        value((area.column + column) as f64, (area.row + row) as f64)
    };
    (0..count).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(distortion: [f64; 5]) -> Lens {
        let scene = scene::Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        Lens::new(&scene.camera, distortion)
    }

    fn straight() -> Lens {
        lens([0.0; 5])
    }

    fn circle() -> Occlusion {
        let mut scene = scene::Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        scene.occlusions.swap_remove(0)
    }

    #[test]
    fn the_coverage_of_a_circle_sums_to_its_area() {
        let area = Area::around(&circle(), &straight(), 1.0, 640, 480);
        let sum: f32 = coverage(&circle(), &straight(), area).iter().sum();
        assert!((f64::from(sum) / (std::f64::consts::PI * 38.0 * 38.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn an_area_ends_at_the_image() {
        let area = Area::around(&circle(), &straight(), 1e4, 640, 480);
        let whole = Area {
            column: 0,
            row: 0,
            width: 640,
            height: 480,
        };
        assert_eq!(area, whole);
        assert_eq!(Area::around(&circle(), &straight(), 0.0, 100, 480).width, 0);
    }

    #[test]
    fn a_soft_layer_changes_nothing_outside_its_shape() {
        let area = Area::around(&circle(), &straight(), 10.0, 640, 480);
        let action = soft(&circle(), &straight(), area, 4.0);
        let at = |u: usize, v: usize| action[(v - area.row) * area.width + (u - area.column)];
        assert_eq!((at(320 + 38, 222), at(320 + 34, 222)), (0.0, 1.0));
        assert!((at(320 + 36, 222) - 0.5).abs() < 1e-6);
        assert_eq!(at(320, 222), 1.0);
    }

    #[test]
    fn a_distorted_occlusion_covers_what_the_lens_shows_of_it() {
        let lens = lens([-0.3, 0.1, 0.0, 0.0, 0.0]);
        let mut aside = circle();
        aside.parts[0].center = [560.0, 420.0];
        let area = Area::around(&aside, &lens, 1.0, 640, 480);
        let shares = coverage(&aside, &lens, area);
        let mut covered = 0;
        for (i, share) in shares.iter().enumerate() {
            let at = [area.column + i % area.width, area.row + i / area.width].map(|x| x as f64);
            let [u, v] = lens.undistort(at).unwrap();
            let depth = 38.0 - (u - 560.0).hypot(v - 420.0);
            assert!(depth.abs() < 1.0 || f64::from(*share) == f64::from(depth > 0.0));
            covered += usize::from(*share > 0.5);
        }
        // A barrel makes smaller what is far from the centre; and all of it is in the area.
        assert!((3000..4300).contains(&covered), "{covered}");
        let wider = Area::around(&aside, &lens, 9.0, 640, 480);
        let all: f32 = coverage(&aside, &lens, wider).iter().sum();
        assert!((all - shares.iter().sum::<f32>()).abs() < 1e-3);
    }
}
