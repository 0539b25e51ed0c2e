//! What the daemon begins with: configuration, scene and memory.
//!
//! One that begins again reads its files anew, like any other. Its predecessor had them checked by
//! another process, which left what it had read on a memory file (memfd): where they cannot be read
//! any more, or are wrong by now, the daemon begins with that.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::path::Path;

use memory_blob::MemoryFile;
use scene::SceneFiles;
use serde::{Deserialize, Serialize};

use crate::arguments::Arguments;
use crate::config::{self, Config, ConfigError};
use crate::flight::Recorder;
use crate::loaded::{LoadError, Loaded};
use crate::realtime;

/// Why it cannot begin.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum StartError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Load(#[from] LoadError),
}

/// What the daemon begins with, checked.
#[derive(Debug)]
pub struct Start {
    config: Config,
    /// The whole configuration, as [`Config::print`] returns it.
    text: String,
    loaded: Loaded,
    /// The file of the memory.
    memory: Option<Vec<u8>>,
}

/// The bytes of all files.
#[derive(Serialize, Deserialize)]
struct Checked {
    config: String,
    scene: String,
    beside: BTreeMap<String, Vec<u8>>,
    memory: Option<Vec<u8>>,
}

impl Start {
    /// Reads and checks the files that the command line names.
    ///
    /// # Errors
    /// [`StartError`] names file, key, value and what is allowed.
    pub fn read(arguments: &Arguments) -> Result<Self, StartError> {
        let (config, text) = Config::read_whole(arguments)?;
        let files = SceneFiles::read(&config.scene).map_err(LoadError::from)?;
        let memory = config.memory.as_deref().map(MemoryFile::read);
        let memory = memory.transpose().map_err(LoadError::from)?;
        Self::of(config::named(arguments), config, text, files, memory)
    }

    fn of(
        source: String,
        config: Config,
        text: String,
        files: SceneFiles,
        memory: Option<Vec<u8>>,
    ) -> Result<Self, StartError> {
        let named = config.memory.as_deref().zip(memory.as_deref());
        let loaded = Loaded::of(files, named, config.settings)?;
        let scene = loaded.scene();
        loaded.control(config.rules(scene, &source)?)?;
        let room = realtime::memory_bytes();
        Recorder::check_room(&config.flight, scene.camera.rate_hz, room, source)?;
        Ok(Self {
            config,
            text,
            loaded,
            memory,
        })
    }

    /// The configuration, as such and as [`Config::print`] returns it; scene and memory.
    pub fn into_parts(self) -> (Config, String, Loaded) {
        (self.config, self.text, self.loaded)
    }

    /// Leaves it on standard output, a memory file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn leave(self) -> io::Result<()> {
        let files = self.loaded.files;
        let checked = Checked {
            config: self.text,
            scene: files.text,
            beside: files.beside,
            memory: self.memory,
        };
        let bytes = postcard::to_stdvec(&checked).map_err(io::Error::other)?;
        let mut output = io::stdout().lock();
        output.write_all(&bytes).and_then(|()| output.flush())
    }

    /// As [`Start::read`]; where that fails, takes what was left on standard input, and why.
    ///
    /// # Errors
    /// As [`Start::read`], where nothing was left.
    pub fn again(arguments: &Arguments) -> Result<(Self, Option<StartError>), StartError> {
        let read = Self::read(arguments).map(|start| (start, None));
        let input = io::stdin().as_fd().try_clone_to_owned().map(File::from);
        let otherwise = |why| match input.as_ref().ok().and_then(|file| left(file, arguments)) {
            Some(start) => Ok((start, Some(why))),
            None => Err(why),
        };
        let start = read.or_else(otherwise);
        // The memory is free from here on.
        let _ = input.and_then(|file| file.set_len(0));
        start
    }
}

/// What was left on a file; `None` if that is nothing of the kind.
fn left(file: &File, arguments: &Arguments) -> Option<Start> {
    let found = file.metadata().ok().filter(std::fs::Metadata::is_file)?;
    let mut bytes = vec![0; usize::try_from(found.len()).ok()?];
    file.read_exact_at(&mut bytes, 0).ok()?;
    let Checked {
        config: text,
        scene,
        beside,
        memory,
    } = postcard::from_bytes(&bytes).ok()?;
    let source = config::named(arguments);
    let config = Config::parse(&text, &source, Path::new(""), &Arguments::default()).ok()?;
    let path = config.scene.display().to_string();
    let files = SceneFiles::parse(scene, &path, &|name| {
        let file = beside.get(name).cloned();
        file.ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
    });
    Start::of(source, config, text, files.ok()?, memory).ok()
}
