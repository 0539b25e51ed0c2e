//! The tensors of a memory, laid out as queries read them.

use std::collections::BTreeMap;

use crate::exp::LANES;
use crate::format::FAR;
use crate::layout::Layout;
use crate::order::{bounding_box, kd_order};
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::{Contents, Regression};

/// The numbers of each tensor.
pub(crate) type Tensors = BTreeMap<&'static str, Vec<f64>>;

/// The scaling, and the samples in blocks of neighbours.
pub(crate) fn of_samples(contents: &Contents, layout: &Layout) -> Tensors {
    let (n, (n8, _)) = (layout.inputs, layout.padded());
    let scaled = scaled(contents, &contents.x);
    let order = kd_order(&scaled);
    let (mut x, mut boxes, mut groups) = (Vec::new(), Vec::new(), Vec::new());
    for block in order.chunks(BLOCK) {
        let row = |k: usize| block.iter().map(|&i| scaled[i][k]).collect::<Vec<_>>();
        (0..n).for_each(|k| x.extend(padded(&row(k), BLOCK, FAR)));
        boxes.extend(bounding_box(block.iter().map(|&i| &scaled[i]), n));
    }
    for group in order.chunks(BLOCK * BLOCKS_PER_GROUP) {
        groups.extend(bounding_box(group.iter().map(|&i| &scaled[i]), n));
    }
    let rows = order.len().div_ceil(BLOCK) * BLOCK;
    let origin = |of: &[u32]| {
        let values: Vec<f64> = order.iter().map(|&i| f64::from(of[i])).collect();
        padded(&values, rows, 0.0)
    };
    let cost_to_go = order.iter().map(|&i| contents.cost_to_go[i]).collect();
    let y: Vec<f64> = order
        .iter()
        .flat_map(|&i| contents.y[i].iter().copied())
        .collect();
    let scaling = [
        padded(&contents.offset, n8, 0.0),
        padded(&contents.scale, n8, 1.0),
    ];
    filled(
        layout,
        [
            ("scaling", scaling.concat(), 0.0),
            ("samples.x", x, FAR),
            ("samples.y", y, 0.0),
            ("samples.cost_to_go", cost_to_go, 0.0),
            ("samples.boxes", boxes, FAR),
            ("samples.groups", groups, FAR),
            (
                "samples.origin",
                [origin(&contents.trajectory), origin(&contents.step)].concat(),
                0.0,
            ),
        ],
    )
}

/// The Gaussian process.
pub(crate) fn of_process(contents: &Contents, layout: &Layout, r: &Regression) -> Tensors {
    let (n, (_, p8)) = (layout.inputs, layout.padded());
    let mut x = Vec::new();
    for block in scaled(contents, &r.x).chunks(LANES) {
        let over_length = |k: usize| block.iter().map(move |row| row[k] / r.length_scale[k]);
        (0..n).for_each(|k| x.extend(padded(&over_length(k).collect::<Vec<_>>(), LANES, FAR)));
    }
    let lambda = r
        .lambda
        .iter()
        .flat_map(|row| padded(row, p8, 0.0))
        .collect();
    let mut tensors = filled(
        layout,
        [
            ("gpr.x", x, FAR),
            ("gpr.lambda", lambda, 0.0),
            ("gpr.length_scale", r.length_scale.clone(), 1.0),
            ("gpr.mean", r.mean.clone(), 0.0),
            ("gpr.output_scale", r.output_scale.clone(), 1.0),
        ],
    );
    if let Some(factor) = &r.cholesky {
        tensors.extend(filled(layout, [("gpr.cholesky", factor.clone(), 0.0)]));
    }
    tensors
}

/// Tensors, each filled up to its shape with a number.
pub(crate) fn filled<const N: usize>(
    layout: &Layout,
    tensors: [(&'static str, Vec<f64>, f64); N],
) -> Tensors {
    let shapes = layout.shapes();
    let fill = |(name, data, with): (_, Vec<f64>, f64)| {
        (name, padded(&data, shapes[name].iter().product(), with))
    };
    tensors.map(fill).into()
}

fn scaled(contents: &Contents, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let scale = |row: &Vec<f64>| {
        let scaling = contents.offset.iter().zip(&contents.scale);
        row.iter()
            .zip(scaling)
            .map(|(x, (o, s))| (x - o) / s)
            .collect()
    };
    rows.iter().map(scale).collect()
}

/// `data` followed by as many `with` as make it `length` long.
pub(crate) fn padded(data: &[f64], length: usize, with: f64) -> Vec<f64> {
    let mut data = data.to_vec();
    data.resize(length, with);
    data
}
