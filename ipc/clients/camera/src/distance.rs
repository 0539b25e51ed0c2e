//! Exact Euclidean distances between the pixels of an image.

/// Stands for "no pixel": larger than any squared distance, and small enough to subtract.
const NONE: f64 = 1e12;

/// The distance of each pixel's centre to that of the nearest pixel in `set`, px, row by row from
/// the top left; infinite everywhere where the set is empty.
///
/// Source: P. Felzenszwalb, D. Huttenlocher, "Distance transforms of sampled functions" (2012):
/// lower envelopes of parabolas, first along columns, then along rows.
pub fn to_set(set: &[bool], width: usize) -> Vec<f32> {
    let height = set.len() / width;
    let mut squares: Vec<f64> = set.iter().map(|is| if *is { 0.0 } else { NONE }).collect();
    let mut envelope = Envelope::new(width.max(height));
    for column in 0..width {
        envelope.pass(&mut squares, column, width, height);
    }
    for row in 0..height {
        envelope.pass(&mut squares, row * width, 1, width);
    }
    let distance = |square: &f64| match *square {
        square if square >= NONE => f32::INFINITY,
        square => square.sqrt() as f32,
    };
    squares.iter().map(distance).collect()
}

/// The lower envelope of parabolas along a line of pixels, with its buffers.
struct Envelope {
    values: Vec<f64>,
    /// Where the parabolas of the envelope have their lowest points.
    lowest: Vec<usize>,
    /// From where on each of them is the envelope.
    from: Vec<f64>,
}

impl Envelope {
    fn new(longest: usize) -> Self {
        Self {
            values: vec![0.0; longest],
            lowest: vec![0; longest],
            from: vec![0.0; longest],
        }
    }

    /// Replaces `count` values, `stride` apart from `start`, by the least of value + distance^2.
    fn pass(&mut self, squares: &mut [f64], start: usize, stride: usize, count: usize) {
        for k in 0..count {
            self.values[k] = squares[start + k * stride];
        }
        let value = |k: usize| self.values[k];
        let square = |k: usize| (k * k) as f64;
        let mut last = 0;
        (self.lowest[0], self.from[0]) = (0, f64::NEG_INFINITY);
        for k in 1..count {
            loop {
                let other = self.lowest[last];
                let meet = (value(k) + square(k) - value(other) - square(other))
                    / (2 * (k - other)) as f64;
                if meet > self.from[last] {
                    last += 1;
                    (self.lowest[last], self.from[last]) = (k, meet);
                    break;
                }
                // The first parabola begins at minus infinity: this ends there.
                last -= 1;
            }
        }
        let mut part = 0;
        for k in 0..count {
            while part < last && self.from[part + 1] < k as f64 {
                part += 1;
            }
            let lowest = self.lowest[part];
            squares[start + k * stride] = value(lowest) + square(k.abs_diff(lowest));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_a_search() {
        let (width, height) = (23, 17);
        // Few pixels, in no order.
        let set: Vec<bool> = (0..width * height).map(|k| k * k % 97 == 3).collect();
        assert!(set.contains(&true));
        for (k, found) in to_set(&set, width).iter().enumerate() {
            let squares = (0..set.len()).filter(|other| set[*other]).map(|other| {
                let (u, v) = (k % width, k / width);
                u.abs_diff(other % width).pow(2) + v.abs_diff(other / width).pow(2)
            });
            let least = squares.min().unwrap() as f32;
            assert!((found - least.sqrt()).abs() < 1e-5, "{k}: {found}");
        }
    }

    #[test]
    fn nothing_is_infinitely_far() {
        assert!(to_set(&[false; 12], 4).iter().all(|x| x.is_infinite()));
        assert_eq!(to_set(&[true; 12], 4), [0.0; 12]);
    }
}
