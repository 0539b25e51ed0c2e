//! Files that are replaced atomically.

use std::ffi::OsString;
use std::fs::{self, File, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use tempfile::{Builder, NamedTempFile};

/// Permissions of any new file, less the user's mask.
const ANYONE: u32 = 0o666;

/// Puts `bytes` in the place of the file at `path`, whose directory is made if it is missing. At
/// every moment, also after a power cut, the path holds the old file or the new one, whole: the new
/// one is written beside it and synchronised before it is renamed, and the directory, which holds
/// the name, is synchronised after. Of several that write the same path at once the last one
/// stands.
///
/// # Errors
/// The operating system's.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let directory = directory(path);
    fs::create_dir_all(directory)?;
    let beside = beside(path, bytes, ANYONE)?;
    beside.as_file().sync_all()?;
    beside.persist(path).map_err(|error| error.error)?;
    File::open(directory)?.sync_all()
}

/// Puts `bytes` in the place of the file at `path`, for processes that read it meanwhile: they find
/// the old file or the new one. Nothing is synchronised to the disk, and the directory must exist.
/// `mode` has the permissions of the file, less the user's mask.
///
/// # Errors
/// The operating system's.
pub fn publish(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    let beside = beside(path, bytes, mode)?;
    beside.persist(path).map_err(|error| error.error)?;
    Ok(())
}

fn directory(path: &Path) -> &Path {
    path.parent()
        .filter(|directory| !directory.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// A file in the same directory with these bytes.
fn beside(path: &Path, bytes: &[u8], mode: u32) -> io::Result<NamedTempFile> {
    // The name that a killed writer leaves contains the name of the file, and `FILE*` does not
    // match it.
    let mut prefix = OsString::from(".");
    prefix.push(path.file_name().unwrap_or_default());
    prefix.push(".");
    let mut beside = Builder::new()
        .prefix(&prefix)
        .suffix(".tmp")
        .permissions(Permissions::from_mode(mode))
        .tempfile_in(directory(path))?;
    beside.write_all(bytes)?;
    Ok(beside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::MetadataExt;
    use tempfile::TempDir;

    fn names(directory: &Path) -> Vec<String> {
        let names = fs::read_dir(directory).unwrap();
        names
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn the_new_file_replaces_the_old_one_and_leaves_nothing() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("deeper/file");
        replace(&path, b"old").unwrap();
        replace(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(path.parent().unwrap()), ["file"]);
    }

    #[test]
    fn a_name_taken_by_a_directory_stays() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("file");
        fs::create_dir_all(path.join("inside")).unwrap();
        replace(&path, b"new").unwrap_err();
        assert_eq!(names(directory.path()), ["file"]);
    }

    #[test]
    fn the_file_may_be_read_by_whom_any_new_file_may_be_read() {
        let directory = TempDir::new().unwrap();
        let [ours, any] = ["ours", "any"].map(|name| directory.path().join(name));
        replace(&ours, b"new").unwrap();
        fs::write(&any, b"new").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().mode();
        assert_eq!(mode(&ours), mode(&any));
    }

    #[test]
    fn a_published_file_has_its_mode_and_replaces_the_old_one() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("file");
        fs::write(&path, b"old").unwrap();
        publish(&path, b"new", 0o600).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o600);
        assert_eq!(names(directory.path()), ["file"]);
        publish(&directory.path().join("no/file"), b"new", 0o600).unwrap_err();
    }

    #[test]
    fn writers_of_one_path_do_not_disturb_each_other() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("file");
        std::thread::scope(|scope| {
            for byte in 0..4 {
                let path = &path;
                scope.spawn(move || {
                    for _ in 0..50 {
                        replace(path, &[byte; 1000]).unwrap();
                    }
                });
            }
        });
        let found = fs::read(&path).unwrap();
        assert_eq!(found, [found[0]; 1000]);
        assert_eq!(names(directory.path()), ["file"]);
    }
}
