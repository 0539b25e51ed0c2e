//! One closed-loop run: the law against the emulator's camera, judged by the emulator's referee.

use std::time::Instant;

use hw_sim::referee::INSTANTS;
use hw_sim::sensor::{Flaws, Sensor};
use hw_sim::{End, FreeCamera, Referee};
use scene::{Pose, Scene};
use serde::Serialize;
use vpc::{Controller, Measurement, MotionMemory, Refusal, Step};

/// What happened in a run.
#[derive(Clone, Debug, Serialize)]
pub struct Run {
    /// Whether the goal was reached in time without a violation.
    pub success: bool,
    /// Why not.
    pub reason: Option<Reason>,
    /// Cycles until the run was decided.
    pub steps: usize,
    /// Mean over the cycles of the scene's time of l(v) / Np, against the goal (paper, Table I).
    pub cost: f64,
    /// Mean over the periods after arrival of the change of the command from one to the next, as a
    /// share of the limit (largest component); `None` if there were none.
    pub change: Option<f64>,
    /// Least clearance of a point from a border in a frame, px; negative inside.
    pub least_clearance_px: f64,
    /// The same at the instants between frames.
    pub least_between_px: f64,
    /// Time of each cycle of the law until the run was decided, us: filled by [`time`].
    #[serde(skip)]
    pub cycles_us: Vec<f64>,
    /// Time that foresight took after each of those cycles, us: filled by [`time`].
    #[serde(skip)]
    pub slack_us: Vec<f64>,
    /// Periods that it simulated: filled by [`time`].
    #[serde(skip)]
    pub simulated: u64,
    /// Iterations of the solver in those cycles.
    pub iterations: u64,
    /// Cycles whose solver ended without convergence.
    pub not_converged: u64,
    /// What was seen and sent, until the run was decided.
    #[serde(skip)]
    pub history: Vec<Moment>,
}

/// Why a run failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// A feature went too deep into an occlusion or out of the image.
    Violation,
    /// The scene's time ran out before the features arrived.
    NotConverged,
    /// A point of the pattern came behind the camera.
    LostSight,
}

/// Periods without a frame after which the twist is zero: the daemon's default.
const STALE_PERIODS: usize = 3;

/// One cycle of a run.
#[derive(Clone, Debug)]
pub struct Moment {
    /// True features, px.
    pub features: Vec<[f64; 2]>,
    /// What the camera delivered; `None` if no frame came.
    pub measured: Option<Measurement>,
    /// Whether the frame before was missing.
    pub gap: bool,
    /// The simulated time, ns.
    pub now_ns: u64,
    /// Twist sent.
    pub twist: [f64; 6],
    /// Way point tracked, px.
    pub way_point: Option<Vec<[f64; 2]>>,
}

/// Runs the law from a start for the scene's time, against a camera without flaws. As [`flawed`].
pub fn run(
    scene: &Scene,
    controller: &mut Controller,
    memory: Option<&dyn MotionMemory>,
    start: &Pose,
) -> Run {
    flawed(scene, controller, memory, start, Flaws::default())
}

