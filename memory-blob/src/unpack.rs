//! From a file back to what its maker knew.

use crate::exp::LANES;
use crate::samples::BLOCK;
use crate::{Contents, MemoryFile, Regression};

impl MemoryFile {
    /// Everything in the file, as its maker knew it: samples in the order of trajectories and steps. Allocates; not
    /// for the control cycle.
    pub fn contents(&self) -> Contents {
        let l = self.layout();
        let n = l.inputs;
        let scaling = self.scaling();
        let raw = |k: usize, x: f64| x * scaling.scale[k] + scaling.offset[k];
        let (x, origin) = (self.tensor("samples.x"), self.tensor("samples.origin"));
        let rows = origin.len() / 2;
        let mut order: Vec<usize> = (0..l.samples).collect();
        order.sort_by(|&a, &b| {
            origin[a]
                .total_cmp(&origin[b])
                .then(origin[rows + a].total_cmp(&origin[rows + b]))
        });
        let input = |i: usize| {
            let block = &x[i / BLOCK * n * BLOCK..];
            (0..n)
                .map(|k| raw(k, block[k * BLOCK + i % BLOCK]))
                .collect()
        };
        let regression = self.view().gpr().map(|gpr| Regression {
            x: (0..l.gpr_samples)
                .map(|i| {
                    let block = &gpr.x[i / LANES * n * LANES..];
                    (0..n)
                        .map(|k| raw(k, block[k * LANES + i % LANES] * gpr.length_scale[k]))
                        .collect()
                })
                .collect(),
            length_scale: gpr.length_scale.to_vec(),
            signal_variance: l.signal_variance,
            noise_variance: l.noise_variance,
            mean: gpr.mean[..l.outputs].to_vec(),
            lambda: gpr
                .lambda
                .chunks(gpr.mean.len())
                .take(l.gpr_samples)
                .map(|row| row[..l.outputs].to_vec())
                .collect(),
            output_scale: gpr.output_scale().map(<[f64]>::to_vec),
            cholesky: gpr
                .has_variance()
                .then(|| gpr.cholesky[..l.gpr_samples * (l.gpr_samples + 1) / 2].to_vec()),
        });
        Contents {
            task: *self.task(),
            offset: scaling.offset.to_vec(),
            scale: scaling.scale.to_vec(),
            x: order.iter().map(|&i| input(i)).collect(),
            y: order
                .iter()
                .map(|&i| self.tensor("samples.y")[i * l.outputs..][..l.outputs].to_vec())
                .collect(),
            trajectory: order.iter().map(|&i| origin[i] as u32).collect(),
            step: order.iter().map(|&i| origin[rows + i] as u32).collect(),
            regression,
            provenance: self.provenance(),
        }
    }
}
