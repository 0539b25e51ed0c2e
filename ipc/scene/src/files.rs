//! A scene together with the files that it was read from, so that recordings and viewers get the
//! same ones.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use sha2::{Digest, Sha256};
use toml_schema::{Difference, Document, FileError};

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
        Self::parse_at(toml_schema::read_text(path)?, path)
    }

    /// Parses the text of a scene file that is, or will be, at `path`, and reads the files that it
    /// names from there.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn parse_at(text: String, path: &Path) -> Result<Self, FileError> {
        let directory = path.parent().unwrap_or(Path::new(""));
        let beside = |name: &str| read_beside(&directory.join(name));
        Self::parse(text, &path.display().to_string(), &beside)
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

    /// What is different in `new`, but for what changes from one goal of a task to the next: the
    /// goal and the region of starts. Keys of an arm file stand behind the file's name; of another
    /// file that both name it says that its bytes differ.
    pub fn differences(&self, new: &Self) -> Vec<Difference> {
        let mut found = compare("", self.text.as_bytes(), new.text.as_bytes());
        for (name, old) in &self.beside {
            if let Some(new) = new.beside.get(name) {
                found.extend(compare(name, old, new));
            }
        }
        let names = self.beside.keys().map(|name| format!("{name}.goal"));
        let changing: Vec<_> = names.chain(["goal", "starts"].map(str::to_owned)).collect();
        found.retain(|one| !changing.iter().any(|name| one.is_within(name)));
        found
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
        hexadecimal(&hash.finalize())
    }
}

/// What differs in a file of this name, or in the scene: key by key if it is TOML.
fn compare(name: &str, old: &[u8], new: &[u8]) -> Vec<Difference> {
    let read = |bytes| Document::parse(std::str::from_utf8(bytes).ok()?, "").ok();
    let Some((keys, others)) = read(old).zip(read(new)) else {
        let words = |bytes| format!("SHA-256 {}", &hexadecimal(&Sha256::digest(bytes))[..8]);
        let (key, old, new) = (name.to_owned(), words(old), words(new));
        return if old == new {
            Vec::new()
        } else {
            vec![Difference { key, old, new }]
        };
    };
    let mut found = keys.differences(&others);
    for one in found.iter_mut().filter(|_| !name.is_empty()) {
        one.key = format!("{name}.{}", one.key);
    }
    found
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
