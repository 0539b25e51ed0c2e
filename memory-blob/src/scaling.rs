//! The scaling of inputs.

use crate::{MAX_INPUTS, QueryError};

/// The scaling of inputs before any distance: (x - offset) / scale, entry by entry.
#[derive(Clone, Copy, Debug)]
pub struct Scaling<'a> {
    /// Offsets, in the units of the inputs.
    pub offset: &'a [f64],
    /// Scales, in the units of the inputs, above zero.
    pub scale: &'a [f64],
}

impl Scaling<'_> {
    /// Scales a raw input; entries past the input's length are zero.
    ///
    /// # Errors
    /// [`QueryError`] if the length is wrong or an entry is not finite.
    pub fn apply(&self, input: &[f64]) -> Result<[f64; MAX_INPUTS], QueryError> {
        let expected = self.scale.len();
        if input.len() != expected || expected > MAX_INPUTS {
            return Err(QueryError::InputLength {
                found: input.len(),
                expected,
            });
        }
        let mut scaled = [0.0; MAX_INPUTS];
        for (index, (scaled, x)) in scaled.iter_mut().zip(input).enumerate() {
            if !x.is_finite() {
                return Err(QueryError::NotFinite { index });
            }
            *scaled = (x - self.offset[index]) / self.scale[index];
        }
        Ok(scaled)
    }
}
