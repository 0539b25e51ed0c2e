//! The samples that regression keeps.

use vpc::prediction::InitialState;
use vpc::{Task, recall};

use crate::settings::BuildSettings;
use crate::store::Store;

/// Indices of the samples for regression, in the order of the store: evenly spread over those that
/// lie in the zone round the occlusions in which the memory is asked (all samples where the zone
/// holds too few).
///
/// Source: paper, Sect. V.A sub-samples evenly over whole trajectories; where no query falls,
/// samples only cost time.
pub fn indices(task: &Task, settings: &BuildSettings, store: &Store) -> Vec<usize> {
    let wanted = settings.regression.samples;
    let reach = settings.regression.zone * settings.trigger_px;
    let points = 2 * task.goal.len();
    let in_zone = |input: &Vec<f64>| {
        let pixels = input[..points].chunks_exact(2).map(|p| [p[0], p[1]]);
        let initial = InitialState::new(task, BuildSettings::MODEL, &pixels.collect());
        recall::clearance(task, &initial) < reach
    };
    let zone: Vec<usize> = (0..store.inputs.len())
        .filter(|&i| in_zone(&store.inputs[i]))
        .collect();
    let from = if zone.len() >= wanted.min(store.inputs.len()) {
        zone
    } else {
        (0..store.inputs.len()).collect()
    };
    let kept = wanted.min(from.len());
    (0..kept).map(|k| from[k * from.len() / kept]).collect()
}