/// Runs the law from a start for the scene's time, against a camera with these flaws. The run is
/// decided when the features arrive, when a constraint is violated, or when time is up; a run that
/// arrived goes on regulating, watched, so that the mean cost of every run is taken over the same
/// time.
///
/// Time is simulated: frame k is exposed at k sampling times, delivered `delay_frames` later, and
/// what answers it takes effect when it is delivered. Where no frame comes the last twist stands,
/// after three periods the zero twist.
pub fn flawed(
    scene: &Scene,
    controller: &mut Controller,
    memory: Option<&dyn MotionMemory>,
    start: &Pose,
    flaws: Flaws,
) -> Run {
    controller.reset();
    let ts = scene.sampling_time();
    let periods = (scene.success.time_s * scene.camera.rate_hz).round() as usize;
    let np = controller.settings().np as f64;
    let mut camera = FreeCamera::new(scene, start);
    let mut referee = Referee::new(scene);
    let mut sensor = Sensor::new(flaws);
    let (mut standing, mut silence) = ([0.0; 6], STALE_PERIODS);
    let mut run = Run {
        success: false,
        reason: Some(Reason::NotConverged),
        steps: periods,
        cost: 0.0,
        change: None,
        least_clearance_px: f64::INFINITY,
        least_between_px: f64::INFINITY,
        cycles_us: Vec::new(),
        slack_us: Vec::new(),
        simulated: 0,
        iterations: 0,
        not_converged: 0,
        history: Vec::new(),
    };
    let (mut cost, mut cycles) = (0.0, 0.0_f64);
    let limits = controller.task().limits;
    let mut changes = Vec::new();
    'run: for k in 0..periods {
        let seen = camera.features().map_err(|_| Reason::LostSight);
        let seen = seen.and_then(|features| match referee.judge(&features) {
            Some(End::Violation(_)) => Err(Reason::Violation),
            end => Ok((features, end.is_some())),
        });
        let (features, has_arrived) = match seen {
            Ok(seen) => seen,
            Err(reason) => {
                (run.success, run.reason, run.steps) = (false, Some(reason), k);
                break;
            }
        };
        if has_arrived && !run.success {
            (run.success, run.reason, run.steps) = (true, None, k);
        }
        let now_ns = (k as f64 * ts * 1e9).round() as u64;
        let frame = sensor.expose(&features, now_ns);
        let measured = frame
            .map(|frame| Measurement::from_points(&frame.points).taken(frame.exposure_ns, now_ns));
        let gap = silence > 0;
        let step = measured
            .as_ref()
            .map(|measured| cycle(controller, memory, measured, gap));
        let twist = match &step {
            Some(Ok(step)) => step.twist,
            // A refusal means the zero twist, as in the daemon; and so does silence.
            Some(Err(_)) => [0.0; 6],
            None if silence >= STALE_PERIODS => [0.0; 6],
            None => standing,
        };
        controller.sent(&twist, now_ns);
        controller.think(memory);
        if run.success {
            let shares = twist.iter().zip(&standing).zip(&limits);
            let shares = shares.map(|((now, before), limit)| (now - before).abs() / limit);
            changes.push(shares.fold(0.0, f64::max));
        }
        (standing, silence) = (twist, if step.is_some() { 0 } else { silence + 1 });
        cycles += 1.0;
        let step = step.and_then(Result::ok);
        if !run.success {
            run.history.push(Moment {
                features: features.to_vec(),
                measured,
                gap,
                now_ns,
                twist,
                way_point: step
                    .as_ref()
                    .and_then(|step| Some(step.way_point.as_ref()?.to_vec())),
            });
        }
        if let Some(step) = step {
            cost += step.cost / np;
            if !run.success {
                run.iterations += u64::from(step.iterations);
                run.not_converged += u64::from(!step.status.is_success());
            }
        }
        for _ in 1..INSTANTS {
            camera.advance(&twist, ts / f64::from(INSTANTS));
            let reason = match camera.features() {
                Ok(features) => referee.judge_between(&features).map(|_| Reason::Violation),
                Err(_) => Some(Reason::LostSight),
            };
            if reason.is_some() {
                // The next frame would tell.
                (run.success, run.reason, run.steps) = (false, reason, k + 1);
                break 'run;
            }
        }
        camera.advance(&twist, ts / f64::from(INSTANTS));
    }
    run.least_clearance_px = referee.least_clearance();
    run.least_between_px = referee.least_between();
    run.cost = cost / cycles.max(1.0);
    run.change = (!changes.is_empty()).then(|| changes.iter().sum::<f64>() / changes.len() as f64);
    run
}

/// One cycle of the law; a missing frame before it breaks the link.
fn cycle(
    controller: &mut Controller,
    memory: Option<&dyn MotionMemory>,
    measured: &Measurement,
    gap: bool,
) -> Result<Step, Refusal> {
    if gap {
        controller.skip_mismatch();
    }
    controller.step(measured, memory)
}

/// Replays the cycles of a run through the law `repeats` times and notes the median time of each:
/// other work on the machine disturbs a cycle here and there, not most repeats of the same one. The
/// caches are warm.
///
/// # Errors
/// [`NotRepeatable`] if a replay commands another twist than the run did, which the law never
/// may.
pub fn time(
    run: &mut Run,
    controller: &mut Controller,
    memory: Option<&dyn MotionMemory>,
    repeats: usize,
) -> Result<(), NotRepeatable> {
    let mut times = vec![Vec::with_capacity(repeats); run.history.len()];
    let mut slack = times.clone();
    run.simulated = 0;
    for _ in 0..repeats {
        controller.reset();
        for (cycle, moment) in run.history.iter().enumerate() {
            if let Some(measured) = &moment.measured {
                let begin = Instant::now();
                let step = self::cycle(controller, memory, measured, moment.gap);
                times[cycle].push(micros(begin));
                if step.map_or([0.0; 6], |step| step.twist) != moment.twist {
                    return Err(NotRepeatable { cycle });
                }
            }
            controller.sent(&moment.twist, moment.now_ns);
            let begin = Instant::now();
            controller.think(memory);
            slack[cycle].push(micros(begin));
            run.simulated += u64::from(controller.foreseen().periods);
        }
    }
    run.simulated /= repeats.max(1) as u64;
    run.cycles_us = times.into_iter().filter_map(median).collect();
    run.slack_us = slack.into_iter().filter_map(median).collect();
    Ok(())
}

/// Time since then, us.
fn micros(begin: Instant) -> f64 {
    begin.elapsed().as_secs_f64() * 1e6
}

fn median(mut times: Vec<f64>) -> Option<f64> {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied()
}

/// A replay that differs from its run.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error(
    "cycle {cycle}: the replay commands another twist than the run; allowed: the same, bit for bit"
)]
pub struct NotRepeatable {
    /// The first cycle that differs.
    pub cycle: usize,
}
