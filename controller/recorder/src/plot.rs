//! Figures and latency report of a recording.

use std::fs;
use std::path::{Path, PathBuf};

use figures::{Comparison, FigureError, ImagePlane, Latency, Times, Velocity};
use messages::{ClockMode, CycleRecord, MAX_POINTS};
use scene::{FileError, Scene};

use crate::report::Report;
use recording::Recording;

/// Periods without a record for which the last command is drawn; after that the camera has stopped.
const STANDING: usize = 3;
/// Most commands in a figure: a recording may have run for days.
const LONGEST: usize = 100_000;

/// Why nothing was drawn.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum PlotError {
    #[error(transparent)]
    Figure(#[from] FigureError),
    #[error("{path}: cannot write the report: {source}")]
    Write {
        path: String,
        source: std::io::Error,
    },
    /// The scene in the recording.
    #[error(transparent)]
    Scene(#[from] FileError),
    #[error(
        "no scene in the recording; allowed: one recorded while vpcd was at work, or with --scene, or --scene here"
    )]
    NoScene,
    #[error("no cycles and no features in the recording: was vpcd running?")]
    Empty,
}

/// Draws the runs of a recording and its latencies into a directory and returns the files. `scene`
/// replaces the recording's own.
///
/// # Errors
/// [`PlotError`].
pub fn plot(
    recording: &Recording,
    scene: Option<&Scene>,
    directory: &Path,
) -> Result<Vec<PathBuf>, PlotError> {
    let own = match scene {
        Some(_) => None,
        None => recording.scene()?,
    };
    let scene = scene.or(own.as_ref()).ok_or(PlotError::NoScene)?;
    if recording.cycles.is_empty() && recording.features.is_empty() {
        return Err(PlotError::Empty);
    }
    let mut files = Vec::new();
    let runs = runs(&recording.cycles);
    for (i, run) in runs.iter().enumerate() {
        let name = match runs.len() {
            1 => "run".to_owned(),
            _ => format!("run-{}", i + 1),
        };
        let canvas = figure(scene, run, &name).canvas();
        files.extend(canvas.write(&directory.join(name))?);
    }
    if runs.is_empty() {
        // No cycles: what the camera saw.
        let path = recording.features.iter().map(|f| f.pairs().collect());
        let plane = ImagePlane {
            scene,
            path: path.collect(),
            goal: scene.goal_px().collect(),
            way_points: Vec::new(),
            foreseen: Vec::new(),
            ellipses: Vec::new(),
            title: "features (no cycles)".to_owned(),
        };
        files.extend(plane.canvas().write(&directory.join("features"))?);
    }
    let report = Report::of(recording);
    let canvas = latency(&report).canvas();
    files.extend(canvas.write(&directory.join("latency"))?);
    for (name, text) in [
        ("latency.txt", report.to_string()),
        ("latency.json", report.to_json()),
    ] {
        let path = directory.join(name);
        fs::write(&path, text).map_err(|source| PlotError::Write {
            path: path.display().to_string(),
            source,
        })?;
        files.push(path);
    }
    Ok(files)
}

/// The cycles with features, split where the camera or the daemon started again.
fn runs(cycles: &[CycleRecord]) -> Vec<Vec<&CycleRecord>> {
    let mut runs: Vec<Vec<&CycleRecord>> = Vec::new();
    let mut last: Option<&CycleRecord> = None;
    for cycle in cycles.iter().filter(|cycle| cycle.count > 0) {
        let goes_on = last.is_some_and(|last| {
            cycle.cycle > last.cycle && cycle.features_sequence >= last.features_sequence
        });
        match runs.last_mut() {
            Some(run) if goes_on => run.push(cycle),
            _ => runs.push(vec![cycle]),
        }
        last = Some(cycle);
    }
    // A single frame is no path.
    runs.retain(|run| run.len() > 1);
    runs
}

