//! The inputs column by column, and the pairwise work on them: O(D^2 n) with loops that vectorise.

use faer::Mat;

use super::Kernel;

/// One vector of length D for each of the n inputs.
#[derive(Clone, Debug)]
pub struct Inputs {
    columns: Vec<Vec<f64>>,
    rows: usize,
}

impl Inputs {
    /// The inputs in some rows of equal length.
    pub fn of<'a>(rows: impl IntoIterator<Item = &'a Vec<f64>>) -> Self {
        let (mut columns, mut count) = (Vec::new(), 0);
        for row in rows {
            columns.resize(row.len(), Vec::new());
            columns
                .iter_mut()
                .zip(row)
                .for_each(|(column, x): (&mut Vec<f64>, _)| column.push(*x));
            count += 1;
        }
        Self {
            columns,
            rows: count,
        }
    }

    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// The same inputs, each divided by its length scale.
    pub(super) fn scaled(&self, kernel: &Kernel) -> Self {
        let pairs = self.columns.iter().zip(&kernel.length_scales);
        let columns = pairs
            .map(|(c, l)| c.iter().map(|x| x / l).collect())
            .collect();
        Self {
            columns,
            rows: self.rows,
        }
    }

    /// Covariance without noise of inputs that are already scaled; only the lower triangle and the
    /// diagonal are written.
    pub(super) fn covariance(&self, signal_variance: f64) -> Mat<f64> {
        let mut covariance = Mat::<f64>::zeros(self.rows, self.rows);
        let mut squares = vec![0.0; self.rows];
        for column in 0..self.rows {
            let squares = &mut squares[column..];
            squares.fill(0.0);
            for input in &self.columns {
                let centre = input[column];
                for (square, x) in squares.iter_mut().zip(&input[column..]) {
                    *square += (x - centre) * (x - centre);
                }
            }
            for (offset, square) in squares.iter().enumerate() {
                covariance[(column + offset, column)] = signal_variance * (-0.5 * square).exp();
            }
        }
        covariance
    }

    /// For each input i the sum over pairs a > b of weights(a, b) (x_ai - x_bi)^2. Only the strict
    /// lower triangle of `weights` is read.
    ///
    /// The expanded form, with r the row sums of the weights, 2 (sum_a r_a x_ai^2 - x_i^T W x_i),
    /// is a matrix product but loses digits when the weights are large; this costs as much and
    /// loses none.
    pub(super) fn weighted_squares(&self, weights: &Mat<f64>) -> Vec<f64> {
        let mut line = vec![0.0; self.rows];
        let mut sums = vec![vec![0.0; self.rows]; self.columns.len()];
        for column in 0..self.rows {
            for (row, weight) in line.iter_mut().enumerate().skip(column + 1) {
                *weight = weights[(row, column)];
            }
            for (sum, input) in sums.iter_mut().zip(&self.columns) {
                let centre = input[column];
                let weighted = line[column..].iter().zip(&input[column..]).skip(1);
                for (sum, (weight, x)) in sum[column..].iter_mut().skip(1).zip(weighted) {
                    *sum += weight * (x - centre) * (x - centre);
                }
            }
        }
        sums.iter().map(|sum| sum.iter().sum()).collect()
    }
}
