//! Writes contents to a file.

use std::path::Path;

use crate::draft::Draft;
use crate::format::MOST_BYTES;
use crate::{Contents, WriteError};

impl Contents {
    /// Writes the memory to `path`: to a temporary file in its directory, synchronized, then
    /// renamed, and the directory synchronized, so that no reader sees half a file and a power cut
    /// leaves the old file or the new one. The same contents give the same bytes.
    ///
    /// # Errors
    /// [`WriteError`] if the contents contradict themselves or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        let bytes = Draft::of(self)?.bytes();
        if bytes.len() as u64 > MOST_BYTES {
            return Err(WriteError::Contents {
                what: "the size of the file",
                found: format!("{} bytes", bytes.len()),
                allowed: format!(
                    "up to {MOST_BYTES}: fewer trajectories, or fewer samples for regression"
                ),
            });
        }
        program::replace(path, &bytes).map_err(|source| WriteError::Write {
            path: path.display().to_string(),
            source,
        })
    }
}
