//! The layout of a file: the counts that fix the shape of every tensor.

use std::collections::BTreeMap;

use crate::exp::LANES;
use crate::format::round_up;
use crate::gpr::OUTPUT_LANES;
use crate::header::Header;
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::scaling::Scaling;
use crate::view::Memory;
use crate::{Contents, Gpr, MAX_INPUTS, MAX_OUTPUTS, MAX_SAMPLES, Samples};

/// The counts that fix all shapes, and the variances.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layout {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) samples: usize,
    pub(crate) gpr_samples: usize,
    pub(crate) probes: usize,
    pub(crate) has_factor: bool,
    pub(crate) signal_variance: f64,
    pub(crate) noise_variance: f64,
}

impl Layout {
    /// The layout of contents, which were checked, with `probes`.
    pub(crate) fn of(contents: &Contents, probes: usize) -> Self {
        let regression = contents.regression.as_ref();
        Self {
            inputs: contents.scale.len(),
            outputs: contents.y[0].len(),
            samples: contents.x.len(),
            gpr_samples: regression.map_or(0, |r| r.x.len()),
            probes,
            has_factor: regression.is_some_and(|r| r.cholesky.is_some()),
            signal_variance: regression.map_or(1.0, |r| r.signal_variance),
            noise_variance: regression.map_or(1.0, |r| r.noise_variance),
        }
    }

    /// The counts and variances of the metadata, each in its range.
    pub(crate) fn read(header: &Header) -> Result<Self, String> {
        let count = |key, least: usize, most: usize| {
            let allowed = format!("{least} to {most}");
            header.number(key, &allowed, |value| (least..=most).contains(value))
        };
        let gpr_samples = count("gpr_samples", 0, 1_000_000)?;
        let variance = |key| match gpr_samples {
            0 => Ok(1.0),
            _ => header.number(key, "a finite number above 0", |v: &f64| {
                v.is_finite() && *v > 0.0
            }),
        };
        if gpr_samples > 0 && header.text("kernel")? != "rbf" {
            let kernel = header.text("kernel")?;
            return Err(format!("metadata `kernel` = {kernel}; allowed: rbf"));
        }
        let probes = header
            .tensors
            .get("probes.x")
            .and_then(|(shape, _)| shape.first());
        let probes = probes.copied().filter(|probes| *probes > 0);
        Ok(Self {
            inputs: count("inputs", 1, MAX_INPUTS)?,
            outputs: count("outputs", 1, MAX_OUTPUTS)?,
            samples: count("samples", 1, MAX_SAMPLES)?,
            gpr_samples,
            probes: probes
                .ok_or("tensor probes.x is missing or empty; allowed: at least one probe")?,
            has_factor: header.tensors.contains_key("gpr.cholesky"),
            signal_variance: variance("signal_variance")?,
            noise_variance: variance("noise_variance")?,
        })
    }

    /// Inputs and outputs, rounded up to a multiple of 8.
    pub(crate) fn padded(&self) -> (usize, usize) {
        (
            round_up(self.inputs, 8),
            round_up(self.outputs, OUTPUT_LANES),
        )
    }

    /// Blocks and groups of samples.
    fn blocks(&self) -> (usize, usize) {
        let blocks = self.samples.div_ceil(BLOCK);
        (blocks, blocks.div_ceil(BLOCKS_PER_GROUP))
    }

    /// The shape of every tensor.
    pub(crate) fn shapes(&self) -> BTreeMap<&'static str, Vec<usize>> {
        let (n, p, m) = (self.inputs, self.outputs, self.gpr_samples);
        let ((n8, p8), (blocks, groups)) = (self.padded(), self.blocks());
        let mut shapes = BTreeMap::from([
            ("scaling", vec![2, n8]),
            ("samples.x", vec![blocks, n, BLOCK]),
            ("samples.y", vec![blocks * BLOCK, p]),
            ("samples.boxes", vec![round_up(blocks, 4), 2, n]),
            ("samples.groups", vec![round_up(groups, 4), 2, n]),
            ("samples.origin", vec![2, blocks * BLOCK]),
            ("samples.cost_to_go", vec![blocks * BLOCK]),
            ("probes.x", vec![self.probes, n8]),
            ("probes.knn", vec![self.probes, p8]),
        ]);
        if m > 0 {
            shapes.extend([
                ("gpr.x", vec![m.div_ceil(LANES), n, LANES]),
                ("gpr.lambda", vec![round_up(m, LANES), p8]),
                ("gpr.length_scale", vec![n8]),
                ("gpr.mean", vec![p8]),
                ("gpr.output_scale", vec![p8]),
                ("probes.gpr", vec![self.probes, p8]),
            ]);
            let factor = vec![round_up(m * (m + 1) / 2, 8)];
            shapes.extend(self.has_factor.then_some(("gpr.cholesky", factor)));
        }
        shapes
    }

    /// Compares the shape of every tensor: none may be missing, and none be there that is not
    /// documented.
    pub(crate) fn check_shapes(&self, header: &Header) -> Result<(), String> {
        let shapes = self.shapes();
        for (name, shape) in &shapes {
            match header.tensors.get(*name) {
                Some((found, _)) if found == shape => {}
                Some((found, _)) => {
                    return Err(format!(
                        "tensor {name}: shape {found:?}; allowed: {shape:?}"
                    ));
                }
                None => {
                    return Err(format!(
                        "tensor {name} is missing; allowed: shape {shape:?}"
                    ));
                }
            }
        }
        match header
            .tensors
            .keys()
            .find(|name| !shapes.contains_key(name.as_str()))
        {
            Some(name) => Err(format!("tensor {name}; allowed: only the documented ones")),
            None => Ok(()),
        }
    }

    /// The view of tensors that have these shapes.
    pub(crate) fn view<'a>(&self, tensor: impl Fn(&str) -> &'a [f64]) -> Memory<'a> {
        let (n, (n8, _), (blocks, groups)) = (self.inputs, self.padded(), self.blocks());
        let (offset, scale) = tensor("scaling").split_at(n8);
        let scaling = Scaling {
            offset: &offset[..n],
            scale: &scale[..n],
        };
        let samples = Samples {
            scaling,
            count: self.samples,
            outputs: self.outputs,
            x: tensor("samples.x"),
            y: tensor("samples.y"),
            origin: tensor("samples.origin"),
            cost_to_go: tensor("samples.cost_to_go"),
            boxes: &tensor("samples.boxes")[..blocks * 2 * n],
            groups: &tensor("samples.groups")[..groups * 2 * n],
        };
        let gpr = (self.gpr_samples > 0).then(|| Gpr {
            scaling,
            count: self.gpr_samples,
            outputs: self.outputs,
            signal_variance: self.signal_variance,
            length_scale: &tensor("gpr.length_scale")[..n],
            x: tensor("gpr.x"),
            lambda: tensor("gpr.lambda"),
            mean: tensor("gpr.mean"),
            output_scale: &tensor("gpr.output_scale")[..self.outputs],
            cholesky: tensor("gpr.cholesky"),
        });
        Memory { samples, gpr }
    }
}
