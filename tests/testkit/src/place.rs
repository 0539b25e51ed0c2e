use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use ipc::Domain;

/// A temporary directory for one test, with room for a domain.
///
/// When it is dropped, it removes what killed processes of the domain left in shared memory. Keep
/// it as the last field, behind everything that is at work in the domain.
#[derive(Debug)]
pub struct Place(tempfile::TempDir);

impl Place {
    /// A directory that only this user may enter.
    #[expect(
        clippy::new_without_default,
        reason = "has an effect on the file system"
    )]
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary directory"))
    }

    /// A directory that every user may enter.
    pub fn for_all_users() -> Self {
        let place = Self::new();
        let mode = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(place.directory(), mode).expect("our own directory");
        place
    }

    /// The directory.
    pub fn directory(&self) -> &Path {
        self.0.path()
    }

    /// The directory of the domain, which who joins it first makes.
    pub fn domain(&self) -> PathBuf {
        self.path("domain")
    }

    /// A path in the directory.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file into the directory; its path.
    pub fn file(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        path
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if self.domain().exists() {
            // A process that is alone in a domain removes what killed processes left.
            let _ = Domain::join(&self.domain());
        }
    }
}
