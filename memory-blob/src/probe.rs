//! Probes: a few inputs with their answers, stored by the writer and compared by the reader. They
//! catch a wrong layout or scaling that no checksum can see.

use crate::draft::Draft;
use crate::format::{PROBE_TOLERANCE, PROBES};
use crate::tensors::{filled, padded};
use crate::{Contents, MemoryFile, QueryError};

impl Draft {
    /// Adds the probes: the other tensors are all there.
    pub(crate) fn add_probes(&mut self, contents: &Contents) {
        let (n8, p8) = self.layout.padded();
        let count = contents.x.len();
        let memory = self.view();
        let (mut inputs, mut knn, mut means) = (Vec::new(), Vec::new(), Vec::new());
        for probe in 0..PROBES {
            // A third of the way from one sample to another: inside the data, on no sample.
            let a = &contents.x[probe * count / PROBES];
            let b = &contents.x[(probe * 7 + 3) % count];
            let x: Vec<f64> = a.iter().zip(b).map(|(a, b)| a + (b - a) / 3.0).collect();
            let mut answer = vec![0.0; self.layout.outputs];
            if memory.samples().nearest(&x, 1, &mut answer).is_ok() {
                knn.extend(padded(&answer, p8, 0.0));
            }
            if memory
                .gpr()
                .is_some_and(|gpr| gpr.mean(&x, &mut answer).is_ok())
            {
                means.extend(padded(&answer, p8, 0.0));
            }
            inputs.extend(padded(&x, n8, 0.0));
        }
        let probes = [("probes.x", inputs, 0.0), ("probes.knn", knn, 0.0)];
        self.tensors.extend(filled(&self.layout, probes));
        if !means.is_empty() {
            self.tensors
                .extend(filled(&self.layout, [("probes.gpr", means, 0.0)]));
        }
    }
}

impl MemoryFile {
    /// Asks the stored probes again.
    pub(crate) fn verify_probes(&self) -> Result<(), String> {
        let (layout, view) = (self.layout(), self.view());
        let (n8, p8) = layout.padded();
        let mut answer = vec![0.0; layout.outputs];
        for (i, x) in self.tensor("probes.x").chunks(n8).enumerate() {
            let x = &x[..layout.inputs];
            let compare = |what: &str, asked: Result<(), QueryError>, answer: &[f64]| {
                asked.map_err(|e| format!("probe {i} of {what}: {e}"))?;
                let expected = &self.tensor(&format!("probes.{what}"))[i * p8..];
                let is_far = |(found, expected): &(&f64, &f64)| {
                    (*found - *expected).abs() > PROBE_TOLERANCE * (1.0 + expected.abs())
                };
                match answer.iter().zip(expected).find(is_far) {
                    Some((found, expected)) => Err(format!(
                        "probe {i} of {what}: answer {found}; allowed: {expected}"
                    )),
                    None => Ok(()),
                }
            };
            let asked = view.samples().nearest(x, 1, &mut answer).map(|_| ());
            compare("knn", asked, &answer)?;
            if let Some(gpr) = view.gpr() {
                let asked = gpr.mean(x, &mut answer).map(|_| ());
                compare("gpr", asked, &answer)?;
            }
        }
        Ok(())
    }
}
