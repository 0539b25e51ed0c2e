//! A grey image that is looked at.

use std::ops::Range;

/// An 8-bit grey image, row by row from the top, in somebody else's memory.
#[derive(Clone, Copy, Debug)]
pub struct Grey<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a> Grey<'a> {
    /// An image of `width` x `height` px whose rows begin `stride` bytes apart; `None` if `pixels`
    /// are too few, or a row is longer than the stride.
    pub fn new(pixels: &'a [u8], width: usize, height: usize, stride: usize) -> Option<Self> {
        let needed = height.checked_sub(1)?.checked_mul(stride)?;
        let is_whole = width <= stride && needed.checked_add(width)? <= pixels.len();
        (is_whole && width > 0).then_some(Self {
            pixels,
            width,
            height,
            stride,
        })
    }

    /// Width, px.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> usize {
        self.height
    }

    /// A row from the top, without what follows it in memory.
    pub fn row(&self, row: usize) -> &'a [u8] {
        &self.pixels[row * self.stride..][..self.width]
    }

    /// The part in these columns and rows, which must be inside.
    pub fn part(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        let first = rows.start * self.stride + columns.start;
        Self {
            pixels: &self.pixels[first..(rows.end - 1) * self.stride + columns.end],
            width: columns.len(),
            height: rows.len(),
            stride: self.stride,
        }
    }

    /// The level at a point, 0 to 255, bilinear between the four pixels about it; `None` if one of
    /// them is outside.
    pub fn level(&self, [u, v]: [f64; 2]) -> Option<f64> {
        let (right, bottom) = ((self.width - 1) as f64, (self.height - 1) as f64);
        // Not a number is not inside either.
        if !(u >= 0.0 && v >= 0.0 && u < right && v < bottom) {
            return None;
        }
        let (column, row) = (u as usize, v as usize);
        let (a, b) = (u - column as f64, v - row as f64);
        let first = row * self.stride + column;
        let mix = |first: usize| {
            let pair = &self.pixels[first..first + 2];
            f64::from(pair[0]) * (1.0 - a) + f64::from(pair[1]) * a
        };
        Some(mix(first) * (1.0 - b) + mix(first + self.stride) * b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_of_the_first_pixel_is_the_origin() {
        let pixels = [10, 20, 0, 30, 40, 0];
        let image = Grey::new(&pixels, 2, 2, 3).unwrap();
        assert_eq!(image.level([0.0, 0.0]), Some(10.0));
        assert_eq!(image.level([0.5, 0.5]), Some(25.0));
        assert_eq!(image.level([-0.1, 0.0]), None);
        assert_eq!(image.level([1.0, 0.0]), None);
        assert_eq!(image.level([f64::NAN, 0.0]), None);
        assert_eq!(image.row(1), [30, 40]);
        assert_eq!(image.part(1..2, 1..2).row(0), [40]);
    }

    #[test]
    fn an_image_that_is_not_there_is_refused() {
        let pixels = [0; 5];
        assert!(Grey::new(&pixels, 2, 2, 3).is_some());
        for (width, height, stride) in [(3, 2, 3), (2, 3, 2), (3, 1, 2), (2, usize::MAX, 3)] {
            assert!(Grey::new(&pixels, width, height, stride).is_none());
        }
        assert!(Grey::new(&pixels, 0, 1, 3).is_none() && Grey::new(&pixels, 2, 0, 3).is_none());
    }
}
