//! The building of a memory: batches of starts, each tried against the memory as it was before the
//! batch, so that the same seed gives the same memory whatever the number of threads. What
//! foresight needs is tried once more, in order, against what its batch has given.

use std::sync::atomic::{AtomicBool, Ordering};

use memory_blob::{Draft, WriteError};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scene::{Pose, Scene};
use vpc::{MotionMemory, Task};

use crate::foresight::{self, ForesightError, Need};
use crate::mixture::Mixture;
use crate::progress::Progress;
use crate::settings::{BuildSettings, ForesightSettings};
use crate::solution::Finder;
use crate::start::{self, NoStart};
use crate::store::Store;
use crate::trajectory::{self, Trial};

/// Failures to which the mixture is fitted: the latest ones.
const REMEMBERED_FAILURES: usize = 400;
/// Batches in a row without a success after which building is given up.
const HOPELESS_BATCHES: usize = 20;

/// Why building ended without a memory.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// No valid start.
    #[error(transparent)]
    NoStart(#[from] NoStart),
    /// What was collected makes no memory.
    #[error(transparent)]
    Memory(#[from] WriteError),
    /// The scene gives no task.
    #[error("{0}")]
    Task(vpc::TaskError),
    /// Foresight does not run in the scene.
    #[error(transparent)]
    Foresight(#[from] ForesightError),
    /// Nothing succeeds.
    #[error(
        "building: {tried} starts tried, {found} successful, none in the last {HOPELESS_BATCHES} batches; allowed: a \
         scene whose starts can reach its goal"
    )]
    Hopeless {
        /// Starts tried.
        tried: u64,
        /// Successful trajectories.
        found: usize,
    },
}

/// Collects trajectories until there are enough, or `stop` is set; calls `report` after each batch.
/// Going on from the progress of an earlier call gives the same memory as one uninterrupted call.
///
/// # Errors
/// [`BuildError`] where the scene leaves nothing to build.
pub fn collect(
    scene: &Scene,
    settings: &BuildSettings,
    mut progress: Progress,
    stop: &AtomicBool,
    report: &mut dyn FnMut(&Progress),
) -> Result<Progress, BuildError> {
    let task = Task::new(scene).map_err(BuildError::Task)?;
    if settings.foresight.is_some() {
        foresight::check(scene)?;
    }
    let mut store = Store::new(&task);
    progress
        .trajectories
        .iter()
        .for_each(|t| store.add(&task, settings, t));
    let wanted = settings.trajectories;
    let mut barren = 0;
    while !is_enough(settings, &progress) && !stop.load(Ordering::Relaxed) {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        rng.set_stream(progress.batches + 1);
        let adapting = progress.trajectories.len() as f64 >= settings.adapt_after * wanted as f64;
        let failures = adapting.then_some(progress.failures.as_slice());
        let mut starts = draw_starts(scene, &task, settings, failures, &mut rng)?;
        let before = progress.trajectories.len();
        match &settings.foresight {
            None => {
                let trials = tried(scene, &task, settings, &store, &starts, &mut rng);
                keep(&task, settings, &starts, trials, &mut store, &mut progress);
            }
            Some(foresight) => {
                starts.truncate((foresight.starts - progress.tried) as usize);
                let needs = needs(scene, &task, foresight, &store, &starts, stop)?;
                let Some(needs) = needs else { break };
                keep_needed(
                    scene,
                    &task,
                    settings,
                    foresight,
                    needs,
                    &mut store,
                    &mut progress,
                )?;
            }
        }
        progress.batches += 1;
        barren = if progress.trajectories.len() == before {
            barren + 1
        } else {
            0
        };
        if barren == HOPELESS_BATCHES && settings.foresight.is_none() {
            let (tried, found) = (progress.tried, progress.trajectories.len());
            return Err(BuildError::Hopeless { tried, found });
        }
        report(&progress);
    }
    Ok(progress)
}

