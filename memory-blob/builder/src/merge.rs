//! Parts of a build joined to one memory.

use std::path::{Path, PathBuf};

use memory_blob::{Contents, MAX_SAMPLES};
use scene::{NotWhole, SceneFiles, Share};
use vpc::{Task, TaskError};

use crate::memory::{self, Collection};
use crate::regression::NotPositiveDefinite;
use crate::settings::BuildSettings;
use crate::state::{BuildState, Header, StateError};
use toml_schema::Refusal;

/// Why parts do not make a memory.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// A file is no part, is damaged, or belongs to something else.
    #[error(transparent)]
    State(#[from] StateError),
    /// A part has not all of its trajectories.
    #[error(
        "{path}: part {part} has {found} trajectories; expected: {wanted}; the command that made it goes on"
    )]
    Unfinished {
        /// The file.
        path: String,
        /// Which part.
        part: String,
        /// Those that it has.
        found: usize,
        /// Those that it should have.
        wanted: usize,
    },
    /// A part is missing, or there twice.
    #[error(transparent)]
    NotWhole(#[from] NotWhole),
    /// More samples than a file may have.
    #[error(
        "{found} samples after {part}; allowed: {MAX_SAMPLES}; fewer trajectories, or a larger sample_spacing"
    )]
    Samples {
        /// Samples so far.
        found: usize,
        /// The file that has too many.
        part: String,
    },
    /// The scene of the parts gives no task.
    #[error("{0}")]
    Task(TaskError),
    /// The settings of the parts do not fit their scene.
    #[error(transparent)]
    Settings(#[from] Refusal),
    /// No process fits.
    #[error(transparent)]
    Fit(#[from] NotPositiveDefinite),
}

/// Parts that belong together, in their order, each there once and finished.
#[derive(Clone, Debug)]
pub struct Parts {
    files: Vec<(PathBuf, Header)>,
}

/// Parts joined.
#[derive(Clone, Debug)]
pub struct Merged {
    /// Their scene.
    pub scene: SceneFiles,
    /// Their settings.
    pub settings: BuildSettings,
    /// The contents of the memory.
    pub contents: Contents,
    /// Trajectories, and starts tried for them.
    pub trajectories: (usize, u64),
}

impl Parts {
    /// Reads the headers of the files, in whatever order they are given.
    ///
    /// # Errors
    /// [`MergeError`] if they do not belong together, one is unfinished, missing, or there twice.
    pub fn of(paths: &[PathBuf]) -> Result<Self, MergeError> {
        let mut files: Vec<(PathBuf, Header)> = Vec::with_capacity(paths.len());
        for path in paths {
            let header = Header::read(path)?;
            if let Some((_, first)) = files.first() {
                header.belongs_to(first, path)?;
            }
            files.push((path.clone(), header));
        }
        let parts = files
            .iter()
            .map(|(path, header)| (path.as_path(), header.part));
        Share::check_whole(parts)?;
        files.sort_by_key(|(_, header)| header.part.index());
        match files.iter().find(|(_, header)| !header.is_complete()) {
            None => Ok(Self { files }),
            Some((path, header)) => Err(MergeError::Unfinished {
                path: path.display().to_string(),
                part: header.part.to_string(),
                found: header.found,
                wanted: header.wanted,
            }),
        }
    }

    /// Joins them, and fits the regression as one build does. One part is in memory at a time.
    ///
    /// # Errors
    /// [`MergeError`] if a file is damaged or the samples are too many.
    pub fn merge(&self) -> Result<Merged, MergeError> {
        let mut begun: Option<(SceneFiles, BuildSettings, Task, Collection)> = None;
        for (path, header) in &self.files {
            let state = read(path, header)?;
            let (_, settings, task, collection) = match &mut begun {
                Some(begun) => begun,
                None => {
                    let settings = state.header.settings;
                    let grown = settings.grown(&state.scene.scene)?;
                    let task = Task::new(&grown).map_err(MergeError::Task)?;
                    let collection = Collection::new(&task);
                    begun.insert((state.scene, settings, task, collection))
                }
            };
            collection.add(task, settings, &state.progress);
            if collection.samples() > MAX_SAMPLES {
                return Err(MergeError::Samples {
                    found: collection.samples(),
                    part: path.display().to_string(),
                });
            }
        }
        let Some((scene, settings, task, collection)) = begun else {
            // No files at all, which `of` refuses.
            let (found, count, missing) = (0, 1, "0".to_owned());
            return Err(NotWhole::Missing {
                found,
                count,
                missing,
            }
            .into());
        };
        let trajectories = collection.trajectories();
        Ok(Merged {
            contents: memory::contents(&scene.scene, &task, &settings, collection)?,
            scene,
            settings,
            trajectories,
        })
    }
}

/// The state in a file whose header was read before.
fn read(path: &Path, header: &Header) -> Result<BuildState, MergeError> {
    let state = BuildState::read(path)?;
    let header_now = &state.header;
    header_now.belongs_to(header, path)?;
    let found = (state.progress.trajectories.len(), header_now.part);
    if found == (header.wanted, header.part) {
        return Ok(state);
    }
    Err(MergeError::Unfinished {
        path: path.display().to_string(),
        part: header.part.to_string(),
        found: found.0,
        wanted: header.wanted,
    })
}
