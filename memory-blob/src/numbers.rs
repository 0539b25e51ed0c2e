//! What every number of a file must keep, beyond its digest.

use crate::MemoryFile;
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};

impl MemoryFile {
    /// Finite numbers, positive scales, and boxes that hold their samples.
    pub(crate) fn verify_numbers(&self) -> Result<(), String> {
        for name in self.tensor_names() {
            if let Some(i) = self.tensor(name).iter().position(|x| !x.is_finite()) {
                return Err(format!(
                    "tensor {name}: element {i} is not finite; allowed: finite numbers"
                ));
            }
        }
        let positive = |what: &str, values: &[f64]| match values.iter().find(|x| **x <= 0.0) {
            Some(x) => Err(format!("{what}: {x}; allowed: numbers above 0")),
            None => Ok(()),
        };
        positive("scaling: scale", self.scaling().scale)?;
        let view = self.view();
        if let Some(gpr) = view.gpr() {
            positive("gpr.length_scale", gpr.length_scale)?;
            positive("gpr.output_scale", gpr.output_scale)?;
            let diagonal: Vec<f64> = (0..if gpr.has_variance() { gpr.count } else { 0 })
                .map(|i| gpr.cholesky[i * (i + 3) / 2])
                .collect();
            positive("gpr.cholesky: diagonal", &diagonal)?;
        }
        // A box that does not hold its samples would hide them from searches.
        let (l, x) = (self.layout(), self.tensor("samples.x"));
        for i in 0..l.samples {
            for k in 0..l.inputs {
                let value = x[(i / BLOCK * l.inputs + k) * BLOCK + i % BLOCK];
                for (what, rows) in [("boxes", BLOCK), ("groups", BLOCK * BLOCKS_PER_GROUP)] {
                    let limits =
                        &self.tensor(&format!("samples.{what}"))[i / rows * 2 * l.inputs..];
                    if !(limits[k]..=limits[l.inputs + k]).contains(&value) {
                        return Err(format!(
                            "samples.{what}: sample {i} lies outside its box; allowed: inside"
                        ));
                    }
                }
            }
        }
        Ok(())
    }
}