/// Whether a build is at its end.
pub fn is_enough(settings: &BuildSettings, progress: &Progress) -> bool {
    let foresight = settings.foresight.as_ref();
    progress.trajectories.len() >= settings.trajectories
        || foresight.is_some_and(|foresight| progress.tried >= foresight.starts)
}

/// Tries every start of a batch with the paper's algorithms and the planner.
fn tried(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    store: &Store,
    starts: &[Pose],
    rng: &mut ChaCha8Rng,
) -> Vec<Trial> {
    let seeds: Vec<u64> = starts.iter().map(|_| rng.random()).collect();
    let guide = (store.trajectories() >= settings.guide_after).then_some(store);
    starts
        .par_iter()
        .zip(&seeds)
        .map_init(
            || Finder::new(task, settings),
            |finder, (start, seed)| {
                let mut rng = ChaCha8Rng::seed_from_u64(*seed);
                trajectory::generate(scene, finder, start, guide, &mut rng)
            },
        )
        .collect()
}

/// Stores what a batch gave, until there is enough.
fn keep(
    task: &Task,
    settings: &BuildSettings,
    starts: &[Pose],
    trials: Vec<Trial>,
    store: &mut Store,
    progress: &mut Progress,
) {
    for (start, trial) in starts.iter().zip(trials) {
        if is_enough(settings, progress) {
            break;
        }
        progress.tried += 1;
        if let Some(failure) = trial.failure {
            progress.causes[failure as usize] += 1;
            progress.failures.push(start::coordinates(start));
        }
        if let Some(trajectory) = trial.trajectory {
            store.add(task, settings, &trajectory);
            progress.trajectories.push(trajectory);
        }
    }
}

/// Runs foresight from every start of a batch, with the memory before it; `None` where `stop` ends
/// that, and the whole batch is to be done again.
fn needs(
    scene: &Scene,
    task: &Task,
    foresight: &ForesightSettings,
    store: &Store,
    starts: &[Pose],
    stop: &AtomicBool,
) -> Result<Option<Vec<Need>>, BuildError> {
    let draft = foresight::asked(scene, store)?;
    let view = draft.as_ref().map(Draft::view);
    let run = |start: &Pose| {
        let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
        let goes_on = !stop.load(Ordering::Relaxed);
        goes_on.then(|| Need::of(scene, task, foresight, start, memory))
    };
    Ok(starts.par_iter().map(run).collect())
}

/// Stores the trajectories that foresight needs, also with those that the batch gave before, until
/// there is enough.
fn keep_needed(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    foresight: &ForesightSettings,
    needs: Vec<Need>,
    store: &mut Store,
    progress: &mut Progress,
) -> Result<(), BuildError> {
    let before = store.trajectories();
    for mut need in needs {
        if is_enough(settings, progress) {
            break;
        }
        progress.tried += 1;
        if need.needed(foresight).is_some() && store.trajectories() > before {
            let draft = foresight::asked(scene, store)?;
            let view = draft.as_ref().map(Draft::view);
            let memory = view.as_ref().map(|view| view as &dyn MotionMemory);
            need.look_again(scene, task, foresight, memory);
        }
        if let Err(failure) = need.now {
            progress.causes[failure as usize] += 1;
        }
        if let Some((paid, trajectory)) = need.needed(foresight) {
            progress.paid.push(paid);
            progress.failures.push(start::coordinates(&need.start));
            store.add(task, settings, trajectory);
            progress.trajectories.push(trajectory.clone());
        }
    }
    Ok(())
}

/// The starts of a batch: uniform without `failures`; with them, a share from a mixture over the
/// latest.
fn draw_starts(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    failures: Option<&[[f64; 6]]>,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Pose>, NoStart> {
    let mixture = failures.and_then(|failures| {
        Mixture::over(&failures[failures.len().saturating_sub(REMEMBERED_FAILURES)..])
    });
    (0..settings.batch)
        .map(|_| {
            let adapted = rng.random::<f64>() < settings.adapt_share;
            start::valid(scene, task, mixture.as_ref().filter(|_| adapted), rng)
        })
        .collect()
}
