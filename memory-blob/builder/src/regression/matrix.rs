//! A plain matrix for samples.

use super::RegressionError;

/// A dense matrix of finite values, row-major: one row a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    rows: usize,
    columns: usize,
    data: Vec<f64>,
}

impl Matrix {
    /// Takes `data` (row by row) as the matrix called `name` with `columns` columns.
    ///
    /// # Errors
    /// When there is no row or no column, the last row is not full, or a value is not finite.
    pub fn new(
        name: &'static str,
        columns: usize,
        data: Vec<f64>,
    ) -> Result<Self, RegressionError> {
        if columns == 0 {
            let expected = "at least 1 is needed".into();
            return Err(RegressionError::Size {
                name,
                what: "columns",
                found: 0,
                expected,
            });
        }
        if data.is_empty() || !data.len().is_multiple_of(columns) {
            let expected = format!("a multiple of its {columns} columns, and not 0, is needed");
            return Err(RegressionError::Size {
                name,
                what: "values",
                found: data.len(),
                expected,
            });
        }
        if let Some(at) = data.iter().position(|value| !value.is_finite()) {
            let (row, column) = (at / columns, at % columns);
            return Err(RegressionError::NotFinite {
                name,
                row,
                column,
                value: data[at],
            });
        }
        Ok(Self {
            rows: data.len() / columns,
            columns,
            data,
        })
    }

    /// Number of rows, at least 1.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns, at least 1.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// All values, row by row.
    pub fn data(&self) -> &[f64] {
        &self.data
    }

    /// Row `row`, counted from 0 and below [`Self::rows`].
    pub fn row(&self, row: usize) -> &[f64] {
        &self.data[row * self.columns..(row + 1) * self.columns]
    }

    /// The values of column `column`, from the first row to the last.
    pub fn column(&self, column: usize) -> impl Iterator<Item = f64> + Clone + '_ {
        self.data.iter().skip(column).step_by(self.columns).copied()
    }
}
