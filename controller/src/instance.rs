//! One daemon per domain: a locked file names its process.
//!
//! The contract allows one publisher of twists in a domain and so refuses a second daemon too, but
//! it cannot name the first one.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;

/// Name of the file in the domain's directory.
pub const FILE: &str = "vpcd.pid";

/// Why the domain could not be claimed.
#[derive(Debug, thiserror::Error)]
pub enum InstanceError {
    /// Another daemon has it.
    #[error(
        "domain {directory}: another vpcd is at work, process {holder}; end it (also if it is stopped), or use another domain"
    )]
    Taken {
        /// The domain's directory.
        directory: String,
        /// Its process id, or why that is not known.
        holder: String,
    },
    /// The file cannot be used.
    #[error("{path}: cannot claim the domain: {source}")]
    File {
        /// Path of the file, as given.
        path: String,
        /// The operating system's reason.
        source: io::Error,
    },
}

/// The claim to a domain. The kernel ends it with the process, however that ends.
#[derive(Debug)]
pub struct Instance {
    file: File,
    /// The process that had the domain before, if it ended without giving it back.
    pub unclean: Option<String>,
}

impl Instance {
    /// Claims the domain in this directory, which exists, for the calling process.
    ///
    /// # Errors
    /// [`InstanceError::Taken`] names the process that has it.
    pub fn claim(directory: &Path) -> Result<Self, InstanceError> {
        let path = directory.join(FILE);
        let trouble = |source| InstanceError::File {
            path: path.display().to_string(),
            source,
        };
        let mut file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .mode(0o600)
            .open(&path)
            .map_err(trouble)?;
        match file.try_lock() {
            Ok(()) => (),
            Err(TryLockError::WouldBlock) => {
                return Err(InstanceError::Taken {
                    directory: directory.display().to_string(),
                    holder: holder(&mut file),
                });
            }
            Err(TryLockError::Error(source)) => return Err(trouble(source)),
        }
        // Anything at all was left by an unclean end.
        let mut left = [0; 32];
        let count = file.read_at(&mut left, 0).map_err(trouble)?;
        let left = String::from_utf8_lossy(&left[..count]).trim().to_owned();
        let unclean = (count > 0).then_some(left);
        file.set_len(0)
            .and_then(|()| writeln!(file, "{}", std::process::id()))
            .map_err(trouble)?;
        Ok(Self { file, unclean })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // After a panic the next one is to know that this end was not clean.
        if std::thread::panicking() {
            return;
        }
        // The file stays, since removing it could race with who locks it; empty, it names nobody.
        let _ = self.file.set_len(0);
    }
}

fn holder(file: &mut File) -> String {
    let mut text = String::new();
    match file.take(32).read_to_string(&mut text) {
        Ok(_) if !text.trim().is_empty() => text.trim().to_owned(),
        _ => "unknown (it is just starting)".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claimed_domain_names_its_process_until_the_claim_is_dropped() {
        let directory = tempfile::tempdir().unwrap();
        let first = Instance::claim(directory.path()).unwrap();
        let message = Instance::claim(directory.path()).unwrap_err().to_string();
        let us = format!("process {};", std::process::id());
        assert!(message.contains(&us), "{message}");
        drop(first);
        let next = Instance::claim(directory.path()).unwrap();
        assert_eq!(next.unclean, None);
        drop(next);
        let left = std::fs::read_to_string(directory.path().join(FILE)).unwrap();
        assert_eq!(left, "");
    }

    #[test]
    fn what_a_killed_daemon_wrote_is_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join(FILE);
        std::fs::write(&file, "99999999999\n").unwrap();
        let claim = Instance::claim(directory.path()).unwrap();
        assert_eq!(claim.unclean.as_deref(), Some("99999999999"));
        let written = std::fs::read_to_string(&file).unwrap();
        assert_eq!(written, format!("{}\n", std::process::id()));
    }

    #[test]
    fn a_file_that_cannot_be_used_is_named() {
        let directory = tempfile::tempdir().unwrap();
        std::fs::create_dir(directory.path().join(FILE)).unwrap();
        let error = Instance::claim(directory.path()).unwrap_err();
        assert!(error.to_string().contains(FILE), "{error}");
    }
}
