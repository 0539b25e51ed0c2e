//! The samples of a memory, and the search for nearest neighbours.
//!
//! Samples are stored in the order of a k-d tree, 32 to a block, each block with its bounding box,
//! and 16 blocks to a group with one of its own. A search visits groups and blocks by their lower
//! bounds and skips what cannot hold a nearer sample. So the answer is that of an exhaustive
//! search, at a small part of the work.

use crate::scaling::Scaling;
use crate::{MAX_INPUTS, MAX_NEIGHBOURS, QueryError};

/// Samples in a block.
pub const BLOCK: usize = 32;
/// Blocks in a group.
pub const BLOCKS_PER_GROUP: usize = 16;

/// A borrowed view of the samples.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    pub(crate) scaling: Scaling<'a>,
    pub(crate) count: usize,
    pub(crate) outputs: usize,
    /// Scaled inputs, [blocks, inputs, BLOCK].
    pub(crate) x: &'a [f64],
    /// Raw outputs, [blocks * BLOCK, outputs].
    pub(crate) y: &'a [f64],
    /// The trajectory of each sample, [blocks * BLOCK], and then its control period there.
    pub(crate) origin: &'a [f64],
    /// Cost of the rest of each sample's trajectory, [blocks * BLOCK].
    pub(crate) cost_to_go: &'a [f64],
    /// Boxes of the blocks, [blocks, 2, inputs]: lows, then highs.
    pub(crate) boxes: &'a [f64],
    /// Boxes of the groups, [groups, 2, inputs].
    pub(crate) groups: &'a [f64],
}

/// The nearest samples of a query, nearest first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    count: usize,
    index: [usize; MAX_NEIGHBOURS],
    square: [f64; MAX_NEIGHBOURS],
}

impl Nearest {
    fn new(count: usize) -> Self {
        Self {
            count,
            index: [usize::MAX; MAX_NEIGHBOURS],
            square: [f64::INFINITY; MAX_NEIGHBOURS],
        }
    }

    /// Indices of the samples in the order of the file; ties go to the smaller index.
    pub fn indices(&self) -> &[usize] {
        &self.index[..self.count]
    }

    /// Distance of the nearest sample, in scaled inputs.
    pub fn distance(&self) -> f64 {
        libm::sqrt(self.square[0])
    }

    fn worst(&self) -> f64 {
        self.square[self.count - 1]
    }

    fn offer(&mut self, index: usize, square: f64) {
        let before = |i: usize, s: f64| square < s || (square == s && index < i);
        let last = self.count - 1;
        if !before(self.index[last], self.square[last]) {
            return;
        }
        let mut place = last;
        while place > 0 && before(self.index[place - 1], self.square[place - 1]) {
            self.index[place] = self.index[place - 1];
            self.square[place] = self.square[place - 1];
            place -= 1;
        }
        (self.index[place], self.square[place]) = (index, square);
    }
}

impl<'a> Samples<'a> {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Entries of an input.
    pub fn inputs(&self) -> usize {
        self.scaling.scale.len()
    }

