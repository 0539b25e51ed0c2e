//! What is in a memory, in words.

use std::fmt;

use crate::MemoryFile;

/// A summary of a memory, for `vpc-memory inspect`.
#[derive(Clone, Debug)]
pub struct Report {
    lines: Vec<(&'static str, String)>,
}

impl Report {
    /// The summary of a file.
    pub fn of(file: &MemoryFile) -> Self {
        let contents = file.contents();
        let trajectories = contents
            .trajectory
            .iter()
            .collect::<std::collections::BTreeSet<_>>()
            .len();
        let mut lines = vec![
            ("size", format!("{} bytes", file.size())),
            ("task", crate::format::hex(file.task())),
            (
                "samples",
                format!("{} of {} trajectories", contents.x.len(), trajectories),
            ),
            (
                "inputs",
                format!(
                    "{} (points, area, angle), divided by {:.4?}",
                    contents.scale.len(),
                    contents.scale
                ),
            ),
            (
                "outputs",
                format!("{} (twist, way point)", contents.y[0].len()),
            ),
        ];
        match &contents.regression {
            Some(r) => {
                lines.push(("regression", format!("{} samples, RBF kernel", r.x.len())));
                lines.push(("length scales", format!("{:.4?}", r.length_scale)));
                lines.push(("signal variance", format!("{:.6}", r.signal_variance)));
                lines.push(("noise variance", format!("{:.6}", r.noise_variance)));
                if let Some(scale) = &r.output_scale {
                    lines.push(("output scales", format!("{scale:.4?}")));
                }
                let variance = if r.cholesky.is_some() {
                    "stored"
                } else {
                    "not stored"
                };
                lines.push(("variance factor", variance.to_owned()));
            }
            None => lines.push(("regression", "none".to_owned())),
        }
        let provenance = file.provenance();
        lines.extend(
            provenance
                .iter()
                .map(|(key, value)| ("provenance", format!("{key} = {value}"))),
        );
        Self { lines }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.lines
            .iter()
            .try_for_each(|(name, value)| writeln!(f, "{name:16} {value}"))
    }
}
