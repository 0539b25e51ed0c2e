//! The control law with its files: scene, settings and memory of motion, loaded at start-up.

use std::path::Path;
use std::sync::Arc;

use memory_blob::{MemoryFile, OpenError};
use scene::{FileError, Scene, SceneFiles};
use vpc::{MotionMemory, Settings, SettingsError, Strategy};

/// Why the control law could not be loaded.
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
    /// The memory has no samples or no regression.
    #[error(
        "{path}: no {lacking} in this memory; allowed: a memory with one for the strategy {strategy}"
    )]
    Lacking {
        path: String,
        lacking: &'static str,
        strategy: Strategy,
    },
}

/// The law with its scene and memory of motion.
pub struct LoadedController {
    /// The law.
    pub controller: vpc::Law<Vec<f64>>,
    memory: Option<Arc<MemoryFile>>,
    files: SceneFiles,
}

impl LoadedController {
    /// Loads scene and memory, and sets up the controller. The memory is verified; one for another
    /// task is refused.
    ///
    /// # Errors
    /// [`LoadError`] names the file and the cause.
    pub fn open(
        scene: &Path,
        memory: Option<&Path>,
        settings: Settings,
    ) -> Result<Self, LoadError> {
        let files = SceneFiles::read(scene)?;
        Self::of(files, &scene.display().to_string(), memory, settings)
    }

    /// As [`LoadedController::open`], for a scene that was read before; `path` is for messages.
    ///
    /// # Errors
    /// As [`LoadedController::open`].
    pub fn of(
        files: SceneFiles,
        path: &str,
        memory: Option<&Path>,
        settings: Settings,
    ) -> Result<Self, LoadError> {
        let memory = memory
            .map(|file| open_memory(file, &files.scene, settings.strategy))
            .transpose()?;
        Self::with(files, path, memory.map(Arc::new), settings)
    }

    /// Sets up the controller for a scene and a memory that were read before.
    ///
    /// # Errors
    /// [`LoadError::Task`] if scene and settings give no task; `path` is for the message.
    pub fn with(
        files: SceneFiles,
        path: &str,
        memory: Option<Arc<MemoryFile>>,
        settings: Settings,
    ) -> Result<Self, LoadError> {
        let controller = vpc::Law::new(&files.scene, settings, |len| vec![0.0; len]);
        let controller = controller.map_err(|source| LoadError::Task {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            controller,
            memory,
            files,
        })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.files.scene
    }

    /// The scene and its files.
    pub fn scene_files(&self) -> &SceneFiles {
        &self.files
    }

    /// What scene and settings together make likely to go wrong, in words.
    pub fn warning(&self) -> Option<String> {
        let is_guarded = self.scene().has_marker_size || self.controller.settings().margin_px > 0.0;
        (!is_guarded).then(|| {
            format!(
                "{}: pattern.marker_size is not given and law.margin_px is 0: the law keeps only the markers' centres \
                 in the image and out of occlusions, and a tag is lost before its centre is covered; allowed, but give \
                 pattern.marker_size (0 if the features are points)",
                self.files.path
            )
        })
    }

    /// The memory of motion.
    pub fn memory(&self) -> Option<&MemoryFile> {
        self.memory.as_deref()
    }

    /// One step of the law. Never allocates.
    ///
    /// # Errors
    /// [`vpc::Refusal`] if the features cannot be trusted.
    pub fn step(&mut self, measurement: &vpc::Measurement) -> Result<vpc::Step, vpc::Refusal> {
        let view = self.memory.as_deref().map(MemoryFile::view);
        let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
        self.controller.step(measurement, memory)
    }

    /// Thinks ahead, after the command was sent. Never allocates.
    pub fn think(&mut self) {
        let view = self.memory.as_deref().map(MemoryFile::view);
        let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
        self.controller.think(memory);
    }

    /// Changes the strategy. Returns `false`, and changes nothing, if the memory lacks what it
    /// needs.
    pub fn set_strategy(&mut self, strategy: Strategy) -> bool {
        let has = match &self.memory {
            Some(memory) => lacking(memory, strategy).is_none(),
            None => !strategy.needs_memory(),
        };
        has && self.controller.set_strategy(strategy).is_ok()
    }
}

fn open_memory(file: &Path, scene: &Scene, strategy: Strategy) -> Result<MemoryFile, LoadError> {
    let memory = MemoryFile::open(file, Some(scene.fingerprint().bytes()))?;
    match lacking(&memory, strategy) {
        Some(lacking) => Err(LoadError::Lacking {
            path: file.display().to_string(),
            lacking,
            strategy,
        }),
        None => Ok(memory),
    }
}

/// What a memory lacks for a strategy.
fn lacking(memory: &MemoryFile, strategy: Strategy) -> Option<&'static str> {
    let view = memory.view();
    match strategy {
        Strategy::Gpr if view.gpr().is_none() => Some("regression"),
        _ => None,
    }
}
