//! What a recording needs besides messages: scene, masks and the daemon's configuration.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use scene::{FileError, Scene};

use crate::ledger::Notice;

/// Why the scene or the configuration could not be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ContextError {
    #[error(transparent)]
    Scene(#[from] FileError),
    #[error("{path}: cannot read: {source}")]
    Read {
        path: String,
        source: std::io::Error,
    },
    /// The configuration is not TOML.
    #[error("{path}: {message}")]
    Syntax { path: String, message: String },
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct TextFile {
    pub path: String,
    pub text: String,
}

/// What a recording is about.
#[derive(Clone, Debug, Default)]
pub struct Context {
    /// The scene and its file.
    pub scene: Option<(Scene, TextFile)>,
    /// The masks of the scene (PNG) by the names that it gives them.
    pub masks: BTreeMap<String, Vec<u8>>,
    /// The daemon's configuration file.
    pub config: Option<TextFile>,
}

impl Context {
    /// Reads the scene and the daemon's configuration. Without a scene, the one that the
    /// configuration names.
    ///
    /// # Errors
    /// [`ContextError`] names the file and what is wrong with it.
    pub fn read(scene: Option<&Path>, config: Option<&Path>) -> Result<Self, ContextError> {
        let config = config.map(text).transpose()?;
        let path = match (scene, &config) {
            (Some(path), _) => Some(path.to_owned()),
            (None, Some(config)) => named(config)?,
            (None, None) => None,
        };
        let mut context = Self {
            config,
            ..Self::default()
        };
        if let Some(path) = path {
            context.read_scene(&path)?;
        }
        Ok(context)
    }

    /// Adds the scene that the daemon left in the domain, or returns why there is none.
    pub(crate) fn completed(mut self, domain: &Path) -> (Self, Option<Notice>) {
        let read = self.read_scene(&domain.join(ipc::SCENE_FILE));
        let notice = read.err().map(|error| Notice::NoScene {
            reason: error.to_string(),
        });
        (self, notice)
    }

    fn read_scene(&mut self, path: &Path) -> Result<(), ContextError> {
        let file = text(path)?;
        let directory = path.parent().unwrap_or(Path::new(""));
        // Kept as they were read: a mask may be painted over while the recording goes on.
        let masks = RefCell::new(BTreeMap::new());
        let scene = Scene::parse_with(&file.text, &file.path, &|name| {
            let png = std::fs::read(directory.join(name))?;
            masks.borrow_mut().insert(name.to_owned(), png.clone());
            Ok(png)
        })?;
        self.masks = masks.into_inner();
        self.scene = Some((scene, file));
        Ok(())
    }
}

fn text(path: &Path) -> Result<TextFile, ContextError> {
    let name = path.display().to_string();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(TextFile { path: name, text }),
        Err(source) => Err(ContextError::Read { path: name, source }),
    }
}

/// The scene file that a configuration of `vpcd` names, relative to the configuration.
fn named(config: &TextFile) -> Result<Option<PathBuf>, ContextError> {
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

    #[test]
    fn the_daemon_leaves_the_scene_in_its_domain() {
        let domain = tempfile::tempdir().unwrap();
        let (context, notice) = Context::default().completed(domain.path());
        let told = notice.unwrap().to_string();
        assert!(
            context.scene.is_none() && told.contains("scene.toml: cannot read"),
            "{told}"
        );
        let file = domain.path().join(ipc::SCENE_FILE);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, scene::PAPER_SIM).unwrap();
        let (context, notice) = Context::default().completed(domain.path());
        assert_eq!(notice, None);
        assert_eq!(context.scene.unwrap().1.text, scene::PAPER_SIM);
    }
}
