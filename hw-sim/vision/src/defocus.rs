//! A picture that is out of focus.

/// How far the kernel reaches, standard deviations.
const REACH: f64 = 3.5;

/// A Gaussian blur of a whole image.
#[derive(Clone, Debug)]
pub(crate) struct Defocus {
    width: usize,
    /// Weights of a pixel's neighbours, from itself outwards; they sum to 1 over both sides.
    weights: Vec<f32>,
    /// A row with its ends repeated.
    line: Vec<f32>,
    /// The image, blurred along the rows.
    rows: Vec<f32>,
}

impl Defocus {
    /// Of this standard deviation, px; `None` where there is nothing to blur.
    pub fn new(sigma: f64, width: usize, height: usize) -> Option<Self> {
        (sigma > 0.0).then(|| {
            let reach = (REACH * sigma).ceil() as usize;
            let weight = |k: usize| (-0.5 * (k as f64 / sigma).powi(2)).exp();
            let sum: f64 = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f64>();
            Self {
                width,
                weights: (0..=reach).map(|k| (weight(k) / sum) as f32).collect(),
                line: vec![0.0; width + 2 * reach],
                rows: vec![0.0; width * height],
            }
        })
    }

    /// Blurs the levels of an image.
    pub fn blur(&mut self, levels: &mut [f32]) {
        let (width, reach) = (self.width, self.weights.len() - 1);
        for (row, blurred) in levels
            .chunks_exact(width)
            .zip(self.rows.chunks_exact_mut(width))
        {
            self.line[..reach].fill(row[0]);
            self.line[reach..reach + width].copy_from_slice(row);
            self.line[reach + width..].fill(row[width - 1]);
            blurred.fill(0.0);
            for (k, &weight) in self.weights.iter().enumerate() {
                let (left, right) = (&self.line[reach - k..], &self.line[reach + k..]);
                add(blurred, left, right, share(k, weight));
            }
        }
        let height = levels.len() / width;
        let row = |v: usize| &self.rows[v * width..(v + 1) * width];
        for (v, blurred) in levels.chunks_exact_mut(width).enumerate() {
            blurred.fill(0.0);
            for (k, &weight) in self.weights.iter().enumerate() {
                let (above, below) = (v.saturating_sub(k), (v + k).min(height - 1));
                add(blurred, row(above), row(below), share(k, weight));
            }
        }
    }
}

/// The weight of each of the two neighbours at a distance: at none, both are the pixel itself.
fn share(distance: usize, weight: f32) -> f32 {
    if distance == 0 { 0.5 * weight } else { weight }
}

fn add(sum: &mut [f32], a: &[f32], b: &[f32], weight: f32) {
    for (x, (a, b)) in sum.iter_mut().zip(a.iter().zip(b)) {
        *x += weight * (a + b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_of_light_becomes_a_gaussian_of_the_width_asked_for() {
        for sigma in [0.6, 1.5, 4.0] {
            let mut levels = vec![0.0; 61 * 61];
            levels[30 * 61 + 30] = 1000.0;
            Defocus::new(sigma, 61, 61).unwrap().blur(&mut levels);
            let (mut sum, mut squares) = (0.0, [0.0; 2]);
            for (i, level) in levels.iter().enumerate() {
                let level = f64::from(*level);
                sum += level;
                squares[0] += level * ((i % 61) as f64 - 30.0).powi(2);
                squares[1] += level * ((i / 61) as f64 - 30.0).powi(2);
            }
            assert!((sum - 1000.0).abs() < 0.1, "{sum}");
            for square in squares {
                // A kernel that is sampled and cut is a little off.
                let found = (square / sum).sqrt();
                assert!((found / sigma - 1.0).abs() < 0.03, "{sigma}: {found}");
            }
        }
    }

    #[test]
    fn an_even_picture_stays_and_nothing_is_blurred_without_a_width() {
        let mut levels = vec![77.0; 20 * 30];
        Defocus::new(3.0, 20, 30).unwrap().blur(&mut levels);
        assert!(levels.iter().all(|level| (level - 77.0).abs() < 1e-3));
        assert!(Defocus::new(0.0, 20, 30).is_none());
    }
}
