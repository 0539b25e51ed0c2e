//! Sets of pixels: morphology with Euclidean discs, and connected areas.
//!
//! What the set is at the border of the image, it is beyond: nothing there shrinks it.

use std::fmt;

use crate::distance;

/// A set of pixels of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    width: usize,
    /// Row by row from the top left.
    pixels: Vec<bool>,
}

/// Connected pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct StillArea {
    /// How many.
    pub pixels: usize,
    /// Their mean (u, v), px.
    pub center: [f64; 2],
    /// Width and height of the box about them, px.
    pub size: [usize; 2],
    /// The share of its neighbourhood in which fine structure was seen in most images, 0 to 1.
    pub seen: f64,
}

impl Region {
    /// The pixels of an image, `width` wide, for which `holds(index)`.
    pub fn of(width: usize, height: usize, holds: impl Fn(usize) -> bool) -> Self {
        Self {
            width,
            pixels: (0..width * height).map(holds).collect(),
        }
    }

    /// Whether it holds a pixel, row by row from the top left.
    pub fn holds(&self, index: usize) -> bool {
        self.pixels[index]
    }

    /// Whether it holds the pixel about a point (u, v), px; `false` outside of the image.
    pub fn covers(&self, point: [f64; 2]) -> bool {
        let [column, row] = point.map(f64::round);
        let height = (self.pixels.len() / self.width) as f64;
        let is_inside = (0.0..self.width as f64).contains(&column) && (0.0..height).contains(&row);
        is_inside && self.pixels[row as usize * self.width + column as usize]
    }

    /// How many pixels it has.
    pub fn count(&self) -> usize {
        self.pixels.iter().filter(|is| **is).count()
    }

    /// The distance of each pixel to the nearest one of the set, px.
    pub fn distances(&self) -> Vec<f32> {
        distance::to_set(&self.pixels, self.width)
    }

    /// The pixels of one of two sets.
    pub fn or(&self, other: &Self) -> Self {
        self.kept(|k| self.pixels[k] || other.pixels[k])
    }

    /// The pixels that are at most `px` from the set.
    pub fn grown(&self, px: f64) -> Self {
        let distances = self.distances();
        self.kept(|k| f64::from(distances[k]) <= px)
    }

    /// The pixels that are further than `px` from all that the set does not hold.
    pub fn shrunk(&self, px: f64) -> Self {
        let outside = self.kept(|k| !self.pixels[k]).distances();
        self.kept(|k| f64::from(outside[k]) > px)
    }

    /// Without what is narrower than a disc of this radius.
    pub fn opened(&self, px: f64) -> Self {
        self.shrunk(px).grown(px)
    }

    /// With the gaps into which a disc of this radius does not go.
    pub fn closed(&self, px: f64) -> Self {
        self.grown(px).shrunk(px)
    }

    /// The connected areas of at least `least` pixels, which may touch at corners, in the order of
    /// their first pixels.
    pub fn areas(&self, least: usize) -> Vec<Self> {
        let (width, height) = (self.width, self.pixels.len() / self.width);
        let mut rest = self.pixels.clone();
        let mut areas = Vec::new();
        for first in 0..rest.len() {
            if !rest[first] {
                continue;
            }
            let (mut found, mut next) = (vec![first], 0);
            rest[first] = false;
            while let Some(&pixel) = found.get(next) {
                next += 1;
                let (u, v) = (pixel % width, pixel / width);
                for row in v.saturating_sub(1)..=(v + 1).min(height - 1) {
                    for column in u.saturating_sub(1)..=(u + 1).min(width - 1) {
                        let pixel = row * width + column;
                        if std::mem::take(&mut rest[pixel]) {
                            found.push(pixel);
                        }
                    }
                }
            }
            if found.len() >= least {
                let mut area = self.kept(|_| false);
                found.iter().for_each(|pixel| area.pixels[*pixel] = true);
                areas.push(area);
            }
        }
        areas
    }

    /// Without the connected areas of fewer than `least` pixels.
    pub fn without_specks(&self, least: usize) -> Self {
        let none = self.kept(|_| false);
        self.areas(least)
            .iter()
            .fold(none, |all, area| all.or(area))
    }

    /// Where the set is, and how large; `seen` is for the caller to say.
    pub fn described(&self, seen: f64) -> StillArea {
        let (mut low, mut high, mut sum) = ([usize::MAX; 2], [0; 2], [0; 2]);
        for pixel in (0..self.pixels.len()).filter(|pixel| self.pixels[*pixel]) {
            let at = [pixel % self.width, pixel / self.width];
            for k in 0..2 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k]);
                sum[k] += at[k];
            }
        }
        let pixels = self.count();
        StillArea {
            pixels,
            center: sum.map(|sum| sum as f64 / pixels.max(1) as f64),
            size: [0, 1].map(|k| (high[k] + 1).saturating_sub(low[k])),
            seen,
        }
    }

    fn kept(&self, holds: impl Fn(usize) -> bool) -> Self {
        Self::of(self.width, self.pixels.len() / self.width, holds)
    }
}

impl fmt::Display for StillArea {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([u, v], [width, height]) = (self.center, self.size);
        write!(f, "{width}x{height} px about ({u:.0}, {v:.0})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(rows: &[&str]) -> Region {
        let text: String = rows.concat();
        let text = text.as_bytes();
        Region::of(rows[0].len(), rows.len(), |k| text[k] == b'#')
    }

    #[test]
    fn specks_go_gaps_close_and_the_border_of_the_image_holds() {
        let image = drawn(&[
            "###.....", //
            "#.#.....", "###...#.", "........",
        ]);
        // The hole, and the gap of one pixel to the lower border.
        assert_eq!(image.closed(1.0).count(), 9 + 1 + 2);
        // The corner of the image, where the disc is half outside.
        assert_eq!(image.opened(1.0).count(), 3);
        assert_eq!(
            image.closed(1.0).opened(1.0),
            image.closed(1.0).without_specks(2)
        );
        assert_eq!(image.grown(1.0).count(), 15 + 5);
        let areas = image.areas(1);
        assert_eq!(areas.len(), 2);
        let area = areas[0].described(0.5);
        assert_eq!(
            (area.pixels, area.center, area.size),
            (8, [1.0, 1.0], [3, 3])
        );
    }
}
