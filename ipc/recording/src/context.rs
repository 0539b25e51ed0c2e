//! What a recording needs besides messages: the scene, and the daemon's configuration where it is known.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use scene::{FileError, Scene};

/// Why the scene or the configuration could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ContextError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] FileError),
    /// A file could not be read.
    #[error("{path}: cannot read: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The configuration is not TOML.
    #[error("{path}: {message}")]
    Syntax {
        /// The file.
        path: String,
        /// Line, column, and what was expected.
        message: String,
    },
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Text {
    /// Where it was.
    pub path: String,
    /// What was in it.
    pub text: String,
}

/// The file of a mask that the scene names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaskFile {
    /// Its name in the scene.
    pub name: String,
    /// Its bytes, PNG.
    pub png: Vec<u8>,
}

/// What a recording is about.
#[derive(Clone, Debug, Default)]
pub struct Context {
    /// The scene and its file.
    pub scene: Option<(Scene, Text)>,
    /// The masks of the scene, each file once.
    pub masks: Vec<MaskFile>,
    /// The daemon's configuration file.
    pub config: Option<Text>,
}

impl Context {
    /// Reads the scene and the daemon's configuration. Without a scene, the one that the configuration names.
    ///
    /// # Errors
    /// [`ContextError`] names the file and what is wrong with it.
    pub fn read(scene: Option<&Path>, config: Option<&Path>) -> Result<Self, ContextError> {
        let config = config.map(text).transpose()?;
        let scene = match (scene, &config) {
            (Some(path), _) => Some(path.to_owned()),
            (None, Some(config)) => named(config)?,
            (None, None) => None,
        };
        let Some(path) = scene else {
            return Ok(Self {
                config,
                ..Self::default()
            });
        };
        let file = text(&path)?;
        let directory = path.parent().unwrap_or(Path::new(""));
        // Kept as they were read: a mask that is painted over meanwhile must not get into the recording.
        let masks = RefCell::new(BTreeMap::new());
        let scene = Scene::parse_with(&file.text, &file.path, &|name| {
            let png = std::fs::read(directory.join(name))?;
            masks.borrow_mut().insert(name.to_owned(), png.clone());
            Ok(png)
        })?;
        let masks = masks.into_inner().into_iter();
        Ok(Self {
            scene: Some((scene, file)),
            masks: masks.map(|(name, png)| MaskFile { name, png }).collect(),
            config,
        })
    }
}

fn text(path: &Path) -> Result<Text, ContextError> {
    let name = path.display().to_string();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(Text { path: name, text }),
        Err(source) => Err(ContextError::Read { path: name, source }),
    }
}

/// The scene file that a configuration of `vpcd` names; its path is relative to the configuration's.
fn named(config: &Text) -> Result<Option<PathBuf>, ContextError> {
    let table: toml::Table =
        config
            .text
            .parse()
            .map_err(|error: toml::de::Error| ContextError::Syntax {
                path: config.path.clone(),
                message: error.to_string().trim_end().to_owned(),
            })?;
    let directory = Path::new(&config.path).parent().unwrap_or(Path::new(""));
    let scene = table.get("scene").and_then(toml::Value::as_str);
    Ok(scene.map(|scene| directory.join(scene)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_configuration_of_the_daemon_names_the_scene() {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../controller/vpcd.toml");
        let context = Context::read(None, Some(&config)).unwrap();
        let (scene, file) = context.scene.unwrap();
        assert_eq!(scene.pattern.len(), 4);
        assert_eq!(file.text, scene::PAPER_SIM);
        assert!(context.config.unwrap().text.contains("[law]"));
    }

    #[test]
    fn a_file_that_is_missing_is_named() {
        let error = Context::read(Some(Path::new("/no/such.toml")), None).unwrap_err();
        assert!(error.to_string().starts_with("/no/such.toml: cannot read"));
    }
}
