//! The workspace of a solver: one slice of numbers, lent by the caller and cut into arrays.

/// What is left of a workspace to cut arrays from.
pub(crate) struct Workspace<'w>(pub &'w mut [f64]);

impl<'w> Workspace<'w> {
    /// Cuts off `count` numbers; `None` if fewer are left.
    pub fn numbers(&mut self, count: usize) -> Option<&'w mut [f64]> {
        let (cut, left) = core::mem::take(&mut self.0).split_at_mut_checked(count)?;
        self.0 = left;
        Some(cut)
    }

    /// Cuts off `count` arrays of `N` numbers; `None` if fewer are left.
    pub fn arrays<const N: usize>(&mut self, count: usize) -> Option<&'w mut [[f64; N]]> {
        let (arrays, _) = self.numbers(count * N)?.as_chunks_mut();
        Some(arrays)
    }
}
