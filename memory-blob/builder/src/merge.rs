//! Parts of a build joined to one memory.

use std::path::{Path, PathBuf};

use memory_blob::{Contents, MAX_SAMPLES};
use scene::{NotWhole, SceneFiles, Share};
use vpc::{Task, TaskError};

use crate::build::Progress;
use crate::memory::{self, Collection};
use crate::regression::NotPositiveDefinite;
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
    /// Nothing to merge.
    #[error("no parts; expected: at least one")]
    None,
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
    first: (PathBuf, Header),
    rest: Vec<(PathBuf, Header)>,
}

/// Parts joined.
#[derive(Clone, Debug)]
pub struct Merged {
    /// Their scene.
    pub scene: SceneFiles,
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
        let with_header = |path: &PathBuf| Ok((path.clone(), Header::read(path)?));
        let files: Result<Vec<_>, StateError> = paths.iter().map(with_header).collect();
        let mut files = files?;
        files.sort_by_key(|(_, header)| header.part.index());
        let mut rest = files.into_iter();
        let first = rest.next().ok_or(MergeError::None)?;
        let rest: Vec<_> = rest.collect();
        for (path, header) in &rest {
            header.belongs_to(&first.1, path)?;
        }
        let all = || std::iter::once(&first).chain(&rest);
        Share::check_whole(all().map(|(path, header)| (path.as_path(), header.part)))?;
        match all().find(|(_, header)| !header.is_complete()) {
            None => Ok(Self { first, rest }),
            Some((path, header)) => Err(unfinished(path, header, header.found)),
        }
    }

    /// Joins them, and fits the regression as one build does. One part is in memory at a time.
    ///
    /// # Errors
    /// [`MergeError`] if a file is damaged or the samples are too many.
    pub fn merge(&self) -> Result<Merged, MergeError> {
        let (path, header) = &self.first;
        let state = read(path, header)?;
        let (scene, settings) = (state.scene, state.header.settings);
        let task = Task::new(&settings.grown(&scene.scene)?).map_err(MergeError::Task)?;
        let mut collection = Collection::new(&task);
        let mut add = |path: &Path, progress: Progress| {
            collection.add(&task, &settings, &progress);
            match collection.samples() {
                0..=MAX_SAMPLES => Ok(()),
                found => Err(MergeError::Samples {
                    found,
                    part: path.display().to_string(),
                }),
            }
        };
        add(path, state.progress)?;
        for (path, header) in &self.rest {
            add(path, read(path, header)?.progress)?;
        }
        let trajectories = collection.trajectories();
        Ok(Merged {
            contents: memory::contents(&scene.scene, &task, &settings, collection)?,
            scene,
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
    Err(unfinished(path, header, found.0))
}

fn unfinished(path: &Path, header: &Header, found: usize) -> MergeError {
    MergeError::Unfinished {
        path: path.display().to_string(),
        part: header.part.to_string(),
        found,
        wanted: header.wanted,
    }
}
