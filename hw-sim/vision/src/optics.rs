//! The lens: loss of light towards the corners, and the point spread.

use scene::Camera;

/// Vignette and a point spread of (1 2 1)/4 along u and v.
#[derive(Clone, Debug)]
pub(crate) struct Optics {
    width: usize,
    /// Share of the light that reaches each pixel.
    vignette: Vec<f32>,
    lines: [Vec<f32>; 3],
}

impl Optics {
    /// Of a camera that loses the share `vignette` of the light in its corners.
    pub fn new(camera: &Camera, vignette: f64) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let share = |i: usize| {
            let (u, v) = ((i % width) as f64, (i / width) as f64);
            let (w, h) = (camera.width, camera.height);
            let square = ((u - 0.5 * w).powi(2) + (v - 0.5 * h).powi(2)) / (0.25 * (w * w + h * h));
            (1.0 - vignette * square) as f32
        };
        Self {
            width,
            vignette: (0..width * height).map(share).collect(),
            lines: [(); 3].map(|()| vec![0.0; width]),
        }
    }

    /// Dims and spreads the levels of an image.
    pub fn spread(&mut self, levels: &mut [f32]) {
        let (width, height) = (self.width, levels.len() / self.width);
        let [above, here, below] = &mut self.lines;
        let blur = |levels: &[f32], vignette: &[f32], line: &mut Vec<f32>| {
            let mut lit = levels
                .iter()
                .zip(vignette)
                .map(|(level, share)| level * share);
            let mut here = lit.next().unwrap_or_default();
            let mut left = here;
            for (x, right) in line.iter_mut().zip(lit) {
                *x = 0.25 * (left + right) + 0.5 * here;
                (left, here) = (here, right);
            }
            line[width - 1] = 0.25 * left + 0.75 * here;
        };
        let row = |v: usize| v * width..(v + 1) * width;
        blur(&levels[row(0)], &self.vignette[row(0)], here);
        above.copy_from_slice(here);
        for v in 0..height {
            let next = row((v + 1).min(height - 1));
            if v + 1 < height {
                blur(&levels[next.clone()], &self.vignette[next], below);
            } else {
                below.copy_from_slice(here);
            }
            let lines = above.iter().zip(&*here).zip(&*below);
            for (level, ((a, h), b)) in levels[row(v)].iter_mut().zip(lines) {
                *level = 0.25 * (a + b) + 0.5 * h;
            }
            std::mem::swap(above, here);
            std::mem::swap(here, below);
        }
    }
}
