//! The order of a k-d tree: samples that lie together are stored together.

use crate::samples::BLOCK;

/// Indices of the rows of `x` in the order of a k-d tree whose leaves are blocks: each range is
/// halved, at a multiple of a block, along the coordinate in which it is widest. Ties keep the
/// order of the rows.
pub(crate) fn kd_order(x: &[Vec<f64>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    let mut ranges = vec![(0, x.len())];
    while let Some((begin, end)) = ranges.pop() {
        if end - begin <= BLOCK {
            continue;
        }
        let rows = &mut order[begin..end];
        let spread = |k: usize| {
            let values = rows.iter().map(|&i| x[i][k]);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            values.fold(f64::NEG_INFINITY, f64::max) - low
        };
        let widest = (0..x[0].len())
            .max_by(|&a, &b| spread(a).total_cmp(&spread(b)).then(b.cmp(&a)))
            .unwrap_or(0);
        rows.sort_by(|&a, &b| x[a][widest].total_cmp(&x[b][widest]).then(a.cmp(&b)));
        let blocks = rows.len().div_ceil(BLOCK);
        let middle = begin + blocks.div_ceil(2) * BLOCK;
        ranges.extend([(begin, middle), (middle, end)]);
    }
    order
}

/// The box of some rows: lows, then highs.
pub(crate) fn bounding_box<'a>(
    rows: impl Iterator<Item = &'a Vec<f64>> + Clone,
    n: usize,
) -> Vec<f64> {
    let fold = |start: f64, pick: fn(f64, f64) -> f64| {
        let rows = rows.clone();
        (0..n)
            .map(move |k| rows.clone().map(|row| row[k]).fold(start, pick))
            .collect::<Vec<_>>()
    };
    [
        fold(f64::INFINITY, f64::min),
        fold(f64::NEG_INFINITY, f64::max),
    ]
    .concat()
}
