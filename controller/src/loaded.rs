//! What the control step is made of, read at start-up: scene, settings and memory of motion.

use std::path::Path;

use decision::law;
use decision::{ControlStep, Rules};
use memory_blob::{MemoryFile, OpenError};
use program::Exit;
use scene::{FileError, Scene, SceneFiles};
use vpc::{Settings, SettingsError, Strategy};

/// Why it could not be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum LoadError {
    #[error(transparent)]
    Scene(#[from] FileError),
    /// Scene and settings do not give a task.
    #[error("{path}: {source}")]
    Task { path: String, source: SettingsError },
    #[error(transparent)]
    Memory(#[from] OpenError),
    /// The memory has no regression.
    #[error(
        "{path}: no regression in this memory; allowed: a memory with one for the strategy {strategy}"
    )]
    Lacking { path: String, strategy: Strategy },
}

impl From<&LoadError> for Exit {
    fn from(error: &LoadError) -> Self {
        match error {
            LoadError::Scene(FileError::Read { .. })
            | LoadError::Memory(OpenError::Read { .. }) => Self::NoInput,
            _ => Self::Data,
        }
    }
}

/// Scene, settings and memory of motion.
#[derive(Debug)]
#[allow(missing_docs)]
pub struct Loaded {
    pub files: SceneFiles,
    pub memory: Option<MemoryFile>,
    pub settings: Settings,
}

impl Loaded {
    /// Reads scene and memory. The memory is verified; one for another task is refused.
    ///
    /// # Errors
    /// [`LoadError`] names the file and the cause.
    pub fn open(
        scene: &Path,
        memory: Option<&Path>,
        settings: Settings,
    ) -> Result<Self, LoadError> {
        let bytes = memory.map(MemoryFile::read).transpose()?;
        let memory = memory.zip(bytes.as_deref());
        Self::of(SceneFiles::read(scene)?, memory, settings)
    }

    /// As [`Loaded::open`], for files that were read before; of the memory its path and its bytes.
    ///
    /// # Errors
    /// As [`Loaded::open`].
    pub fn of(
        files: SceneFiles,
        memory: Option<(&Path, &[u8])>,
        settings: Settings,
    ) -> Result<Self, LoadError> {
        let open = |memory| open_memory(memory, &files.scene, settings.strategy);
        Ok(Self {
            memory: memory.map(open).transpose()?,
            files,
            settings,
        })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.files.scene
    }

    /// The control step before its first cycle.
    ///
    /// # Errors
    /// [`LoadError::Task`] if scene and settings give no task.
    pub fn control(&self, rules: Rules) -> Result<ControlStep<'_>, LoadError> {
        let memory = self.memory.as_ref().map(MemoryFile::view);
        let control = ControlStep::new(self.scene(), self.settings, memory, rules);
        control.map_err(|source| LoadError::Task {
            path: self.files.path.clone(),
            source,
        })
    }

    /// What scene and settings together make likely to go wrong, in words.
    pub fn warning(&self) -> Option<String> {
        let is_guarded = self.scene().has_marker_size || self.settings.margin_px > 0.0;
        (!is_guarded).then(|| {
            format!(
                "{}: pattern.marker_size is not given and law.margin_px is 0: the law keeps only the markers' centres \
                 in the image and out of occlusions, and a tag is lost before its centre is covered; allowed, but give \
                 pattern.marker_size (0 if the features are points)",
                self.files.path
            )
        })
    }
}

fn open_memory(
    (file, bytes): (&Path, &[u8]),
    scene: &Scene,
    strategy: Strategy,
) -> Result<MemoryFile, LoadError> {
    let memory = MemoryFile::parse(bytes, file, Some(scene.fingerprint().bytes()))?;
    match law::has_memory(Some(&memory.view()), strategy) {
        true => Ok(memory),
        false => Err(LoadError::Lacking {
            path: file.display().to_string(),
            strategy,
        }),
    }
}
