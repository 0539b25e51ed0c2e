//! From trajectories to the contents of a memory file: samples, sub-sampling, regression.

use memory_blob::{Contents, Regression};
use scene::Scene;
use serde_json::{Map, Value, json};
use vpc::{DOF, Task};

use crate::build::Progress;
use crate::regression::{self, FitSettings, Matrix, RegressionError};
use crate::settings::BuildSettings;
use crate::store::{Store, Trajectory};
use crate::subsample;

/// The contents of the memory that some trajectories make.
///
/// # Errors
/// [`RegressionError`] where no process fits the samples.
pub fn contents(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    progress: &Progress,
) -> Result<Contents, RegressionError> {
    let mut store = Store::new(task);
    progress
        .trajectories
        .iter()
        .for_each(|trajectory| store.add(task, settings, trajectory));
    let kept = subsample::indices(task, settings, &store);
    let regression = fit(task, settings, &store, &kept)?;
    let index = |values: &[usize]| values.iter().map(|&i| i as u32).collect();
    Ok(Contents {
        task: *scene.fingerprint().bytes(),
        offset: vec![0.0; store.scale().len()],
        scale: store.scale().to_vec(),
        trajectory: index(&store.trajectory),
        step: index(&store.step),
        regression: Some(regression),
        provenance: provenance(settings, progress, &store),
        x: store.inputs,
        y: store.outputs,
    })
}

/// The process fitted to the kept samples, with the constant mean (0, s*): no motion and the goal where the memory
/// knows nothing.
///
/// Source: paper, Eq. (gpr).
fn fit(
    task: &Task,
    settings: &BuildSettings,
    store: &Store,
    kept: &[usize],
) -> Result<Regression, RegressionError> {
    let scaled = |i: usize| {
        store.inputs[i]
            .iter()
            .zip(store.scale())
            .map(|(x, s)| x / s)
    };
    let inputs = Matrix::new(
        "inputs",
        store.scale().len(),
        kept.iter().flat_map(|&i| scaled(i)).collect(),
    )?;
    let width = DOF + 2 * task.goal.len();
    let rows = kept
        .iter()
        .flat_map(|&i| store.outputs[i].iter().copied())
        .collect();
    let outputs = Matrix::new("outputs", width, rows)?;
    let mean: Vec<f64> = std::iter::repeat_n(0.0, DOF)
        .chain(task.goal.iter().flatten().copied())
        .collect();
    let fitted = regression::fit(
        &inputs,
        &outputs,
        &mean,
        &FitSettings {
            seed: settings.seed,
            restarts: settings.regression.restarts,
            subset: settings.regression.likelihood_samples,
            polish: settings.regression.polish,
            ..FitSettings::default()
        },
    )?;
    Ok(Regression {
        x: kept.iter().map(|&i| store.inputs[i].clone()).collect(),
        length_scale: fitted.length_scales,
        signal_variance: fitted.signal_variance,
        noise_variance: fitted.noise_variance,
        mean,
        lambda: fitted
            .lambda
            .data()
            .chunks(width)
            .map(<[f64]>::to_vec)
            .collect(),
        output_scale: Some(fitted.output_scales),
        cholesky: settings.regression.variance.then_some(fitted.cholesky),
    })
}

/// Trajectories as a memory file keeps them, for refitting: the stored samples in their order. Commands between
/// stored samples are not in the file, so the way points stay as they were built.
pub fn refit(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    contents: &Contents,
) -> Result<Contents, RegressionError> {
    let mut store = Store::new(task);
    store.inputs.clone_from(&contents.x);
    store.outputs.clone_from(&contents.y);
    let kept = subsample::indices(task, settings, &store);
    let regression = fit(task, settings, &store, &kept)?;
    let mut provenance = contents.provenance.clone();
    provenance.insert("refit".into(), json!(settings.regression));
    Ok(Contents {
        task: *scene.fingerprint().bytes(),
        regression: Some(regression),
        provenance,
        ..contents.clone()
    })
}

fn provenance(settings: &BuildSettings, progress: &Progress, store: &Store) -> Map<String, Value> {
    let [stuck, no_solution, violation, time_out] = progress.causes;
    let steps: usize = progress
        .trajectories
        .iter()
        .map(|t: &Trajectory| t.twists.len())
        .sum();
    let mut map = Map::new();
    map.insert(
        "tool".into(),
        json!(concat!("vpc-memory ", env!("CARGO_PKG_VERSION"))),
    );
    map.insert("settings".into(), json!(settings));
    map.insert("starts_tried".into(), json!(progress.tried));
    map.insert("trajectories".into(), json!(progress.trajectories.len()));
    map.insert("control_periods".into(), json!(steps));
    map.insert("samples".into(), json!(store.inputs.len()));
    map.insert(
        "failed_starts".into(),
        json!({"stuck": stuck, "no_solution": no_solution, "violation": violation, "time_out": time_out}),
    );
    map
}
