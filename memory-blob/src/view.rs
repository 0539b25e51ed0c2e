//! A borrowed view of a memory.

use crate::{Gpr, Samples};

/// What a control cycle may query: samples by k-NN, and regression if the file has it.
#[derive(Clone, Copy, Debug)]
pub struct Memory<'a> {
    pub(crate) samples: Samples<'a>,
    pub(crate) gpr: Option<Gpr<'a>>,
}

impl<'a> Memory<'a> {
    /// The samples, for k-nearest-neighbour queries.
    pub fn samples(&self) -> Samples<'a> {
        self.samples
    }

    /// The Gaussian process, for regression queries.
    pub fn gpr(&self) -> Option<Gpr<'a>> {
        self.gpr
    }
}
