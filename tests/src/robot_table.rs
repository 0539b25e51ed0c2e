//! `cargo table -- --robot panda`: strategies on the same starts against the emulated robot, in simulated time.

use std::fs;
use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use hw_sim::eye::Sight;
use hw_sim::robot::bridge::Shaping;
use hw_sim::robot::calibration::Truth;
use hw_sim::robot::rig::RigSettings;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, UnitSphere};
use scene::{Pose, Scene};
use serde::Serialize;
use vpc::{Controller, MotionMemory, Settings, SolverOptions};

use crate::robot::{Reason, RobotRun, run};
use crate::spec::Spec;

/// The robot and its law.
#[derive(Args, Clone, Debug)]
pub struct RobotFlags {
    /// From the middle of an exposure to the delivery, ms.
    #[arg(long, value_name = "MS", default_value_t = 110.0)]
    pub delay_ms: f64,
    /// Deviation of that to either side, ms.
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    pub jitter_ms: f64,
    /// Where the features come from.
    #[arg(long, value_enum, default_value = "ideal")]
    pub camera: Sight,
    /// True focal lengths are larger by this share.
    #[arg(
        long,
        value_name = "E",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub focal_error: f64,
    /// The true camera sits this far from where the calibration has it, in a direction of each start's own, cm.
    #[arg(long, value_name = "CM", default_value_t = 0.0)]
    pub hand_eye_cm: f64,
    /// ... and is turned by this angle about an axis of each start's own, deg.
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    pub hand_eye_deg: f64,
    /// The memory is asked from here on: clearance of a feature from an occlusion, px.
    #[arg(long, value_name = "PX", default_value_t = 30.0)]
    pub trigger: f64,
    /// ... and until every feature is this many times further away.
    #[arg(long, value_name = "X", default_value_t = 2.0)]
    pub release: f64,
    /// Extra clearance that the law keeps from every border, px.
    #[arg(long, value_name = "PX", default_value_t = MARGIN)]
    pub margin: f64,
    /// Sends the 30 Hz staircase to the robot as it is.
    #[arg(long)]
    pub unshaped: bool,
    /// Only this start.
    #[arg(long, value_name = "INDEX")]
    pub only: Option<usize>,
}

impl Default for RobotFlags {
    /// The defaults of the command line.
    fn default() -> Self {
        Self {
            delay_ms: 110.0,
            jitter_ms: 0.0,
            camera: Sight::Ideal,
            focal_error: 0.0,
            hand_eye_cm: 0.0,
            hand_eye_deg: 0.0,
            trigger: 30.0,
            release: 2.0,
            margin: MARGIN,
            unshaped: false,
            only: None,
        }
    }
}

/// Clearance that the law keeps in the robot's scene, px: none, as in the paper.
pub const MARGIN: f64 = 0.0;

/// What is the same for both kinds of table.
#[derive(Clone, Copy, Debug)]
pub struct Common<'a> {
    /// Strategies to run.
    pub strategies: &'a [Spec],
    /// Pixel noise, px.
    pub noise: f64,
    /// Share of lost frames.
    pub drop: f64,
    /// Pattern and distances are larger by this share than the law believes.
    pub depth_error: f64,
    /// Seed; each start adds its index.
    pub seed: u64,
    /// The law's choices that the command line makes for both.
    pub settings: Settings,
}

/// A row.
#[derive(Clone, Debug, Serialize)]
pub struct RobotRow {
    /// Strategy and window.
    pub strategy: String,
    /// Share of successful runs, 0 to 1.
    pub success_rate: f64,
    /// Runs that failed because of a violation.
    pub violations: usize,
    /// ... a marker that stayed hidden.
    pub markers_lost: usize,
    /// ... time.
    pub time_outs: usize,
    /// ... a reflex.
    pub reflexes: u64,
    /// Milliseconds beyond a limit, all runs.
    pub limit_violations: u64,
    /// Milliseconds with a discontinuity, all runs.
    pub discontinuities: u64,
    /// Mean time to arrival of the successful runs, s; none where there are none.
    pub arrived_s: Option<f64>,
    /// Mean running cost over Np.
    pub cost: f64,
    /// Largest shares of the joints' limits in any run: speed, acceleration, jerk.
    pub joint_shares: [f64; 3],
}

/// One run in the document.
#[derive(Clone, Debug, Serialize)]
pub struct RobotRecord {
    start: usize,
    strategy: String,
    success: bool,
    reason: Option<Reason>,
    arrived_s: Option<f64>,
    time_s: f64,
    least_clearance_px: f64,
    error_px: f64,
    hidden_frames: u64,
    cost: f64,
    arm: hw_sim::robot::inspector::ArmReport,
}

