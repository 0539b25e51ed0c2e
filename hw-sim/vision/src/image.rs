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
}
