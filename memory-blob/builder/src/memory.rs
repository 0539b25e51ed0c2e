//! From trajectories to the contents of a memory file: samples, sub-sampling, regression.

use memory_blob::{Contents, Regression};
use scene::Scene;
use serde_json::{Map, Value, json};
use vpc::{DOF, Task};

use crate::progress::Progress;
use crate::regression::{self, FitSettings, NotPositiveDefinite};
use crate::settings::BuildSettings;
use crate::state::TOOL;
use crate::store::Store;
use crate::subsample;

/// The contents of the memory that the trajectories of a build make.
///
/// # Errors
/// [`NotPositiveDefinite`] where no process fits the samples.
pub fn contents(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    progress: &Progress,
) -> Result<Contents, NotPositiveDefinite> {
    let mut store = Store::new(task);
    let trajectories = &progress.trajectories;
    trajectories
        .iter()
        .for_each(|t| store.add(task, settings, t));
    let provenance = provenance(settings, progress, &store);
    let kept = subsample::indices(task, settings, &store);
    let regression = fit(task, settings, &store, &kept)?;
    Ok(Contents {
        regression: Some(regression),
        provenance,
        ..samples(scene, &store)
    })
}

/// The samples of a store alone.
pub(crate) fn samples(scene: &Scene, store: &Store) -> Contents {
    let index = |values: &[usize]| values.iter().map(|&i| i as u32).collect();
    Contents {
        task: *scene.fingerprint().bytes(),
        offset: vec![0.0; store.scale().len()],
        scale: store.scale().to_vec(),
        trajectory: index(&store.trajectory),
        step: index(&store.step),
        regression: None,
        provenance: Map::new(),
        cost_to_go: store.cost_to_go.clone(),
        x: store.inputs.clone(),
        y: store.outputs.clone(),
    }
}

/// The process fitted to the kept samples, with the constant mean (0, s*): no motion and the goal
/// where the memory knows nothing.
///
/// Source: paper, Eq. (gpr).
fn fit(
    task: &Task,
    settings: &BuildSettings,
    store: &Store,
    kept: &[usize],
) -> Result<Regression, NotPositiveDefinite> {
    let scaled = |&i: &usize| -> Vec<f64> {
        let pairs = store.inputs[i].iter().zip(store.scale());
        pairs.map(|(x, s)| x / s).collect()
    };
    let inputs: Vec<Vec<f64>> = kept.iter().map(scaled).collect();
    let outputs: Vec<Vec<f64>> = kept.iter().map(|&i| store.outputs[i].clone()).collect();
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
        length_scale: fitted.kernel.length_scales,
        signal_variance: fitted.kernel.signal_variance,
        noise_variance: fitted.kernel.noise_variance,
        mean,
        lambda: fitted.lambda,
        output_scale: fitted.output_scales,
        cholesky: settings.regression.variance.then_some(fitted.cholesky),
    })
}

/// Trajectories as a memory file keeps them, for refitting: the stored samples in their order.
/// Commands between stored samples are not in the file, so the way points stay as they were built.
pub fn refit(
    scene: &Scene,
    task: &Task,
    settings: &BuildSettings,
    contents: &Contents,
) -> Result<Contents, NotPositiveDefinite> {
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
    let periods = progress.trajectories.iter().map(|t| t.twists.len());
    let mut provenance = json!({
        "tool": TOOL,
        "settings": settings,
        "starts_tried": progress.tried,
        "trajectories": store.trajectories(),
        "control_periods": periods.sum::<usize>(),
        "samples": store.inputs.len(),
        "failed_starts": {
            "stuck": stuck,
            "no_solution": no_solution,
            "violation": violation,
            "time_out": time_out,
        },
    });
    if settings.foresight.is_some() {
        // A number that is not finite is null.
        let paid = progress.paid.iter().map(|paid| (1e3 * paid).round() / 1e3);
        provenance["foresight_paid_times_the_best"] = json!(paid.collect::<Vec<f64>>());
    }
    provenance.as_object().cloned().unwrap_or_default()
}