/// What the table came to.
#[derive(Clone, Debug, Serialize)]
pub struct RobotDocument {
    /// A row a strategy.
    pub rows: Vec<RobotRow>,
    /// Every run.
    pub runs: Vec<RobotRecord>,
}

/// The law's settings for the robot: the paper's on-line settings of its second experiment.
pub fn law(spec: Spec, flags: &RobotFlags, base: Settings) -> Settings {
    Settings {
        strategy: spec.strategy,
        np: spec.np,
        solver: SolverOptions {
            max_iterations: 10,
            tolerance: 1e-6,
        },
        trigger_px: flags.trigger,
        hysteresis: flags.release,
        margin_px: flags.margin,
        ..base
    }
}

/// The cell for one start.
pub fn cell(scene: &Scene, flags: &RobotFlags, common: &Common, start: usize) -> RigSettings {
    let mut settings = RigSettings::new(scene);
    let seed = common.seed.wrapping_add(start as u64);
    // Directions of calibration errors: of each start's own, the same for every size.
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let mut direction = |length: f64| -> [f64; 3] {
        let unit: [f64; 3] = UnitSphere.sample(&mut random);
        unit.map(|x| x * length)
    };
    settings.arm.truth = Truth {
        focal: flags.focal_error,
        hand_eye_m: direction(0.01 * flags.hand_eye_cm),
        hand_eye_deg: direction(flags.hand_eye_deg),
        depth: common.depth_error,
        ..Truth::default()
    };
    if flags.unshaped {
        settings.arm.shaping = Shaping::Off;
    }
    settings.eye.sight = flags.camera;
    settings.eye.noise_px = common.noise;
    settings.eye.seed = seed;
    settings.eye.latency.latency_ns = (flags.delay_ms * 1e6).round() as u64;
    settings.eye.latency.jitter_ns = (flags.jitter_ms * 1e6).round() as u64;
    settings.eye.latency.drop = common.drop;
    settings.eye.latency.seed = seed;
    settings
}

/// Checks the flags.
///
/// # Errors
/// Names the flag, the value and what is allowed.
pub fn check(flags: &RobotFlags, starts: usize) -> anyhow::Result<()> {
    for (flag, value, least, most) in [
        ("--delay-ms", flags.delay_ms, 0.0, 900.0),
        ("--jitter-ms", flags.jitter_ms, 0.0, flags.delay_ms),
        ("--focal-error", flags.focal_error, -0.5, 0.5),
        ("--hand-eye-cm", flags.hand_eye_cm, 0.0, 20.0),
        ("--hand-eye-deg", flags.hand_eye_deg, 0.0, 30.0),
    ] {
        if !(least..=most).contains(&value) {
            bail!("{flag} = {value}; allowed: {least} to {most}");
        }
    }
    if let Some(only) = flags.only.filter(|&only| only >= starts) {
        bail!("--only = {only}; allowed: 0 to {}", starts - 1);
    }
    Ok(())
}

/// Runs every strategy on every start, on all processors; the order of runs makes no difference to them.
///
/// # Errors
/// A start out of reach, a setting out of its range.
pub fn table(
    scene: &Scene,
    starts: &[Pose],
    memory: Option<&(dyn MotionMemory + Sync)>,
    flags: &RobotFlags,
    common: &Common,
    tick: &(dyn Fn() + Sync),
) -> anyhow::Result<(RobotDocument, Vec<Vec<RobotRun>>)> {
    check(flags, starts.len())?;
    let mut document = RobotDocument {
        rows: Vec::new(),
        runs: Vec::new(),
    };
    let mut all = Vec::new();
    for &spec in common.strategies {
        let chosen: Vec<usize> = match flags.only {
            Some(only) => vec![only],
            None => (0..starts.len()).collect(),
        };
        let runs = side_by_side(&chosen, |start| {
            let mut controller =
                Box::new(Controller::new(scene, law(spec, flags, common.settings))?);
            let settings = cell(scene, flags, common, start);
            let memory = memory.map(|memory| memory as &dyn MotionMemory);
            let run = run(scene, &settings, &mut controller, memory, &starts[start])
                .with_context(|| format!("start {start}"))?;
            tick();
            Ok(run)
        })?;
        document.rows.push(row(spec, &runs));
        let records = chosen.iter().zip(&runs);
        document
            .runs
            .extend(records.map(|(&start, run)| record(spec, start, run)));
        all.push(runs);
    }
    Ok((document, all))
}

