//! Probes: a few inputs and what the queries answer to them, stored by the writer and asked again by the reader. They
//! catch a wrong layout or scaling that no checksum can see.

use crate::draft::Draft;
use crate::format::{PROBE_TOLERANCE, PROBES, round_up};
use crate::gpr::OUTPUT_LANES;
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::tensors::padded;
use crate::view::{Memory, Scaling};
use crate::{Contents, Gpr, MemoryFile, QueryError, Samples};

impl Draft {
    fn tensor(&self, name: &str) -> &[f64] {
        self.tensors.get(name).map_or(&[], |(_, data)| data)
    }

    /// Adds the probes: the tensors of the draft are all there.
    pub(crate) fn add_probes(&mut self, contents: &Contents) {
        let (n, p) = (contents.scale.len(), contents.y[0].len());
        let (n8, p8) = (round_up(n, 8), round_up(p, OUTPUT_LANES));
        let count = contents.x.len();
        let scaling = Scaling {
            offset: &contents.offset,
            scale: &contents.scale,
        };
        let blocks = count.div_ceil(BLOCK);
        let samples = Samples {
            scaling,
            count,
            outputs: p,
            x: self.tensor("samples.x"),
            y: self.tensor("samples.y"),
            boxes: &self.tensor("samples.boxes")[..blocks * 2 * n],
            groups: &self.tensor("samples.groups")[..blocks.div_ceil(BLOCKS_PER_GROUP) * 2 * n],
        };
        let gpr = contents.regression.as_ref().map(|r| Gpr {
            scaling,
            count: r.x.len(),
            outputs: p,
            signal_variance: r.signal_variance,
            length_scale: &r.length_scale,
            x: self.tensor("gpr.x"),
            lambda: self.tensor("gpr.lambda"),
            mean: self.tensor("gpr.mean"),
            output_scale: &[],
            cholesky: &[],
        });
        let memory = Memory {
            samples: Some(samples),
            gpr,
        };
        let (mut inputs, mut knn, mut means) = (Vec::new(), Vec::new(), Vec::new());
        for probe in 0..PROBES {
            // Two thirds of the way from one sample to another: inside the data, on no sample.
            let (a, b) = (
                &contents.x[probe * count / PROBES],
                &contents.x[(probe * 7 + 3) % count],
            );
            let x: Vec<f64> = a.iter().zip(b).map(|(a, b)| a + (b - a) / 3.0).collect();
            let mut answer = vec![0.0; p];
            if let Some(samples) = memory.samples()
                && samples.nearest(&x, 1, &mut answer).is_ok()
            {
                knn.extend(padded(&answer, p8, 0.0));
            }
            if let Some(gpr) = memory.gpr()
                && gpr.mean(&x, &mut answer).is_ok()
            {
                means.extend(padded(&answer, p8, 0.0));
            }
            inputs.extend(padded(&x, n8, 0.0));
        }
        self.tensors
            .insert("probes.x".into(), (vec![PROBES, n8], inputs));
        self.tensors
            .insert("probes.knn".into(), (vec![PROBES, p8], knn));
        if !means.is_empty() {
            self.tensors
                .insert("probes.gpr".into(), (vec![PROBES, p8], means));
        }
    }
}

impl MemoryFile {
    /// Asks the stored probes again.
    pub(crate) fn verify_probes(&self) -> Result<(), String> {
        let l = self.layout();
        let (n8, p8) = (round_up(l.inputs, 8), round_up(l.outputs, OUTPUT_LANES));
        let view = self.view();
        let mut answer = vec![0.0; l.outputs];
        for (i, x) in self.tensor("probes.x").chunks(n8).enumerate() {
            let x = &x[..l.inputs];
            let compare = |what: &str, asked: Result<(), QueryError>, answer: &[f64]| {
                asked.map_err(|e| format!("probe {i} of {what}: {e}"))?;
                let expected = &self.tensor(&format!("probes.{what}"))[i * p8..];
                for (found, expected) in answer.iter().zip(expected) {
                    let tolerance = PROBE_TOLERANCE * (1.0 + expected.abs());
                    if (found - expected).abs() > tolerance {
                        return Err(format!(
                            "probe {i} of {what}: answer {found}; allowed: {expected}"
                        ));
                    }
                }
                Ok(())
            };
            if let Some(samples) = view.samples() {
                let asked = samples.nearest(x, 1, &mut answer).map(|_| ());
                compare("knn", asked, &answer)?;
            }
            if let Some(gpr) = view.gpr() {
                let asked = gpr.mean(x, &mut answer);
                compare("gpr", asked, &answer)?;
            }
        }
        Ok(())
    }
}
