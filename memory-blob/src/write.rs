//! Writes contents to a file.

use std::path::Path;

use crate::draft::Draft;
use crate::{Contents, WriteError};

impl Contents {
    /// Writes the memory to `path`: to a temporary file in its directory, synchronized, then
    /// renamed, and the directory synchronized, so that no reader sees half a file and a power cut
    /// leaves the old file or the new one. The same contents give the same bytes.
    ///
    /// # Errors
    /// [`WriteError`] if the contents contradict themselves or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        program::replace(path, &Draft::of(self)?.bytes()).map_err(|source| WriteError::Write {
            path: path.display().to_string(),
            source,
        })
    }
}
