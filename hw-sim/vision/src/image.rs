//! Grey images.

/// An 8-bit grey image, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Image {
    /// A black image of at least one pixel.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            pixels: vec![0; width * height],
        }
    }

    /// Width, px.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row from the top.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// All pixels, to be written.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// A pixel, in column `u` and row `v`; coordinates beyond the border give the pixel at the
    /// border.
    pub fn at(&self, u: usize, v: usize) -> u8 {
        self.pixels[v.min(self.height - 1) * self.width + u.min(self.width - 1)]
    }

    /// The level between four pixels, 0 to 255, bilinear; `None` if one of them is outside.
    pub fn level(&self, u: f64, v: f64) -> Option<f64> {
        let inside =
            u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f64 && v < (self.height - 1) as f64;
        inside.then(|| {
            let (column, row) = (u as usize, v as usize);
            let (a, b) = (u - column as f64, v - row as f64);
            let at = row * self.width + column;
            let upper = &self.pixels[at..at + 2];
            let lower = &self.pixels[at + self.width..at + self.width + 2];
            let mix = |pair: &[u8]| f64::from(pair[0]) * (1.0 - a) + f64::from(pair[1]) * a;
            mix(upper) * (1.0 - b) + mix(lower) * b
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_pixels_the_level_is_bilinear_and_outside_there_is_none() {
        let mut image = Image::new(16, 16);
        image.pixels_mut()[3 * 16 + 5] = 200;
        assert_eq!(image.level(5.0, 3.0), Some(200.0));
        assert_eq!(image.level(5.25, 2.5), Some(75.0));
        assert_eq!(image.level(-0.1, 3.0), None);
        assert_eq!(image.level(15.0, 3.0), None);
    }
}
