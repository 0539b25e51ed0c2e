//! What the daemon leaves in its domain while it runs: scene, masks and configuration, for viewers
//! and recorders.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Component, Path, PathBuf};

use ipc::{CONFIG_FILE, SCENE_FILE};
use scene::{FileError, SceneFiles};
use toml_schema::{Difference, Document};
use tracing::warn;

/// The files, in directories of their own that are removed with this. What a killed daemon left is
/// overwritten.
#[derive(Debug)]
pub struct Published([PathBuf; 2]);

impl Published {
    /// Writes scene, masks and configuration into the domain. Each file is whole at any time, and
    /// the scene comes last. Only the user may read them.
    ///
    /// # Errors
    /// If a file cannot be written, or a file has a name that leads out of the directory.
    pub fn write(files: &SceneFiles, config: &str, domain: &Path) -> io::Result<Self> {
        let (scene, configuration) = (domain.join(SCENE_FILE), domain.join(CONFIG_FILE));
        let directory = |file: &Path| file.parent().unwrap_or(domain).to_owned();
        let published = Self([directory(&scene), directory(&configuration)]);
        replace(&configuration, config.as_bytes())?;
        for (name, bytes) in &files.beside {
            let mut parts = Path::new(name).components();
            if !parts.all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
                return Err(io::Error::other(format!(
                    "scene: file {name}; allowed: a path below the directory of the scene"
                )));
            }
            replace(&directory(&scene).join(name), bytes)?;
        }
        replace(&scene, files.text.as_bytes())?;
        Ok(published)
    }

    /// Leaves them to the daemon that begins again.
    pub fn leave(self) {
        std::mem::forget(self);
    }
}

impl Drop for Published {
    fn drop(&mut self) {
        for directory in &self.0 {
            // What stays is overwritten by the next daemon.
            let _ = fs::remove_dir_all(directory);
        }
    }
}

/// Warns of each key that the daemon before had otherwise, as it left them in the domain, but for
/// the goal and the region of starts.
pub fn warn_of_changes(domain: &Path, files: &SceneFiles, config: &str) {
    match changes(domain, files, config) {
        Ok(changes) => changes
            .iter()
            .for_each(|change| warn!("begins again with another {change}")),
        Err(error) => warn!(%error, "begins again; what has changed is unknown: {error}"),
    }
}

fn changes(domain: &Path, files: &SceneFiles, config: &str) -> Result<Vec<Difference>, FileError> {
    let before = SceneFiles::read(&domain.join(SCENE_FILE))?;
    let mut changes = before.differences(files);
    let before = Document::read(Some(&domain.join(CONFIG_FILE)))?;
    changes.extend(before.differences(&Document::parse(config, CONFIG_FILE)?));
    Ok(changes)
}

fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(directory) = path.parent() {
        DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(directory)?;
    }
    program::publish(path, bytes, 0o600)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_again_masks_and_all() {
        let place = tempfile::tempdir().unwrap();
        let mask = place.path().join("drawn.png");
        let covered = |u, v| (300..340).contains(&u) && (200..240).contains(&v);
        scene::write_mask(&mask, 1024, 1024, covered).unwrap();
        let png = fs::read(mask).unwrap();
        let text = format!(
            "{}\n[[occlusion]]\nname = 'bush'\nmask = 'masks/bush.png'\n",
            scene::PAPER_SIM
        );
        let files = SceneFiles::parse(text, "s.toml", &|_| Ok(png.clone())).unwrap();
        let write = || Published::write(&files, "[law]", place.path()).unwrap();
        // Left by a daemon that was killed.
        std::mem::forget(write());
        let published = write();
        let (scene, config) = (
            place.path().join(SCENE_FILE),
            place.path().join(CONFIG_FILE),
        );
        let read = SceneFiles::read(&scene).unwrap();
        assert_eq!(read.scene.fingerprint(), files.scene.fingerprint());
        assert_eq!((&read.text, &read.beside), (&files.text, &files.beside));
        assert_eq!(fs::read_to_string(&config).unwrap(), "[law]");
        drop(published);
        assert!(!scene.exists() && !config.exists());
    }

    #[test]
    fn no_file_is_written_outside_the_directory() {
        let place = tempfile::tempdir().unwrap();
        let mut files =
            SceneFiles::parse(scene::PAPER_SIM.to_owned(), "s", &|_| Ok(vec![])).unwrap();
        files.beside.insert("../up.png".to_owned(), vec![1]);
        let error = Published::write(&files, "", place.path()).unwrap_err();
        assert!(error.to_string().contains("file ../up.png"), "{error}");
        assert!(!place.path().join("up.png").exists());
    }
}
