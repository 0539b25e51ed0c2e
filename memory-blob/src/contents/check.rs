//! Checks that contents are consistent before they are written.

use super::{Contents, Regression, WriteError};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

impl Contents {
    /// Refuses every count, shape and range that a reader would refuse.
    pub(crate) fn check(&self) -> Result<(), WriteError> {
        let (n, p) = (self.scale.len(), self.y.first().map_or(0, Vec::len));
        let count = self.x.len();
        require((1..=MAX_INPUTS).contains(&n), "scale", entries(n), || {
            format!("1 to {MAX_INPUTS}")
        })?;
        require(
            (1..=MAX_OUTPUTS).contains(&p),
            "y",
            format!("{} rows of {p}", self.y.len()),
            || format!("rows of 1 to {MAX_OUTPUTS}"),
        )?;
        require(
            self.offset.len() == n,
            "offset",
            entries(self.offset.len()),
            || n.to_string(),
        )?;
        positive("scale", &self.scale, n)?;
        let lengths = [
            ("y", self.y.len()),
            ("trajectory", self.trajectory.len()),
            ("step", self.step.len()),
            ("cost_to_go", self.cost_to_go.len()),
        ];
        for (what, found) in lengths {
            require(found == count, what, format!("{found} rows"), || {
                format!("{count}, as many as x")
            })?;
        }
        rows("x", &self.x, n)?;
        rows("y", &self.y, p)?;
        rows("cost_to_go", std::slice::from_ref(&self.cost_to_go), count)?;
        self.regression.as_ref().map_or(Ok(()), |r| r.check(n, p))
    }
}

impl Regression {
    fn check(&self, n: usize, p: usize) -> Result<(), WriteError> {
        rows("regression.x", &self.x, n)?;
        rows("regression.lambda", &self.lambda, p)?;
        let (m, lambdas) = (self.x.len(), self.lambda.len());
        require(
            lambdas == m,
            "regression.lambda",
            format!("{lambdas} rows for {m} inputs"),
            || "one row an input".into(),
        )?;
        positive("regression.length_scale", &self.length_scale, n)?;
        rows("regression.mean", std::slice::from_ref(&self.mean), p)?;
        positive("regression.signal_variance", &[self.signal_variance], 1)?;
        positive("regression.noise_variance", &[self.noise_variance], 1)?;
        positive("regression.output_scale", &self.output_scale, p)?;
        match &self.cholesky {
            Some(c) => rows(
                "regression.cholesky",
                std::slice::from_ref(c),
                m * (m + 1) / 2,
            ),
            None => Ok(()),
        }
    }
}

fn entries(count: usize) -> String {
    format!("{count} entries")
}

fn require(
    holds: bool,
    what: &'static str,
    found: String,
    allowed: impl FnOnce() -> String,
) -> Result<(), WriteError> {
    let wrong = |()| WriteError::Contents {
        what,
        found,
        allowed: allowed(),
    };
    holds.then_some(()).ok_or(()).map_err(wrong)
}

fn positive(what: &'static str, values: &[f64], count: usize) -> Result<(), WriteError> {
    let fine = values.len() == count && values.iter().all(|x| x.is_finite() && *x > 0.0);
    require(fine, what, format!("{values:?}"), || {
        format!("{count} finite numbers above 0")
    })
}

fn rows(what: &'static str, rows: &[Vec<f64>], length: usize) -> Result<(), WriteError> {
    require(!rows.is_empty(), what, "empty".into(), || {
        "at least one row".into()
    })?;
    for (i, row) in rows.iter().enumerate() {
        require(
            row.len() == length,
            what,
            format!("{} entries in row {i}", row.len()),
            || length.to_string(),
        )?;
        if let Some(x) = row.iter().find(|x| !x.is_finite()) {
            require(false, what, format!("{x} in row {i}"), || {
                "finite numbers".into()
            })?;
        }
    }
    Ok(())
}
