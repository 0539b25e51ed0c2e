//! Images of real numbers, and their means over windows.

/// A number for each pixel of an image.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Pixels in a row.
    pub width: usize,
    /// Row by row from the top left.
    pub values: Vec<f32>,
}

impl Plane {
    /// Zeros.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            values: vec![0.0; width * height],
        }
    }
}

/// A symmetric blur along rows, then along columns; the border of the image goes on beyond it.
#[derive(Clone, Debug)]
pub struct Blur {
    /// Weights of the middle and of the neighbours on one side; all of both sides sum to 1.
    half: Vec<f32>,
}

impl Blur {
    /// A Gaussian of this standard deviation, px, cut at three of them.
    pub fn gaussian(deviation: f64) -> Self {
        let reach = (3.0 * deviation).ceil() as usize;
        let weight = |k: usize| (-0.5 * (k as f64 / deviation).powi(2)).exp();
        let sum: f64 = (1..=reach).map(|k| 2.0 * weight(k)).sum::<f64>() + 1.0;
        Self {
            half: (0..=reach).map(|k| (weight(k) / sum) as f32).collect(),
        }
    }

    /// How many neighbours it reaches.
    pub fn reach(&self) -> i64 {
        self.half.len() as i64 - 1
    }

    /// The weight of the neighbour `offset` px away.
    pub fn weight(&self, offset: i64) -> f32 {
        let weight = self.half.get(offset.unsigned_abs() as usize);
        weight.copied().unwrap_or(0.0)
    }

    /// A blurred copy.
    pub fn of(&self, plane: &Plane) -> Plane {
        let (width, height) = (plane.width, plane.values.len() / plane.width);
        let reach = self.half.len() - 1;
        let mut across = Plane::new(width, height);
        let mut line = vec![0.0; width + 2 * reach];
        let rows = plane.values.chunks_exact(width);
        for (row, into) in rows.zip(across.values.chunks_exact_mut(width)) {
            line[..reach].fill(row[0]);
            line[reach..reach + width].copy_from_slice(row);
            line[reach + width..].fill(row[width - 1]);
            for (k, weight) in self.half.iter().enumerate() {
                let [left, right] = [reach - k, reach + k].map(|from| &line[from..from + width]);
                let weight = if k == 0 { 0.5 * weight } else { *weight };
                for ((into, left), right) in into.iter_mut().zip(left).zip(right) {
                    *into += weight * (left + right);
                }
            }
        }
        let mut blurred = Plane::new(width, height);
        for (v, into) in blurred.values.chunks_exact_mut(width).enumerate() {
            for (k, weight) in self.half.iter().enumerate() {
                let [above, below] = [v.saturating_sub(k), (v + k).min(height - 1)]
                    .map(|row| &across.values[row * width..(row + 1) * width]);
                let weight = if k == 0 { 0.5 * weight } else { *weight };
                for ((into, above), below) in into.iter_mut().zip(above).zip(below) {
                    *into += weight * (above + below);
                }
            }
        }
        blurred
    }
}

/// The mean over the square of 2 half + 1 pixels about each; the border of the image goes on beyond
/// it.
pub fn box_mean(plane: &Plane, half: usize) -> Plane {
    let weight = 1.0 / (2 * half + 1) as f32;
    Blur {
        half: vec![weight; half + 1],
    }
    .of(plane)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_keeps_the_mean_and_spreads_a_point_by_its_deviation() {
        let mut point = Plane::new(41, 41);
        point.values[20 * 41 + 20] = 1.0;
        let blurred = Blur::gaussian(2.0).of(&point);
        let moment = |power: i32| -> f32 {
            let at = |k: usize| ((k % 41) as f32 - 20.0).powi(power);
            blurred
                .values
                .iter()
                .enumerate()
                .map(|(k, x)| at(k) * x)
                .sum()
        };
        assert!((moment(0) - 1.0).abs() < 1e-5);
        assert!((moment(2) - 4.0).abs() < 0.15, "{}", moment(2));
        let flat = Plane {
            width: 7,
            values: vec![3.0; 35],
        };
        assert!(
            box_mean(&flat, 2)
                .values
                .iter()
                .all(|x| (x - 3.0).abs() < 1e-5)
        );
    }
}
