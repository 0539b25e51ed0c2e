//! The tensors of a memory, laid out as queries read them.

use std::collections::BTreeMap;

use crate::exp::LANES;
use crate::format::{FAR, round_up};
use crate::gpr::OUTPUT_LANES;
use crate::order::{bounding_box, kd_order};
use crate::samples::{BLOCK, BLOCKS_PER_GROUP};
use crate::{Contents, Regression};

/// Shape and numbers of each tensor.
pub(crate) type Tensors = BTreeMap<String, (Vec<usize>, Vec<f64>)>;

/// The scaling, and the samples in blocks of neighbours.
pub(crate) fn of_samples(contents: &Contents) -> Tensors {
    let (n, p, count) = (contents.scale.len(), contents.y[0].len(), contents.x.len());
    let n8 = round_up(n, 8);
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
    let blocks = count.div_ceil(BLOCK);
    let blocks4 = round_up(blocks, 4);
    let groups4 = round_up(blocks.div_ceil(BLOCKS_PER_GROUP), 4);
    let y: Vec<f64> = order
        .iter()
        .flat_map(|&i| contents.y[i].iter().copied())
        .collect();
    let origin = |of: &[u32]| {
        let values: Vec<f64> = order.iter().map(|&i| f64::from(of[i])).collect();
        padded(&values, blocks * BLOCK, 0.0)
    };
    let scaling = [
        padded(&contents.offset, n8, 0.0),
        padded(&contents.scale, n8, 1.0),
    ];
    let origins = [origin(&contents.trajectory), origin(&contents.step)];
    let (y_length, box_length) = (blocks * BLOCK * p, 2 * n);
    named([
        ("scaling", vec![2, n8], scaling.concat()),
        ("samples.x", vec![blocks, n, BLOCK], x),
        (
            "samples.y",
            vec![blocks * BLOCK, p],
            padded(&y, y_length, 0.0),
        ),
        (
            "samples.boxes",
            vec![blocks4, 2, n],
            padded(&boxes, blocks4 * box_length, FAR),
        ),
        (
            "samples.groups",
            vec![groups4, 2, n],
            padded(&groups, groups4 * box_length, FAR),
        ),
        ("samples.origin", vec![2, blocks * BLOCK], origins.concat()),
    ])
    .collect()
}

/// The Gaussian process.
pub(crate) fn of_process(contents: &Contents, r: &Regression) -> Tensors {
    let (n, p) = (contents.scale.len(), r.mean.len());
    let (n8, p8) = (round_up(n, 8), round_up(p, OUTPUT_LANES));
    let mut x = Vec::new();
    for block in scaled(contents, &r.x).chunks(LANES) {
        let over_length = |k: usize| block.iter().map(move |row| row[k] / r.length_scale[k]);
        (0..n).for_each(|k| x.extend(padded(&over_length(k).collect::<Vec<_>>(), LANES, FAR)));
    }
    let blocks = r.x.len().div_ceil(LANES);
    let rows = r.lambda.iter().flat_map(|row| padded(row, p8, 0.0));
    let lambda = padded(&rows.collect::<Vec<_>>(), blocks * LANES * p8, 0.0);
    let lengths = padded(&r.length_scale, n8, 1.0);
    let output_scale = r
        .output_scale
        .as_ref()
        .map(|scale| ("gpr.output_scale", vec![p8], padded(scale, p8, 1.0)));
    let cholesky = r.cholesky.as_ref().map(|factor| {
        let length = round_up(factor.len(), 8);
        ("gpr.cholesky", vec![length], padded(factor, length, 0.0))
    });
    named([
        ("gpr.x", vec![blocks, n, LANES], x),
        ("gpr.lambda", vec![blocks * LANES, p8], lambda),
        ("gpr.length_scale", vec![n8], lengths),
        ("gpr.mean", vec![p8], padded(&r.mean, p8, 0.0)),
    ])
    .chain(named(output_scale))
    .chain(named(cholesky))
    .collect()
}

fn named(
    tensors: impl IntoIterator<Item = (&'static str, Vec<usize>, Vec<f64>)>,
) -> impl Iterator<Item = (String, (Vec<usize>, Vec<f64>))> {
    tensors
        .into_iter()
        .map(|(name, shape, data)| (name.to_owned(), (shape, data)))
}

fn scaled(contents: &Contents, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let scale = |row: &Vec<f64>| {
        row.iter()
            .zip(contents.offset.iter().zip(&contents.scale))
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
