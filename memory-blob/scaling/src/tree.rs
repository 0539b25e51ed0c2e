//! The blocks of a memory under a tree of boxes instead of one level of groups: exact, or within a
//! factor of the nearest distance.

/// Samples in a leaf, as in a block of the file.
const LEAF: usize = 32;
/// Children of a node.
const FAN: usize = 8;

/// A tree over rows that are in the order of a k-d tree, as those of a memory.
pub struct Tree<const N: usize> {
    rows: Vec<[f64; N]>,
    /// Boxes (lows, highs) of each level, leaves first.
    levels: Vec<Vec<[[f64; N]; 2]>>,
}

impl<const N: usize> Tree<N> {
    /// The tree over some rows.
    pub fn over(rows: Vec<[f64; N]>) -> Self {
        let leaves = rows.chunks(LEAF).map(|rows| {
            let corner = |pick: fn(f64, f64) -> f64| {
                std::array::from_fn(|k| rows.iter().map(|x| x[k]).reduce(pick).unwrap_or(0.0))
            };
            [corner(f64::min), corner(f64::max)]
        });
        let mut levels: Vec<Vec<[[f64; N]; 2]>> = vec![leaves.collect()];
        while let Some(below) = levels.last().filter(|level| level.len() > FAN) {
            let above = below.chunks(FAN).map(|boxes| {
                let corner = |side: usize, pick: fn(f64, f64) -> f64| {
                    let of = |k: usize| boxes.iter().map(|b| b[side][k]).reduce(pick);
                    std::array::from_fn(|k| of(k).unwrap_or(0.0))
                };
                [corner(0, f64::min), corner(1, f64::max)]
            });
            let above = above.collect();
            levels.push(above);
        }
        Self { rows, levels }
    }

    /// Index and squared distance of a sample that is at most `1 + slack` times as far as the nearest.
    pub fn nearest(&self, query: &[f64; N], slack: f64) -> (usize, f64) {
        let mut best = (usize::MAX, f64::INFINITY);
        let top = self.levels.len() - 1;
        let nodes = 0..self.levels[top].len();
        self.visit(top, nodes, query, (1.0 + slack).powi(2), &mut best);
        best
    }

    /// Visits nodes of a level, at most [`FAN`], the nearest first.
    fn visit(
        &self,
        level: usize,
        nodes: std::ops::Range<usize>,
        query: &[f64; N],
        factor: f64,
        best: &mut (usize, f64),
    ) {
        let mut order = [(f64::INFINITY, usize::MAX); FAN];
        let count = nodes.len();
        for (place, node) in order.iter_mut().zip(nodes) {
            *place = (bound(&self.levels[level][node], query), node);
        }
        order[..count].sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        for (bound, node) in &order[..count] {
            if bound * factor > best.1 {
                return;
            }
            if level > 0 {
                let end = (FAN * (node + 1)).min(self.levels[level - 1].len());
                self.visit(level - 1, FAN * node..end, query, factor, best);
                continue;
            }
            let begin = LEAF * node;
            let end = (begin + LEAF).min(self.rows.len());
            for (i, row) in (begin..).zip(&self.rows[begin..end]) {
                let square: f64 = row.iter().zip(query).map(|(x, q)| (x - q) * (x - q)).sum();
                if square < best.1 {
                    *best = (i, square);
                }
            }
        }
    }
}

/// Square of the distance from a point to a box.
fn bound<const N: usize>([low, high]: &[[f64; N]; 2], query: &[f64; N]) -> f64 {
    let gaps = (0..N).map(|k| (low[k] - query[k]).max(query[k] - high[k]).max(0.0));
    gaps.map(|gap| gap * gap).sum()
}
