//! Trajectories that foresight needs: from a start where, after a short pause, it fails with the
//! memory so far, or pays more than after long thought.

use memory_blob::{Draft, WriteError};
use scene::{Pose, Scene};
use vpc::{DOF, Law, Measurement, MotionMemory, Settings, Strategy, Task};

use crate::memory;
use crate::settings::ForesightSettings;
use crate::store::{Store, Trajectory};
use crate::trajectory::{self, Failure};

/// Why foresight does not run in a scene.
#[derive(Debug, thiserror::Error)]
pub enum ForesightError {
    /// Foresight needs the joints of an arm, which a build does not have.
    #[error("the scene has an arm; allowed with --foresight: scenes without one")]
    Arm,
    /// The scene gives no law for foresight.
    #[error("--foresight: {0}")]
    Law(vpc::SettingsError),
}

/// A start as foresight runs from it.
#[derive(Clone, Debug)]
pub struct Need {
    /// The start.
    pub start: Pose,
    /// What the run costs, the sum of l(v) / Np, with the memory so far, after a short pause.
    pub now: Result<f64, Failure>,
    /// The same after long thought, with the trajectory.
    pub best: Result<(f64, Trajectory), Failure>,
}

impl Need {
    /// Runs from a start, after a short pause and after long thought.
    pub fn of(
        scene: &Scene,
        task: &Task,
        settings: &ForesightSettings,
        start: &Pose,
        memory: Option<&dyn MotionMemory>,
    ) -> Self {
        let run = |pause_s| run(scene, task, start, memory, pause_s);
        Self {
            start: *start,
            now: run(settings.pause_s).map(|(cost, _)| cost),
            best: run(settings.think_s),
        }
    }

    /// Runs again after a short pause, with a memory that knows more.
    pub fn look_again(
        &mut self,
        scene: &Scene,
        task: &Task,
        settings: &ForesightSettings,
        memory: Option<&dyn MotionMemory>,
    ) {
        let again = run(scene, task, &self.start, memory, settings.pause_s);
        self.now = again.map(|(cost, _)| cost);
    }

    /// How many times the best the run costs, infinitely many where it fails; with the trajectory,
    /// if that is needed.
    pub fn needed(&self, settings: &ForesightSettings) -> Option<(f64, &Trajectory)> {
        let (best, trajectory) = self.best.as_ref().ok()?;
        let paid = self.now.map_or(f64::INFINITY, |now| now / best);
        (paid > settings.pays).then_some((paid, trajectory))
    }
}

/// The memory of a store, as the law asks it.
///
/// # Errors
/// [`WriteError`] where the samples contradict themselves.
pub fn asked(scene: &Scene, store: &Store) -> Result<Option<Draft>, WriteError> {
    let has_samples = !store.inputs.is_empty();
    has_samples
        .then(|| Draft::of(&memory::samples(scene, store)))
        .transpose()
}

/// Whether foresight runs in a scene.
///
/// # Errors
/// [`ForesightError`] where it has an arm or gives no law.
pub fn check(scene: &Scene) -> Result<(), ForesightError> {
    if scene.arm.is_some() {
        return Err(ForesightError::Arm);
    }
    let law = Law::new(scene, settings(), |len| vec![0.0; len]);
    law.map(drop).map_err(ForesightError::Law)
}

/// Those of a law as it is without a configuration.
fn settings() -> Settings {
    Settings {
        strategy: Strategy::Foresight,
        ..Settings::default()
    }
}

/// Runs foresight from a start, where the camera stands for so long at first, s; the cost of the
/// rest, and its trajectory.
fn run(
    scene: &Scene,
    task: &Task,
    start: &Pose,
    memory: Option<&dyn MotionMemory>,
    pause_s: f64,
) -> Result<(f64, Trajectory), Failure> {
    let settings = settings();
    let (np, standing) = (settings.np as f64, (pause_s * scene.camera.rate_hz) as u64);
    let law = Law::new(scene, settings, |len| vec![0.0; len]);
    let mut law = law.map_err(|_| Failure::NoSolution)?;
    let (mut cycle, mut cost) = (0_u64, 0.0);
    let mut is_over = false;
    // The law knows itself when to wait.
    let trajectory = trajectory::run(scene, task, start, usize::MAX, |points, _, _| {
        loop {
            let now_ns = (cycle as f64 * task.period * 1e9).round() as u64;
            let measured = Measurement::from_points(points).taken(now_ns, now_ns);
            let step = law.step(&measured, memory).ok()?;
            let stands = cycle < standing;
            let twist = if stands { [0.0; DOF] } else { step.twist };
            law.sent(&twist, now_ns);
            law.think(memory);
            cycle += 1;
            if stands {
                continue;
            }
            is_over |= step.error_px < scene.success.convergence_px;
            if !is_over {
                cost += step.cost / np;
            }
            return Some(twist);
        }
    })?;
    Ok((cost, trajectory))
}
