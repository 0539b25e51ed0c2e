//! Files that are generated from code, and the check that none of them is stale.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A file that is generated from code.
pub struct Generated<E> {
    /// Its path below the root of the repository.
    pub path: &'static str,
    /// Its new text, given the present one (empty if there is none).
    pub make: fn(present: &str) -> Result<String, E>,
}

/// Why a generated file is not up to date.
#[derive(Debug, Error)]
pub enum GeneratedError<E> {
    /// Its text cannot be made.
    #[error("{0}: cannot be made: {1:#}")]
    Make(&'static str, E),
    /// It cannot be written.
    #[error("{path}: cannot be written: {error}", path = .0.display(), error = .1)]
    Write(PathBuf, io::Error),
    /// Files that differ from their new text, each with its first such line.
    #[error("stale: {}; run cargo xtask codegen", .0.join(", "))]
    Stale(Vec<String>),
}

/// Writes the files below `root` whose text has changed, and prints their paths; writes none with
/// `check`.
///
/// # Errors
/// The text of a file cannot be made or written; with `check`, a file is stale.
pub fn update<E>(
    root: &Path,
    files: &[Generated<E>],
    check: bool,
) -> Result<(), GeneratedError<E>> {
    let mut stale = Vec::new();
    for Generated { path, make } in files {
        let file = root.join(path);
        let present = std::fs::read_to_string(&file).unwrap_or_default();
        let text = make(&present).map_err(|error| GeneratedError::Make(path, error))?;
        if text == present {
            continue;
        }
        if check {
            let lines = present.lines().zip(text.lines());
            let same = lines.take_while(|(old, new)| old == new).count();
            stale.push(format!("{path} (line {})", same + 1));
        } else {
            std::fs::write(&file, text).map_err(|error| GeneratedError::Write(file, error))?;
            println!("{path}: written");
        }
    }
    if stale.is_empty() {
        Ok(())
    } else {
        Err(GeneratedError::Stale(stale))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stale_file_is_named_with_its_line_and_written_once() {
        let root = std::env::temp_dir().join(format!("generated-{}", std::process::id()));
        std::fs::create_dir_all(&root).unwrap();
        std::fs::write(root.join("page"), "one\ntwo\n").unwrap();
        let files = [Generated::<String> {
            path: "page",
            make: |_| Ok("one\n2\n".to_owned()),
        }];
        let stale = update(&root, &files, true).unwrap_err().to_string();
        assert!(stale.contains("page (line 2)"), "{stale}");
        update(&root, &files, false).unwrap();
        update(&root, &files, true).unwrap();
        std::fs::remove_dir_all(&root).unwrap();
    }
}
