//! A scene together with the files that it was read from, so that recordings and viewers get the
//! same ones.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use sha2::{Digest, Sha256};
use toml_schema::FileError;

use crate::Scene;
use crate::file::read_beside;

/// A scene with its files, as they were read: one may be painted over meanwhile.
#[derive(Clone, Debug)]
pub struct SceneFiles {
    /// The scene.
    pub scene: Scene,
    /// The path of the scene file.
    pub path: String,
    /// The scene file.
    pub text: String,
    /// The files beside it, by the names that it gives them: masks (PNG), the arm (TOML) and its
    /// URDF.
    pub beside: BTreeMap<String, Vec<u8>>,
}

impl SceneFiles {
    /// Reads a scene file and the files that it names.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let name = path.display().to_string();
        let text = toml_schema::read_text(path)?;
        let directory = path.parent().unwrap_or(Path::new(""));
        Self::parse(text, &name, &|name| read_beside(&directory.join(name)))
    }

    /// Parses the text of a scene file; `path` is for messages, and `beside` returns the file of a
    /// name in the text.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn parse(
        text: String,
        path: &str,
        beside: &dyn Fn(&str) -> io::Result<Vec<u8>>,
    ) -> Result<Self, FileError> {
        let files = RefCell::new(BTreeMap::new());
        let scene = Scene::parse_with(&text, path, &|name| {
            let bytes = beside(name)?;
            files.borrow_mut().insert(name.to_owned(), bytes.clone());
            Ok(bytes)
        })?;
        Ok(Self {
            scene,
            path: path.to_owned(),
            text,
            beside: files.into_inner(),
        })
    }

    /// SHA-256 of the scene file and those beside it, 64 hexadecimal digits. Unlike the
    /// fingerprint, which is the task's, it changes with every byte.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        let mut put = |bytes: &[u8]| {
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        };
        put(self.text.as_bytes());
        for (name, bytes) in &self.beside {
            put(name.as_bytes());
            put(bytes);
        }
        let digest: [u8; 32] = hash.finalize().into();
        digest.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}
