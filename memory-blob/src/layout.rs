//! The layout of a file: the counts that fix the shape of every tensor.

use std::collections::BTreeMap;

use crate::exp::LANES;
use crate::format::{self, round_up};
use crate::gpr::OUTPUT_LANES;
use crate::header::Header;
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// The counts that fix all shapes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layout {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) samples: usize,
    pub(crate) gpr_samples: usize,
    pub(crate) signal_variance: f64,
    pub(crate) noise_variance: f64,
}

impl Layout {
    /// The counts and variances of the metadata, each in its range.
    pub(crate) fn read(header: &Header) -> Result<Self, String> {
        let count = |key, most: usize| {
            let allowed = format!("0 to {most}");
            let value: usize = header.number(key, &allowed)?;
            if value <= most {
                Ok(value)
            } else {
                Err(format!("metadata `{key}` = {value}; allowed: {allowed}"))
            }
        };
        let gpr_samples = count("gpr_samples", 1_000_000)?;
        let variance = |key| {
            if gpr_samples == 0 {
                return Ok(1.0);
            }
            let value: f64 = header.number(key, "a finite number above 0")?;
            if value.is_finite() && value > 0.0 {
                Ok(value)
            } else {
                Err(format!(
                    "metadata `{key}` = {value}; allowed: a finite number above 0"
                ))
            }
        };
        if gpr_samples > 0 && header.text("kernel")? != "rbf" {
            return Err(format!(
                "metadata `kernel` = {}; allowed: rbf",
                header.text("kernel")?
            ));
        }
        let layout = Self {
            inputs: count("inputs", MAX_INPUTS)?,
            outputs: count("outputs", MAX_OUTPUTS)?,
            samples: count("samples", 10_000_000)?,
            gpr_samples,
            signal_variance: variance("signal_variance")?,
            noise_variance: variance("noise_variance")?,
        };
        if layout.inputs == 0 || layout.outputs == 0 || layout.samples == 0 {
            return Err(
                "metadata `inputs`, `outputs` or `samples` = 0; allowed: at least 1".into(),
            );
        }
        Ok(layout)
    }

    /// Compares the shape of every tensor; none may be missing, none be there that is not documented.
    pub(crate) fn check_shapes(&self, header: &Header) -> Result<(), String> {
        let (n, p) = (self.inputs, self.outputs);
        let (n8, p8) = (round_up(n, 8), round_up(p, OUTPUT_LANES));
        let blocks = self.samples.div_ceil(BLOCK);
        let probes = header
            .tensors
            .get("probes.x")
            .and_then(|(shape, _)| shape.first())
            .copied()
            .unwrap_or(0);
        if probes == 0 {
            return Err("tensor probes.x is missing or empty; allowed: at least one probe".into());
        }
        let mut expected: BTreeMap<&str, Vec<usize>> = [
            ("scaling", vec![2, n8]),
            ("samples.x", vec![blocks, n, BLOCK]),
            ("samples.y", vec![blocks * BLOCK, p]),
            ("samples.boxes", vec![round_up(blocks, 4), 2, n]),
            (
                "samples.groups",
                vec![round_up(blocks.div_ceil(BLOCKS_PER_GROUP), 4), 2, n],
            ),
            ("samples.origin", vec![2, blocks * BLOCK]),
            ("probes.x", vec![probes, n8]),
            ("probes.knn", vec![probes, p8]),
        ]
        .into();
        if self.gpr_samples > 0 {
            let m = self.gpr_samples;
            let blocks = m.div_ceil(LANES);
            expected.insert("gpr.x", vec![blocks, n, LANES]);
            expected.insert("gpr.lambda", vec![blocks * LANES, p8]);
            expected.insert("gpr.length_scale", vec![n8]);
            expected.insert("gpr.mean", vec![p8]);
            expected.insert("probes.gpr", vec![probes, p8]);
            let has = |name| header.tensors.contains_key(name);
            if header.text("schema")? == format::SCHEMA
                && (has("gpr.output_scale") || has("gpr.cholesky"))
            {
                expected.insert("gpr.output_scale", vec![p8]);
            }
            if has("gpr.cholesky") {
                expected.insert("gpr.cholesky", vec![round_up(m * (m + 1) / 2, 8)]);
            }
        }
        for (name, shape) in &expected {
            match header.tensors.get(*name) {
                None => {
                    return Err(format!(
                        "tensor {name} is missing; allowed: shape {shape:?}"
                    ));
                }
                Some((found, _)) if found != shape => {
                    return Err(format!(
                        "tensor {name}: shape {found:?}; allowed: {shape:?}"
                    ));
                }
                Some(_) => {}
            }
        }
        match header
            .tensors
            .keys()
            .find(|name| !expected.contains_key(name.as_str()))
        {
            Some(name) => Err(format!("tensor {name}; allowed: only the documented ones")),
            None => Ok(()),
        }
    }
}
