//! Figures and latency report of a recording.

use std::fs;
use std::path::{Path, PathBuf};

use figures::{Animation, Comparison, FigureError, ImagePlane, Joints, Latency, Times, Velocity};
use messages::{ArmBound, ClockMode, CycleRecord, MAX_POINTS, RobotState, TwistState};
use scene::{FileError, Scene};

use crate::report::Report;
use recording::Recording;

/// Periods without a record for which the last command is drawn; after that the camera has stopped.
const STANDING: usize = 3;
/// Most commands in a figure: a recording may have run for days.
const LONGEST: usize = 100_000;
/// Most states of the robot in a figure, which tells a thousand a second: as fine as it is printed.
const FINE: usize = 2000;
/// Time from one frame of a film to the next, and for which the last one stands, s.
const FRAME_S: [f64; 2] = [0.1, 2.0];
/// Most frames of a film, and cycles drawn in one of them: a longer run is shown faster, and
/// coarser.
const FRAMES: usize = 150;
const CYCLES: usize = 1000;

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

/// Whether runs are also drawn as films, which takes longer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Films {
    /// They are.
    Wanted,
    /// They are not.
    Unwanted,
}

/// Draws the runs of a recording, also as films if these are `wanted`, and its latencies into a
/// directory and returns the files. `scene` replaces the recording's own.
///
/// # Errors
/// [`PlotError`].
pub fn plot(
    recording: &Recording,
    scene: Option<&Scene>,
    directory: &Path,
    films: Films,
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
        files.extend(canvas.write(&directory.join(&name))?);
        if films == Films::Wanted {
            files.push(film(scene, run).write(&directory.join(&name))?);
        }
        if let Some(joints) = joints(scene, run, &recording.robot, &name) {
            let name = format!("{name}-joints");
            files.extend(joints.canvas().write(&directory.join(name))?);
        }
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
        periods: 0,
        title: "velocity command".to_owned(),
    };
    Comparison {
        columns: vec![(plane, velocity)],
    }
}

/// A run as it goes on, cycle by cycle with features: what the camera has seen, what is foreseen
/// from there, the commands, and what the controller does.
fn film(scene: &Scene, run: &[&CycleRecord]) -> Animation {
    let period_s = scene.sampling_time();
    let periods = twists(run, period_s).sent.len();
    let every = ((FRAME_S[0] / period_s).round() as usize).max(run.len().div_ceil(FRAMES));
    // Of a long run, what a drawing can show.
    let apart = periods.div_ceil(CYCLES).max(1);
    let frame = |last: usize| {
        let run = run.get(..=last).unwrap_or(run);
        let mut figure = figure(scene, run, "");
        for (plane, velocity) in &mut figure.columns {
            let time_s = velocity.twists.len() as f64 * period_s;
            for twists in [&mut velocity.twists, &mut velocity.own] {
                *twists = twists.iter().step_by(apart).copied().collect();
            }
            (velocity.period_s, velocity.periods) = (apart as f64 * period_s, periods / apart);
            plane.path = plane.path.iter().step_by(apart).cloned().collect();
            plane.ellipses = plane.ellipses.iter().step_by(apart).cloned().collect();
            let Some(cycle) = run.last() else { continue };
            plane.foreseen = cycle.foreseen().map(Iterator::collect).collect();
            let state = TwistState::from_code(cycle.state);
            let state = state.map_or_else(String::new, |state| format!(": {state}"));
            let hold = cycle
                .hold()
                .map_or_else(String::new, |hold| format!(", {hold}"));
            plane.title = format!("{time_s:.1} s{state}{hold}");
        }
        figure.canvas()
    };
    let last = run.len().saturating_sub(1);
    let frames = (0..last).step_by(every).chain([last]).map(frame);
    Animation {
        frames: frames.collect(),
        period_s: FRAME_S[0].max(period_s),
        last_s: FRAME_S[1],
    }
}

/// The joints of the scene's arm in a run; `None` where the robot does not tell as many.
fn joints(
    scene: &Scene,
    run: &[&CycleRecord],
    states: &[RobotState],
    name: &str,
) -> Option<Joints> {
    let (arm, begin_ns) = (scene.arm.as_ref()?, run.first()?.stamp.data_ns);
    let end_ns = run.last()?.stamp.data_ns;
    let during = states.iter().filter(|state| {
        let is_whole = state.joints as usize == arm.joints.len();
        is_whole && (begin_ns..=end_ns).contains(&state.stamp.published_ns)
    });
    let during: Vec<_> = during.collect();
    let during: Vec<_> = (during.iter())
        .step_by(during.len().div_ceil(FINE).max(1))
        .collect();
    during.first()?;
    let seconds = |ns: u64| ns.saturating_sub(begin_ns) as f64 / 1e9;
    let limits = arm.joints.iter().map(|joint| {
        let [least, most] = joint.range;
        [least, most, joint.velocity]
    });
    Some(Joints {
        time_s: (during.iter())
            .map(|state| seconds(state.stamp.published_ns))
            .collect(),
        q: during.iter().map(|state| state.q).collect(),
        dq: during.iter().map(|state| state.dq).collect(),
        limits: limits.collect(),
        margin: arm.margin,
        bound: bound(run, seconds),
        marks: Vec::new(),
        title: format!("{name}: joints"),
    })
}

