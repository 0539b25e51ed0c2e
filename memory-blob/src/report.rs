//! A report of what is in a memory.

use std::collections::BTreeSet;
use std::fmt;

use crate::{Contents, MemoryFile};

/// A summary of a memory, for `vpc-memory inspect`.
#[derive(Clone, Debug)]
pub struct Report {
    size: usize,
    contents: Contents,
}

impl Report {
    /// The summary of a file.
    pub fn of(file: &MemoryFile) -> Self {
        Self {
            size: file.size(),
            contents: file.contents(),
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = &self.contents;
        let mut line = |name: &str, value: &dyn fmt::Display| writeln!(f, "{name:16} {value}");
        let trajectories = c.trajectory.iter().collect::<BTreeSet<_>>().len();
        line("size", &format_args!("{} bytes", self.size))?;
        line("task", &crate::format::hex(&c.task))?;
        line(
            "samples",
            &format_args!("{} of {trajectories} trajectories", c.x.len()),
        )?;
        let inputs = format_args!(
            "{} (points, area, angle), divided by {:.4?}",
            c.scale.len(),
            c.scale
        );
        line("inputs", &inputs)?;
        line(
            "outputs",
            &format_args!("{} (twist, way point)", c.y[0].len()),
        )?;
        match &c.regression {
            Some(r) => {
                let variance = if r.cholesky.is_some() {
                    "stored"
                } else {
                    "not stored"
                };
                line(
                    "regression",
                    &format_args!("{} samples, RBF kernel", r.x.len()),
                )?;
                line("length scales", &format_args!("{:.4?}", r.length_scale))?;
                line("signal variance", &format_args!("{:.6}", r.signal_variance))?;
                line("noise variance", &format_args!("{:.6}", r.noise_variance))?;
                line("output scales", &format_args!("{:.4?}", r.output_scale))?;
                line("variance factor", &variance)?;
            }
            None => line("regression", &"none")?,
        }
        let mut provenance = c.provenance.iter();
        provenance.try_for_each(|(key, value)| line("provenance", &format_args!("{key} = {value}")))
    }
}