    /// Entries of an output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The scaling of inputs.
    pub fn scaling(&self) -> Scaling<'a> {
        self.scaling
    }

    /// The raw output of a sample.
    pub fn output(&self, index: usize) -> &'a [f64] {
        &self.y[index * self.outputs..][..self.outputs]
    }

    /// Cost of the rest of its trajectory from a sample on: the sum of l(v) / Np over its control
    /// periods.
    pub fn cost_to_go(&self, index: usize) -> f64 {
        self.cost_to_go[index]
    }

    /// The trajectory of a sample, and the control period in it.
    pub fn origin(&self, index: usize) -> [u32; 2] {
        let (trajectory, period) = self.origin.split_at(self.origin.len() / 2);
        [trajectory[index], period[index]].map(|x| x as u32)
    }

    /// Calls `visit` for each sample of a trajectory from a sample on, that one too, in the order of
    /// the file: with the control periods between the two, and its index. Looks at all samples.
    pub fn rest(&self, index: usize, mut visit: impl FnMut(u32, usize)) {
        let [of, from] = self.origin(index);
        let (trajectories, periods) = self.origin.split_at(self.origin.len() / 2);
        let pairs = trajectories.iter().zip(periods).take(self.count);
        for (other, (&trajectory, &period)) in pairs.enumerate() {
            if trajectory as u32 == of && period as u32 >= from {
                visit(period as u32 - from, other);
            }
        }
    }

    /// Writes the raw input of a sample.
    ///
    /// # Errors
    /// [`QueryError`] if the length is wrong.
    pub fn input(&self, index: usize, input: &mut [f64]) -> Result<(), QueryError> {
        let (n, found) = (self.inputs(), input.len());
        if found != n {
            return Err(QueryError::InputLength { found, expected: n });
        }
        let Scaling { offset, scale } = self.scaling;
        for (k, x) in input.iter_mut().enumerate() {
            *x = self.scaled(index, k) * scale[k] + offset[k];
        }
        Ok(())
    }

    /// Entry `k` of the scaled input of a sample.
    pub(crate) fn scaled(&self, index: usize, k: usize) -> f64 {
        self.x[(index / BLOCK * self.inputs() + k) * BLOCK + index % BLOCK]
    }

    /// Writes the mean output of the `k` nearest samples (Euclidean distance in scaled inputs) and
    /// tells which they are.
    ///
    /// Source: paper, Eq. (knn).
    ///
    /// # Errors
    /// [`QueryError`] if a length, `k` or an entry of the input is wrong.
    pub fn nearest(
        &self,
        input: &[f64],
        k: usize,
        output: &mut [f64],
    ) -> Result<Nearest, QueryError> {
        if output.len() != self.outputs {
            return Err(QueryError::OutputLength {
                found: output.len(),
                expected: self.outputs,
            });
        }
        let nearest = self.search(input, k)?;
        output.fill(0.0);
        for &index in nearest.indices() {
            output
                .iter_mut()
                .zip(self.output(index))
                .for_each(|(sum, y)| *sum += y);
        }
        output.iter_mut().for_each(|sum| *sum /= k as f64);
        Ok(nearest)
    }

    /// The `k` nearest samples of a raw input.
    ///
    /// # Errors
    /// As [`Samples::nearest`].
    pub fn search(&self, input: &[f64], k: usize) -> Result<Nearest, QueryError> {
        let most = MAX_NEIGHBOURS.min(self.count);
        if !(1..=most).contains(&k) {
            return Err(QueryError::Neighbours { found: k, most });
        }
        let query = self.scaling.apply(input)?;
        let n = self.inputs();
        let mut nearest = Nearest::new(k);
        // The group whose box is nearest first: after it, nearly everything else is out of reach.
        let bound =
            |boxes: &[f64], i: usize| lower_bound(&boxes[2 * n * i..][..2 * n], &query[..n]);
        let groups = self.groups.len() / (2 * n);
        let first = (0..groups)
            .map(|g| (bound(self.groups, g), g))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(0, |(_, g)| g);
        self.visit(first, &query, &mut nearest);
        for group in (0..groups).filter(|&g| g != first) {
            if bound(self.groups, group) <= nearest.worst() {
                self.visit(group, &query, &mut nearest);
            }
        }
        Ok(nearest)
    }

    fn visit(&self, group: usize, query: &[f64; MAX_INPUTS], nearest: &mut Nearest) {
        let n = self.inputs();
        let blocks = self.boxes.len() / (2 * n);
        let begin = group * BLOCKS_PER_GROUP;
        let end = (begin + BLOCKS_PER_GROUP).min(blocks);
        let mut bounds = [0.0; BLOCKS_PER_GROUP];
        let mut first = 0;
        for b in 0..end - begin {
            bounds[b] = lower_bound(&self.boxes[2 * n * (begin + b)..][..2 * n], &query[..n]);
            if bounds[b] < bounds[first] {
                first = b;
            }
        }
        self.scan(begin + first, query, nearest);
        for b in (0..end - begin).filter(|&b| b != first) {
            if bounds[b] <= nearest.worst() {
                self.scan(begin + b, query, nearest);
            }
        }
    }

    fn scan(&self, block: usize, query: &[f64; MAX_INPUTS], nearest: &mut Nearest) {
        let n = self.inputs();
        let rows = &self.x[block * n * BLOCK..][..n * BLOCK];
        let mut squares = [0.0; BLOCK];
        for (row, q) in rows.chunks_exact(BLOCK).zip(query) {
            for (square, x) in squares.iter_mut().zip(row) {
                *square += (x - q) * (x - q);
            }
        }
        let begin = block * BLOCK;
        for (i, &square) in squares
            .iter()
            .enumerate()
            .take(self.count.saturating_sub(begin))
        {
            if square <= nearest.worst() {
                nearest.offer(begin + i, square);
            }
        }
    }
}

/// Square of the distance from a point to a box: never more than that to a sample inside it.
fn lower_bound(limits: &[f64], query: &[f64]) -> f64 {
    let (low, high) = limits.split_at(query.len());
    query
        .iter()
        .zip(low.iter().zip(high))
        .map(|(q, (l, h))| {
            let gap = (l - q).max(q - h).max(0.0);
            gap * gap
        })
        .sum()
}
