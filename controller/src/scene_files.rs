//! A scene together with the files that it was read from, so that records and viewers get the same
//! ones.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Component, Path, PathBuf};

use scene::{FileError, Scene};

/// A scene with its files.
#[derive(Clone, Debug)]
#[allow(missing_docs)]
pub struct SceneFiles {
    pub scene: Scene,
    /// The text of the scene file (TOML).
    pub text: String,
    /// Its masks (PNG), by the names that it gives them.
    pub masks: BTreeMap<String, Vec<u8>>,
}

impl SceneFiles {
    /// Reads a scene file and its masks.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let name = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|source| FileError::Read {
            path: name.clone(),
            source,
        })?;
        let directory = path.parent().unwrap_or(Path::new(""));
        Self::parse(text, &name, &|mask| fs::read(directory.join(mask)))
    }

    /// Parses the text of a scene file; `path` is for messages, and `mask` gives the bytes of a
    /// mask.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn parse(
        text: String,
        path: &str,
        mask: &dyn Fn(&str) -> io::Result<Vec<u8>>,
    ) -> Result<Self, FileError> {
        // Kept as they were read: the file may be painted over meanwhile.
        let masks = RefCell::new(BTreeMap::new());
        let scene = Scene::parse_with(&text, path, &|name| {
            let png = mask(name)?;
            masks.borrow_mut().insert(name.to_owned(), png.clone());
            Ok(png)
        })?;
        Ok(Self {
            scene,
            text,
            masks: masks.into_inner(),
        })
    }

    /// Writes the scene to `path` and its masks beside it, in place of what is there, until what
    /// is returned is dropped. Each file is whole at any time, and the scene comes last. Only the
    /// user may read them.
    ///
    /// # Errors
    /// If a file cannot be written, or a mask has a name that leads out of the directory.
    pub fn publish(&self, path: &Path) -> io::Result<PublishedScene> {
        let directory = path.parent().unwrap_or(Path::new(""));
        let published = PublishedScene(directory.to_owned());
        for (name, png) in &self.masks {
            let mut parts = Path::new(name).components();
            if !parts.all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
                return Err(io::Error::other(format!(
                    "mask = {name}; allowed: a path below the directory of the scene"
                )));
            }
            replace(&directory.join(name), png)?;
        }
        replace(path, self.text.as_bytes())?;
        Ok(published)
    }
}

/// A scene in a directory of its own, which is removed with this.
#[derive(Debug)]
pub struct PublishedScene(PathBuf);

impl Drop for PublishedScene {
    fn drop(&mut self) {
        // What stays is overwritten by the next one.
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(directory) = path.parent() {
        DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(directory)?;
    }
    let mut beside = path.as_os_str().to_owned();
    beside.push(".tmp");
    let mut how = OpenOptions::new();
    how.write(true).create(true).truncate(true).mode(0o600);
    how.open(&beside)?.write_all(bytes)?;
    fs::rename(&beside, path)
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
        let path = place.path().join("scene/scene.toml");
        // Left by a daemon that was killed.
        std::mem::forget(files.publish(&path).unwrap());
        let published = files.publish(&path).unwrap();
        let read = SceneFiles::read(&path).unwrap();
        assert_eq!(read.scene.fingerprint(), files.scene.fingerprint());
        assert_eq!((read.text, read.masks), (files.text, files.masks));
        drop(published);
        assert!(!path.exists());
    }

    #[test]
    fn no_mask_is_written_outside_the_directory() {
        let place = tempfile::tempdir().unwrap();
        let mut files =
            SceneFiles::parse(scene::PAPER_SIM.to_owned(), "s", &|_| Ok(vec![])).unwrap();
        files.masks.insert("../up.png".to_owned(), vec![1]);
        let error = files
            .publish(&place.path().join("in/scene.toml"))
            .unwrap_err();
        assert!(error.to_string().contains("mask = ../up.png"), "{error}");
        assert!(!place.path().join("up.png").exists());
    }
}