fn figure<'a>(scene: &'a Scene, run: &[&CycleRecord], name: &str) -> Comparison<'a> {
    let period_s = scene.sampling_time();
    let pairs = |stacked: &[f64], count: u32| -> Vec<[f64; 2]> {
        let count = (count as usize).min(MAX_POINTS);
        let pairs = stacked.chunks_exact(2).take(count);
        pairs.map(|p| [p[0], p[1]]).collect()
    };
    let way_points = run.iter().filter(|cycle| cycle.way_point_count > 0);
    let first_known = run.iter().find(|cycle| cycle.arrival_s.is_finite());
    let twists = twists(run, period_s);
    let error = run.last().map(|cycle| cycle.error_px);
    let error = error.filter(|error| error.is_finite());
    let error = error.map_or_else(String::new, |error| format!(", error {error:.1} px"));
    let strategy = run
        .first()
        .and_then(|cycle| messages::StrategyCode::from_code(cycle.strategy))
        .map_or_else(String::new, |strategy| format!(", {strategy}"));
    let plane = ImagePlane {
        scene,
        path: run.iter().map(|c| pairs(&c.points, c.count)).collect(),
        goal: scene.goal_px().collect(),
        way_points: way_points
            .map(|c| pairs(&c.way_point, c.way_point_count))
            .collect(),
        foreseen: first_known
            .map_or_else(Vec::new, |c| c.foreseen().map(Iterator::collect).collect()),
        ellipses: run
            .iter()
            .flat_map(|c| c.ellipses())
            .map(|(point, outline)| (point, outline.collect()))
            .collect(),
        title: format!(
            "{name}{strategy}: {:.1} s{error}",
            twists.sent.len() as f64 * period_s
        ),
    };
    let velocity = Velocity {
        period_s,
        own: match twists.own.iter().any(|own| *own != [0.0; 6]) {
            true => twists.own,
            false => Vec::new(),
        },
        twists: twists.sent,
        limits: scene.limits,
        title: "velocity command".to_owned(),
    };
    Comparison {
        columns: vec![(plane, velocity)],
    }
}

/// The command of each period, and what was believed of the pattern's own motion.
#[derive(Default)]
struct Twists {
    sent: Vec<[f64; 6]>,
    own: Vec<[f64; 6]>,
}

/// The twists of each period; where records are missing, the last ones for a while, then zero.
fn twists(run: &[&CycleRecord], period_s: f64) -> Twists {
    let mut twists = Twists::default();
    let Some(first) = run.first() else {
        return twists;
    };
    let mut add = |sent, own| {
        twists.sent.push(sent);
        twists.own.push(own);
        twists.sent.len()
    };
    let (mut count, mut last) = (0, [[0.0; 6]; 2]);
    for cycle in run {
        if cycle.clock != ClockMode::Lockstep.code() {
            let since = cycle.stamp.data_ns.saturating_sub(first.stamp.data_ns);
            let place = (since as f64 / 1e9 / period_s).round() as usize;
            let stands = count + STANDING;
            while count < place.min(LONGEST) {
                let [sent, own] = if count < stands { last } else { [[0.0; 6]; 2] };
                count = add(sent, own);
            }
        }
        last = [cycle.twist, cycle.drift];
        count = add(cycle.twist, cycle.drift);
    }
    twists
}

fn latency(report: &Report) -> Latency {
    let panels = report.stages.iter().map(|stage| Times {
        name: stage.name.to_owned(),
        values_us: stage.values_us.clone(),
        note: format!(
            "{} cycles: p50 {}, p99 {}, max {}",
            stage.count,
            words(stage.p50_us),
            words(stage.p99_us),
            words(stage.max_us)
        ),
    });
    let misses = match report.has_deadlines {
        true => format!("{} deadlines missed", report.overruns),
        false => "lockstep, no deadlines".to_owned(),
    };
    Latency {
        panels: panels.collect(),
        limit_us: report.has_deadlines.then_some(1e3 * report.period_ms),
        title: format!(
            "{} cycles in {:.1} s, {misses}; counts logarithmic",
            report.cycles, report.duration_s
        ),
    }
}

/// A time in a suitable unit.
fn words(us: f64) -> String {
    match us {
        1e6.. => format!("{:.2} s", us / 1e6),
        1e3.. => format!("{:.1} ms", us / 1e3),
        _ => format!("{us:.1} us"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycle(number: u64, features_sequence: u64) -> CycleRecord {
        let mut record = CycleRecord {
            cycle: number,
            features_sequence,
            count: 4,
            ..CycleRecord::default()
        };
        record.stamp.data_ns = number * 33_333_333;
        record.twist[0] = number as f64;
        record
    }

    #[test]
    fn a_camera_that_starts_again_starts_another_run() {
        let mut blind = cycle(4, 0);
        blind.count = 0;
        let numbers = [
            cycle(1, 1),
            cycle(2, 2),
            cycle(3, 2),
            blind,
            cycle(5, 1),
            cycle(6, 2),
            // The daemon, too.
            cycle(1, 3),
        ];
        let runs = runs(&numbers);
        let counts: Vec<_> = runs.iter().map(Vec::len).collect();
        assert_eq!(counts, [3, 2]);
    }

    #[test]
    fn a_command_stands_for_a_while_where_records_are_missing() {
        let cycles = [cycle(10, 1), cycle(11, 2), cycle(18, 9)];
        let run: Vec<_> = cycles.iter().collect();
        let vx: Vec<_> = twists(&run, 1.0 / 30.0).sent.iter().map(|v| v[0]).collect();
        assert_eq!(vx, [10.0, 11.0, 11.0, 11.0, 11.0, 0.0, 0.0, 0.0, 18.0]);
    }
}
