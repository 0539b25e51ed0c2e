//! Crossing: futures that go behind an occlusion on purpose, where the scene allows it.
//!
//! To such a future a crossable occlusion is no obstacle. It counts if its points come into sight
//! again in time: [`blind`] says for how long they are known well enough.

use scene::Scene;

use crate::drift::Drift;
use crate::prediction::InitialState;
use crate::settings::Settings;
use crate::task::Task;
use crate::{blind, constraint};

/// What crossing futures need of a scene.
#[derive(Clone, Debug)]
pub(crate) struct Crossing {
    /// The task without its crossable occlusions.
    pub task: Task,
}

impl Crossing {
    /// What they need of a scene with this task; `None` if it has no crossable occlusion.
    pub fn of(scene: &Scene, whole: &Task) -> Option<Self> {
        scene.is_crossable().then(|| {
            let mut task = whole.clone();
            task.open(scene);
            Self { task }
        })
    }
}

/// Whether an occlusion hides a point, or a part of its marker.
pub(crate) fn is_hidden(task: &Task, at: &InitialState) -> bool {
    let mut points = at.points.iter().zip(at.radii(task));
    points.any(|(&pixel, radius)| constraint::least_clearance(task, pixel) < radius)
}

/// The longest time for which a future may take a point out of sight, s: by the settings, and until
/// it is no longer known well enough if no point is seen.
pub(crate) fn most_s(task: &Task, settings: &Settings, at: &InitialState, drift: &Drift) -> f64 {
    let in_a_second_px = blind::lead_px(task, at, drift, 1.0);
    settings.blind_s.min(blind::most_px(task) / in_a_second_px)
}