/// Applies `work` to every item, on all processors.
fn side_by_side<T: Send>(
    items: &[usize],
    work: impl Fn(usize) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let work = &work;
    let mut parts: Vec<Vec<anyhow::Result<T>>> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..threads)
            .map(|first| {
                // The law's workspace is large.
                let builder = std::thread::Builder::new().stack_size(16 << 20);
                builder.spawn_scoped(scope, move || {
                    let mine = items.iter().skip(first).step_by(threads);
                    mine.map(|&item| work(item)).collect::<Vec<_>>()
                })
            })
            .collect();
        handles
            .into_iter()
            .map(|handle| match handle.map(|thread| thread.join()) {
                Ok(Ok(results)) => results,
                Ok(Err(_)) => vec![Err(anyhow::anyhow!("a run panicked"))],
                Err(error) => vec![Err(error.into())],
            })
            .collect()
    });
    let mut results = Vec::with_capacity(items.len());
    parts.iter_mut().for_each(|part| part.reverse());
    for k in 0..items.len() {
        match parts[k % threads].pop() {
            Some(result) => results.push(result?),
            None => bail!("run {k} is missing"),
        }
    }
    Ok(results)
}

fn row(spec: Spec, runs: &[RobotRun]) -> RobotRow {
    let count = runs.len().max(1) as f64;
    let because = |reason| runs.iter().filter(|run| run.reason == Some(reason)).count();
    let good: Vec<f64> = runs
        .iter()
        .filter(|run| run.success)
        .filter_map(|run| run.arrived_s)
        .collect();
    let most = |share: fn(&RobotRun) -> f64| runs.iter().map(share).fold(0.0, f64::max);
    RobotRow {
        strategy: spec.to_string(),
        success_rate: runs.iter().filter(|run| run.success).count() as f64 / count,
        violations: because(Reason::Violation),
        markers_lost: because(Reason::MarkerLost),
        time_outs: because(Reason::TimeOut),
        reflexes: runs.iter().map(|run| run.arm.reflexes).sum(),
        limit_violations: runs.iter().map(|run| run.arm.limit_violations).sum(),
        discontinuities: runs.iter().map(|run| run.arm.discontinuities).sum(),
        arrived_s: (!good.is_empty()).then(|| good.iter().sum::<f64>() / good.len() as f64),
        cost: runs.iter().map(|run| run.cost).sum::<f64>() / count,
        joint_shares: [
            most(|run| run.arm.joint_velocity),
            most(|run| run.arm.joint_acceleration),
            most(|run| run.arm.joint_jerk),
        ],
    }
}

fn record(spec: Spec, start: usize, run: &RobotRun) -> RobotRecord {
    RobotRecord {
        start,
        strategy: spec.to_string(),
        success: run.success,
        reason: run.reason,
        arrived_s: run.arrived_s,
        time_s: run.time_s,
        least_clearance_px: run.least_clearance_px,
        error_px: run.error_px,
        hidden_frames: run.hidden,
        cost: run.cost,
        arm: run.arm.clone(),
    }
}

/// The rows as a Markdown table, and the starts that failed.
pub fn markdown(document: &RobotDocument) -> String {
    let mut text = String::from(
        "| strategy | success (%) | violation | marker lost | time out | reflexes | limit violations | discontinuities | \
         arrival (s) | cost l/Np | joint speed, acceleration, jerk (% of limit) |\n\
         |---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n",
    );
    for row in &document.rows {
        let [speed, push, snap] = row.joint_shares.map(|share| 100.0 * share);
        text += &format!(
            "| {} | {:.0} | {} | {} | {} | {} | {} | {} | {} | {:.4} | {speed:.0}, {push:.0}, {snap:.0} |\n",
            row.strategy,
            100.0 * row.success_rate,
            row.violations,
            row.markers_lost,
            row.time_outs,
            row.reflexes,
            row.limit_violations,
            row.discontinuities,
            row.arrived_s.map_or("-".to_owned(), |s| format!("{s:.1}")),
            row.cost,
        );
    }
    for row in &document.rows {
        let failed = document
            .runs
            .iter()
            .filter(|run| run.strategy == row.strategy && !run.success);
        let failed: Vec<String> = failed.map(|run| run.start.to_string()).collect();
        if !failed.is_empty() {
            text += &format!("\n{} failed from {}", row.strategy, failed.join(", "));
        }
    }
    text
}

/// Writes the document.
///
/// # Errors
/// The file cannot be written.
pub fn write(document: &RobotDocument, path: &PathBuf, out: &mut impl Write) -> anyhow::Result<()> {
    if let Some(directory) = path.parent().filter(|d| !d.as_os_str().is_empty()) {
        fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    }
    fs::write(path, serde_json::to_vec_pretty(document)?)
        .with_context(|| format!("{}: cannot write", path.display()))?;
    writeln!(out, "wrote {}", path.display())?;
    Ok(())
}
