//! The building of a memory: batches of starts, each tried against the memory as it was before the
//! batch, so that the same seed gives the same memory whatever the number of threads.

use std::sync::atomic::{AtomicBool, Ordering};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scene::{Pose, Scene};
use serde::{Deserialize, Serialize};
use vpc::Task;

use crate::mixture::Mixture;
use crate::settings::BuildSettings;
use crate::solution::Finder;
use crate::start::{self, NoStart};
use crate::store::{Store, Trajectory};
use crate::trajectory::{self, Trial};

/// Failures to which the mixture is fitted: the latest ones.
const REMEMBERED_FAILURES: usize = 400;
/// Batches in a row without a success after which building is given up.
const HOPELESS_BATCHES: usize = 20;

/// The state of a building, from which it can go on: what a Ctrl-C leaves behind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Successful trajectories.
    pub trajectories: Vec<Trajectory>,
    /// Starts at which the paper's algorithms failed, as points of R^6; from some the planner found
    /// a way.
    pub failures: Vec<[f64; 6]>,
    /// Starts tried.
    pub tried: u64,
    /// Batches done; with the seed it fixes every random choice to come.
    pub batches: u64,
    /// Failed starts by cause: stuck, no solution, violation, time out.
    pub causes: [u64; 4],
}

/// Why building ended without a memory.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// No valid start.
    #[error(transparent)]
    NoStart(#[from] NoStart),
    /// The scene gives no task.
    #[error("{0}")]
    Task(vpc::TaskError),
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
    let mut store = Store::new(&task);
    progress
        .trajectories
        .iter()
        .for_each(|t| store.add(&task, settings, t));
    let wanted = settings.trajectories;
    let mut barren = 0;
    while progress.trajectories.len() < wanted && !stop.load(Ordering::Relaxed) {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        rng.set_stream(progress.batches + 1);
        let adapting = progress.trajectories.len() as f64 >= settings.adapt_after * wanted as f64;
        let failures = adapting.then_some(progress.failures.as_slice());
        let starts = draw_starts(scene, &task, settings, failures, &mut rng)?;
        let seeds: Vec<u64> = starts.iter().map(|_| rng.random()).collect();
        let guide = (store.trajectories() >= settings.guide_after).then_some(&store);
        let trials: Vec<Trial> = starts
            .par_iter()
            .zip(&seeds)
            .map_init(
                || Finder::new(&task, settings),
                |finder, (start, seed)| {
                    let mut rng = ChaCha8Rng::seed_from_u64(*seed);
                    trajectory::generate(scene, finder, start, guide, &mut rng)
                },
            )
            .collect();
        let before = progress.trajectories.len();
        for (start, trial) in starts.iter().zip(trials) {
            if progress.trajectories.len() == wanted {
                break;
            }
            progress.tried += 1;
            if let Some(failure) = trial.failure {
                progress.causes[failure as usize] += 1;
                progress.failures.push(start::coordinates(start));
            }
            if let Some(trajectory) = trial.trajectory {
                store.add(&task, settings, &trajectory);
                progress.trajectories.push(trajectory);
            }
        }
        progress.batches += 1;
        barren = if progress.trajectories.len() == before {
            barren + 1
        } else {
            0
        };
        if barren == HOPELESS_BATCHES {
            let (tried, found) = (progress.tried, progress.trajectories.len());
            return Err(BuildError::Hopeless { tried, found });
        }
        report(&progress);
    }
    Ok(progress)
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
