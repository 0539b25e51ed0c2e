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
        let (inputs, outputs) = (c.scale.len(), c.y[0].len());
        let trajectories = c.trajectory.iter().collect::<BTreeSet<_>>().len();
        writeln!(f, "size             {} bytes", self.size)?;
        writeln!(f, "task             {}", crate::format::hex(&c.task))?;
        let samples = c.x.len();
        writeln!(
            f,
            "samples          {samples} of {trajectories} trajectories"
        )?;
        writeln!(
            f,
            "inputs           {inputs} (points, area, angle), divided by {:.4?}",
            c.scale
        )?;
        writeln!(f, "outputs          {outputs} (twist, way point)")?;
        match &c.regression {
            Some(r) => {
                let factor = r.cholesky.as_ref().map_or("not stored", |_| "stored");
                writeln!(f, "regression       {} samples, RBF kernel", r.x.len())?;
                writeln!(f, "length scales    {:.4?}", r.length_scale)?;
                writeln!(f, "signal variance  {:.6}", r.signal_variance)?;
                writeln!(f, "noise variance   {:.6}", r.noise_variance)?;
                writeln!(f, "output scales    {:.4?}", r.output_scale)?;
                writeln!(f, "variance factor  {factor}")?;
            }
            None => writeln!(f, "regression       none")?,
        }
        let mut provenance = c.provenance.iter();
        provenance.try_for_each(|(key, value)| writeln!(f, "provenance       {key} = {value}"))
    }
}
