//! Checks of a file's numbers beyond their digests.

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
        let view = self.view();
        let samples = view.samples();
        positive("scaling: scale", samples.scaling().scale)?;
        if let Some(cost) = samples.cost_to_go.iter().find(|cost| **cost < 0.0) {
            return Err(format!(
                "samples.cost_to_go: {cost}; allowed: numbers from 0 on"
            ));
        }
        if let Some(gpr) = view.gpr() {
            positive("gpr.length_scale", gpr.length_scale)?;
            positive("gpr.output_scale", gpr.output_scale)?;
            let rows = 0..if gpr.has_variance() { gpr.count } else { 0 };
            let diagonal: Vec<f64> = rows.map(|i| gpr.cholesky[i * (i + 3) / 2]).collect();
            positive("gpr.cholesky: diagonal", &diagonal)?;
        }
        // A box that does not hold its samples would hide them from searches.
        let n = samples.inputs();
        for i in 0..samples.len() {
            let boxes = [
                ("boxes", samples.boxes, BLOCK),
                ("groups", samples.groups, BLOCK * BLOCKS_PER_GROUP),
            ];
            for (what, boxes, rows) in boxes {
                let (low, high) = boxes[i / rows * 2 * n..][..2 * n].split_at(n);
                if !(0..n).all(|k| (low[k]..=high[k]).contains(&samples.scaled(i, k))) {
                    return Err(format!(
                        "samples.{what}: sample {i} lies outside its box; allowed: inside"
                    ));
                }
            }
        }
        Ok(())
    }
}

fn positive(what: &str, values: &[f64]) -> Result<(), String> {
    match values.iter().find(|x| **x <= 0.0) {
        Some(x) => Err(format!("{what}: {x}; allowed: numbers above 0")),
        None => Ok(()),
    }
}
