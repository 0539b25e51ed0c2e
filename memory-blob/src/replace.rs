//! Replaces a file atomically.

use std::ffi::OsString;
use std::fs::{self, File, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile, PersistError};

/// Puts `bytes` in the place of the file at `path`, whose directory is made if it is missing. At
/// every moment, also after a power cut, the path holds the old file or the new one, whole: the new
/// one is written beside it and synchronised before it is renamed, and the directory, which holds
/// the name, is synchronised after. Of several that write the same path at once the last one
/// stands.
///
/// # Errors
/// The operating system's.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    put(path, bytes, |beside| beside.persist(path))
}

/// Like [`replace`] where there is no file yet. Of several that create the same path at once the
/// first one succeeds.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if there is a file, which stays; the operating system's.
pub fn create(path: &Path, bytes: &[u8]) -> io::Result<()> {
    put(path, bytes, |beside| beside.persist_noclobber(path))
}

/// Whether there is a file at `path` and it is one of `files`, also if they name it otherwise.
pub fn is_among(path: &Path, files: &[PathBuf]) -> bool {
    let mut files = files.iter().filter_map(|file| file.canonicalize().ok());
    path.canonicalize()
        .is_ok_and(|path| files.any(|file| file == path))
}

/// Writes a file beside `path`, and gives it that name by `persist`.
fn put(
    path: &Path,
    bytes: &[u8],
    persist: impl FnOnce(NamedTempFile) -> Result<File, PersistError>,
) -> io::Result<()> {
    let directory = path
        .parent()
        .filter(|directory| !directory.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    fs::create_dir_all(directory)?;
    // What a killed writer leaves says whose it was, and `FILE*` does not match it.
    let mut prefix = OsString::from(".");
    prefix.push(path.file_name().unwrap_or_default());
    prefix.push(".");
    let mut beside = Builder::new()
        .prefix(&prefix)
        .suffix(".tmp")
        .permissions(Permissions::from_mode(0o666)) // less the user's mask, as of any new file
        .tempfile_in(directory)?;
    beside.write_all(bytes)?;
    beside.as_file().sync_all()?;
    persist(beside).map_err(|error| error.error)?;
    File::open(directory)?.sync_all()
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
    fn the_new_file_takes_the_place_of_the_old_one_and_nothing_else_is_left() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("deeper/file");
        replace(&path, b"old").unwrap();
        replace(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(path.parent().unwrap()), ["file"]);
    }

    #[test]
    fn where_the_name_is_taken_by_a_directory_it_stays_and_nothing_is_left_beside_it() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("file");
        fs::create_dir_all(path.join("inside")).unwrap();
        replace(&path, b"new").unwrap_err();
        assert_eq!(names(directory.path()), ["file"]);
    }

    #[test]
    fn of_all_that_create_one_path_the_first_succeeds_and_its_file_stays() {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("file");
        let created: Vec<_> = std::thread::scope(|scope| {
            let create = |byte: u8| create(&path, &[byte; 1000]).map_err(|error| error.kind());
            let all: Vec<_> = (0..8)
                .map(|byte| scope.spawn(move || create(byte)))
                .collect();
            all.into_iter().map(|one| one.join().unwrap()).collect()
        });
        let first = created.iter().position(Result::is_ok).unwrap();
        assert_eq!(fs::read(&path).unwrap(), [first as u8; 1000]);
        let others = created
            .iter()
            .filter(|one| **one == Err(io::ErrorKind::AlreadyExists));
        assert_eq!(others.count(), 7);
        assert_eq!(names(directory.path()), ["file"]);
    }

    #[test]
    fn a_file_is_itself_by_any_name() {
        let directory = TempDir::new().unwrap();
        let [one, two, link] = ["one", "two", "link"].map(|name| directory.path().join(name));
        assert!(!is_among(&one, std::slice::from_ref(&one)), "there is none");
        for path in [&one, &two] {
            fs::write(path, "").unwrap();
        }
        std::os::unix::fs::symlink(&one, &link).unwrap();
        assert!(is_among(
            &directory.path().join("./one"),
            &[two.clone(), one.clone()]
        ));
        assert!(is_among(&one, std::slice::from_ref(&link)));
        assert!(is_among(&link, std::slice::from_ref(&one)));
        assert!(!is_among(&two, &[one, link]));
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