/// The spans of time in which a joint binds the command.
fn bound(run: &[&CycleRecord], seconds: impl Fn(u64) -> f64) -> Vec<(usize, [f64; 2])> {
    let mut spans: Vec<(usize, [f64; 2])> = Vec::new();
    let mut last = None;
    for cycle in run {
        let found = cycle.bound();
        let found = found.filter(|b| matches!(b.kind, ArmBound::Range | ArmBound::Speed));
        let joint = found.map(|bound| bound.index);
        let now_s = seconds(cycle.stamp.data_ns);
        match (joint, spans.last_mut()) {
            (Some(joint), Some((_, [_, end]))) if last == Some(joint) => *end = now_s,
            (Some(joint), _) => spans.push((joint, [now_s; 2])),
            (None, _) => (),
        }
        last = joint;
    }
    spans
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
    use figures::Canvas;
    use messages::Hold;

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
    fn a_film_shows_a_stop_on_one_axis_of_time() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let cycles = (1..=30).map(|number| {
            let mut record = cycle(number, number);
            let (state, hold) = match number < 20 {
                true => (TwistState::Moving, None),
                false => (TwistState::Disarmed, Some(Hold::Operator)),
            };
            (record.state, record.hold) = (state.code(), Hold::number(hold));
            record.twist = [0.01 * number as f64, 0.0, 0.0, 0.0, 0.0, 0.0];
            record
        });
        let cycles: Vec<_> = cycles.collect();
        let run: Vec<_> = cycles.iter().collect();
        let film = film(&scene, &run);
        // One every 0.1 s, and the last.
        let frames: Vec<_> = film.frames.iter().map(Canvas::svg).collect();
        assert_eq!(frames.len(), 11);
        let tells = |frame: &str, words: &str| frame.contains(words);
        assert!(tells(&frames[5], ">0.5 s: moving<"), "{}", frames[5]);
        assert!(tells(&frames[10], ">1.0 s: disarmed, operator<"));
        // Each has the whole time below.
        let times = |frame: &String| frame.matches(">0.8<").count();
        assert!(frames.iter().all(|frame| times(frame) == 1));
    }

    #[test]
    fn joints_are_drawn_of_the_scenes_arm_with_the_spans_in_which_one_binds() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
        let scene = Scene::parse(&text, path).unwrap();
        let cycles = (1..=9).map(|number| {
            let joint = [0, 4, 4, 4, 0, 4, 2, 2, 0][number as usize - 1];
            CycleRecord {
                arm_bound: u32::from(joint > 0),
                arm_bound_index: joint,
                ..cycle(number, number)
            }
        });
        let cycles: Vec<_> = cycles.collect();
        let run: Vec<_> = cycles.iter().collect();
        let states = (1..=9000_u64).map(|k| {
            let mut state = RobotState {
                joints: 7,
                ..RobotState::default()
            };
            state.stamp.published_ns = k * 100_000;
            state
        });
        let mut states: Vec<_> = states.collect();
        let drawn = joints(&scene, &run, &states, "run").unwrap();
        // Those from the first cycle to the last.
        assert!((1000..=2000).contains(&drawn.q.len()), "{}", drawn.q.len());
        assert!(drawn.time_s[0] < 0.001 && (0.26..0.2667).contains(drawn.time_s.last().unwrap()));
        assert_eq!((drawn.limits.len(), drawn.margin), (7, 0.2));
        let spans = drawn.bound.iter().map(|(joint, [from, to])| {
            let periods = |t: &f64| (t * 30.0).round() as usize;
            (*joint, periods(from), periods(to))
        });
        assert!(
            spans.eq([(4, 1, 3), (4, 5, 5), (2, 6, 7)]),
            "{:?}",
            drawn.bound
        );
        states.iter_mut().for_each(|state| state.joints = 6);
        assert!(joints(&scene, &run, &states, "run").is_none());
    }

    #[test]
    fn a_command_stands_for_a_while_where_records_are_missing() {
        let cycles = [cycle(10, 1), cycle(11, 2), cycle(18, 9)];
        let run: Vec<_> = cycles.iter().collect();
        let vx: Vec<_> = twists(&run, 1.0 / 30.0).sent.iter().map(|v| v[0]).collect();
        assert_eq!(vx, [10.0, 11.0, 11.0, 11.0, 11.0, 0.0, 0.0, 0.0, 18.0]);
    }
}
