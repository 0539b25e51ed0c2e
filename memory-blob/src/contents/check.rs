//! Contents that contradict themselves are not written.

use super::{Contents, WriteError};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

impl Contents {
    /// Every count, shape and range that a reader would refuse.
    pub(super) fn check(&self) -> Result<(), WriteError> {
        let wrong = |what, found: String, allowed: String| {
            Err(WriteError::Contents {
                what,
                found,
                allowed,
            })
        };
        let (n, p) = (self.scale.len(), self.y.first().map_or(0, Vec::len));
        if n == 0 || n > MAX_INPUTS {
            return wrong(
                "scale",
                format!("{n} entries"),
                format!("1 to {MAX_INPUTS}"),
            );
        }
        if p == 0 || p > MAX_OUTPUTS {
            return wrong(
                "y",
                format!("{} rows of {p}", self.y.len()),
                format!("rows of 1 to {MAX_OUTPUTS}"),
            );
        }
        if self.offset.len() != n {
            return wrong(
                "offset",
                format!("{} entries", self.offset.len()),
                format!("{n}"),
            );
        }
        if self.scale.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
            return wrong(
                "scale",
                format!("{:?}", self.scale),
                "finite numbers above 0".into(),
            );
        }
        let count = self.x.len();
        for (what, found) in [
            ("y", self.y.len()),
            ("trajectory", self.trajectory.len()),
            ("step", self.step.len()),
        ] {
            if found != count {
                return wrong(
                    what,
                    format!("{found} rows"),
                    format!("{count}, as many as x"),
                );
            }
        }
        rows("x", &self.x, n)?;
        rows("y", &self.y, p)?;
        let Some(r) = &self.regression else {
            return Ok(());
        };
        rows("regression.x", &r.x, n)?;
        rows("regression.lambda", &r.lambda, p)?;
        let m = r.x.len();
        if m == 0 || r.lambda.len() != m {
            let found = format!("{} rows for {m} inputs", r.lambda.len());
            return wrong(
                "regression.lambda",
                found,
                "one row an input, at least one".into(),
            );
        }
        if r.length_scale.len() != n || r.length_scale.iter().any(|l| !(l.is_finite() && *l > 0.0))
        {
            return wrong(
                "regression.length_scale",
                format!("{:?}", r.length_scale),
                format!("{n} numbers above 0"),
            );
        }
        if r.mean.len() != p || r.mean.iter().any(|m| !m.is_finite()) {
            return wrong(
                "regression.mean",
                format!("{:?}", r.mean),
                format!("{p} finite numbers"),
            );
        }
        for (what, value) in [
            ("regression.signal_variance", r.signal_variance),
            ("regression.noise_variance", r.noise_variance),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(what, value.to_string(), "a finite number above 0".into());
            }
        }
        match &r.output_scale {
            Some(scale)
                if scale.len() != p || scale.iter().any(|s| !(s.is_finite() && *s > 0.0)) =>
            {
                return wrong(
                    "regression.output_scale",
                    format!("{scale:?}"),
                    format!("{p} finite numbers above 0"),
                );
            }
            None if r.cholesky.is_some() => {
                return wrong(
                    "regression.output_scale",
                    "missing".into(),
                    "one number an output, where there is a factor for variances".into(),
                );
            }
            _ => {}
        }
        match &r.cholesky {
            Some(c) if c.len() != m * (m + 1) / 2 || c.iter().any(|x| !x.is_finite()) => {
                let allowed = format!("{} finite numbers", m * (m + 1) / 2);
                wrong(
                    "regression.cholesky",
                    format!("{} numbers", c.len()),
                    allowed,
                )
            }
            _ => Ok(()),
        }
    }
}

fn rows(what: &'static str, rows: &[Vec<f64>], length: usize) -> Result<(), WriteError> {
    let wrong = |found: String, allowed: String| {
        Err(WriteError::Contents {
            what,
            found,
            allowed,
        })
    };
    if rows.is_empty() {
        return wrong("empty".into(), "at least one row".into());
    }
    for (i, row) in rows.iter().enumerate() {
        if row.len() != length {
            return wrong(
                format!("{} entries in row {i}", row.len()),
                format!("{length}"),
            );
        }
        if let Some(x) = row.iter().find(|x| !x.is_finite()) {
            return wrong(format!("{x} in row {i}"), "finite numbers".into());
        }
    }
    Ok(())
}
