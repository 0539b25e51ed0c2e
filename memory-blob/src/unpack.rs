//! From a file back to its [`Contents`].

use crate::exp::LANES;
use crate::{Contents, Gpr, MemoryFile, Regression};

impl MemoryFile {
    /// Everything in the file, as its maker knew it: samples in the order of trajectories and
    /// steps. Allocates; not for the control cycle.
    pub fn contents(&self) -> Contents {
        let view = self.view();
        let samples = view.samples();
        let mut order: Vec<usize> = (0..samples.len()).collect();
        order.sort_by_key(|&i| samples.origin(i));
        let [trajectory, step] =
            [0, 1].map(|k| order.iter().map(|&i| samples.origin(i)[k]).collect());
        let raw = |k: usize, x: f64| x * samples.scaling().scale[k] + samples.scaling().offset[k];
        let n = samples.inputs();
        let input = |&i: &usize| (0..n).map(|k| raw(k, samples.scaled(i, k))).collect();
        Contents {
            task: *self.task(),
            offset: samples.scaling().offset.to_vec(),
            scale: samples.scaling().scale.to_vec(),
            x: order.iter().map(input).collect(),
            y: order.iter().map(|&i| samples.output(i).to_vec()).collect(),
            trajectory,
            step,
            cost_to_go: order.iter().map(|&i| samples.cost_to_go(i)).collect(),
            regression: view.gpr().map(|gpr| self.regression(&gpr, raw)),
            provenance: self.provenance(),
        }
    }

    fn regression(&self, gpr: &Gpr<'_>, raw: impl Fn(usize, f64) -> f64) -> Regression {
        let (layout, n) = (self.layout(), gpr.length_scale.len());
        let input = |i: usize| {
            let block = &gpr.x[i / LANES * n * LANES..];
            let unscaled = |k: usize| block[k * LANES + i % LANES] * gpr.length_scale[k];
            (0..n).map(|k| raw(k, unscaled(k))).collect()
        };
        let rows = gpr.lambda.chunks(gpr.mean.len()).take(gpr.len());
        let factor = gpr.len() * (gpr.len() + 1) / 2;
        Regression {
            x: (0..gpr.len()).map(input).collect(),
            length_scale: gpr.length_scale.to_vec(),
            signal_variance: layout.signal_variance,
            noise_variance: layout.noise_variance,
            mean: gpr.mean[..gpr.outputs()].to_vec(),
            lambda: rows.map(|row| row[..gpr.outputs()].to_vec()).collect(),
            output_scale: gpr.output_scale.to_vec(),
            cholesky: gpr.has_variance().then(|| gpr.cholesky[..factor].to_vec()),
        }
    }
}
