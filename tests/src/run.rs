//! One closed-loop run: the daemon's decision step against the emulator's camera, judged by the
//! emulator's referee.

use std::fmt;
use std::time::Instant;

use decision::Inputs;
use hw_sim::camera::{outlines, project};
use hw_sim::cost::running_cost;
use hw_sim::following::{Following, FollowingReport};
use hw_sim::motion::{Motion, relative};
use hw_sim::pose::RigidPose;
use hw_sim::referee::INSTANTS;
use hw_sim::sensor::{Flaws, Frame, Sensor};
use hw_sim::{End, FreeCamera, Referee};
use messages::{CycleRecord, Features, Hold, SolverStatus, TwistState};
use nalgebra::Rotation3;
use scene::{Pose, Scene};
use serde::Serialize;

use crate::simulated::Simulated;
use crate::statistics::mean;
use crate::steering::Steering;

/// What happened in a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Run {
    /// Whether the goal was reached in time without a violation.
    pub success: bool,
    /// Why not.
    pub reason: Option<Reason>,
    /// Why the daemon disarmed, if it did.
    pub cause: Option<String>,
    /// Cycles until the run was decided.
    pub steps: usize,
    /// Mean over the cycles of the scene's time of l(v) / Np, against the goal (paper, Table I).
    pub cost: f64,
    /// That Np: periods for which the cost of a command is counted.
    pub np: usize,
    /// Mean over the periods after arrival of the change of the command from one to the next, as a
    /// share of the limit (largest component); `None` if there were none.
    pub change: Option<f64>,
    /// Time from the begin until the daemon calls it arrived: at the goal, and the twist near zero,
    /// s; `None` if that was not so in the scene's time.
    pub standstill_s: Option<f64>,
    /// Error of the object's pose in the camera frame at the end of a run that arrived:
    /// translation, mm, and rotation, mrad.
    pub pose_error: Option<[f64; 2]>,
    /// How well the camera followed after the arrival, where that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<FollowingReport>,
    /// Least clearance of a point from a border in a frame, px; negative inside.
    pub least_clearance_px: f64,
    /// The same at the instants between frames.
    pub least_between_px: f64,
    /// Where markers have a size: least clearance of any marker's edge at all these instants, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_edge_px: Option<f64>,
    /// Time of each decision until the run was decided, us: filled by [`time`], and from an external
    /// method's [`times`](crate::external::External::times_us).
    pub cycles_us: Vec<f64>,
    /// Time that foresight took after each of those cycles, us: filled by [`time`].
    pub slack_us: Vec<f64>,
    /// Periods that it simulated: filled by [`time`].
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
    /// The daemon disarmed, also after the features arrived.
    Disarmed,
    /// A command was beyond the limits of velocity or acceleration.
    BeyondLimits,
}

/// One cycle of a run.
#[derive(Clone, Debug)]
pub struct Moment {
    /// True features, px.
    pub features: Vec<[f64; 2]>,
    /// What the daemon received.
    pub inputs: Inputs,
    /// Twist sent.
    pub twist: [f64; 6],
    /// Way point tracked, px.
    pub way_point: Option<Vec<[f64; 2]>>,
    /// The way of each point that foresight expects, px.
    pub foreseen: Vec<Vec<[f64; 2]>>,
}

/// Runs the daemon from a start for the scene's time, against a camera without flaws. As
/// [`flawed`].
pub fn run(scene: &Scene, daemon: &mut Simulated, start: &Pose) -> Run {
    flawed(scene, daemon, start, Flaws::default())
}

/// What a run goes through, besides the scene.
#[derive(Clone, Debug)]
pub struct World {
    /// Flaws of the camera.
    pub flaws: Flaws,
    /// How the pattern moves, from the begin of the run on.
    pub motion: Motion,
    /// The camera moves by its command times this.
    pub gain: f64,
    /// How long the following is measured after the arrival, s; 0: not at all.
    pub follow_s: f64,
}

impl From<Flaws> for World {
    /// The pattern rests, and the camera moves as told.
    fn from(flaws: Flaws) -> Self {
        Self {
            flaws,
            motion: Motion::default(),
            gain: 1.0,
            follow_s: 0.0,
        }
    }
}

/// Runs the daemon from a start for the scene's time, against a camera with these flaws. As
/// [`through`].
pub fn flawed(scene: &Scene, daemon: &mut Simulated, start: &Pose, flaws: Flaws) -> Run {
    let Ok(run) = through(scene, daemon, start, &flaws.into());
    run
}

/// Lets `steering` run from a start for the scene's time, or until the following is measured, if
/// that takes longer. The run is decided when the features arrive, when a constraint is violated,
/// when a command is beyond the limits, when the daemon disarms, or when time is up; a run that
/// arrived goes on regulating, watched, so that the mean cost of every run is taken over the same
/// time.
///
/// Time is simulated: frame k is exposed at k sampling times, delivered `delay_frames` later, and
/// what answers it takes effect when it is delivered.
///
/// # Errors
/// `steering` gives no command.
pub fn through<S: Steering>(
    scene: &Scene,
    steering: &mut S,
    start: &Pose,
    world: &World,
) -> Result<Run, S::Error> {
    steering.begin()?;
    let ts = scene.sampling_time();
    let periods = (scene.success.time_s * scene.camera.rate_hz).round() as usize;
    let np = steering.np();
    let mut camera = FreeCamera::new(scene, start);
    let mut referee = Referee::new(scene);
    let mut sensor = Sensor::new(scene, world.flaws);
    let mut following = Following::new(scene, world.follow_s);
    let following_s = following.end_s();
    let mut run = Run {
        success: false,
        reason: Some(Reason::NotConverged),
        cause: None,
        steps: periods,
        cost: 0.0,
        np,
        change: None,
        standstill_s: None,
        pose_error: None,
        following: None,
        least_clearance_px: f64::INFINITY,
        least_between_px: f64::INFINITY,
        least_edge_px: None,
        cycles_us: Vec::new(),
        slack_us: Vec::new(),
        simulated: 0,
        iterations: 0,
        not_converged: 0,
        history: Vec::new(),
    };
    let (mut cost, mut cycles) = (0.0, 0.0_f64);
    let limits = steering.task().limits;
    let mut standing = [0.0; 6];
    let mut changes = Vec::new();
    // The object where it is at an instant: the camera's own pose of it is the one at rest.
    let object = |camera: &FreeCamera, time_s| world.motion.moved(&camera.pose, time_s);
    let mut last = periods;
    let (mut k, mut frames) = (0, 0);
    'run: while k < last {
        let time_s = k as f64 * ts;
        let pose = object(&camera, time_s);
        referee.measure_edges(outlines(scene, &pose));
        let seen = project(scene, &pose).map_err(|_| Reason::LostSight);
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
            last = periods.max(k + 1 + (following_s / ts).ceil() as usize);
        }
        let now_ns = (time_s * 1e9).round() as u64;
        let frame = sensor.expose(&features, now_ns);
        frames += u64::from(frame.is_some());
        let frame = frame.map(|frame| message(&frame, frames));
        let inputs = Simulated::received(frame, now_ns);
        let record = steering.answer(&inputs)?;
        let twist = record.twist;
        let moving = twist.map(|v| world.gain * v);
        if k < periods {
            let seen = relative(&moving, &world.motion.twist(&camera.pose, time_s));
            cost += running_cost(scene, referee.goal(), &pose, &seen, np).unwrap_or(0.0);
            cycles += 1.0;
        }
        let reason = if record.state == TwistState::Disarmed.code() {
            Some(Reason::Disarmed)
        } else {
            let is_within = steering.is_within_limits(&twist, &standing);
            (!is_within).then_some(Reason::BeyondLimits)
        };
        if let Some(reason) = reason {
            (run.success, run.reason, run.steps) = (false, Some(reason), k);
            run.cause = Hold::from_code(record.hold).map(|hold| hold.to_string());
            break;
        }
        if record.state == TwistState::Arrived.code() {
            run.standstill_s.get_or_insert(time_s);
        }
        if run.success {
            let shares = twist.iter().zip(&standing).zip(&limits);
            let shares = shares.map(|((now, before), limit)| (now - before).abs() / limit);
            changes.push(shares.fold(0.0, f64::max));
            following.add((k - run.steps) as f64 * ts, &features, &pose, &twist);
        } else {
            run.iterations += u64::from(record.iterations);
            run.not_converged += u64::from(!has_converged(&record));
            run.history.push(Moment {
                features: features.to_vec(),
                inputs,
                twist,
                way_point: way_point(&record),
                foreseen: record.foreseen().map(Iterator::collect).collect(),
            });
        }
        standing = twist;
        for instant in 1..INSTANTS {
            camera.advance(&moving, ts / f64::from(INSTANTS));
            let share = f64::from(instant) / f64::from(INSTANTS);
            let pose = object(&camera, time_s + share * ts);
            referee.measure_edges(outlines(scene, &pose));
            let reason = match project(scene, &pose) {
                Ok(features) => referee.judge_between(&features).map(|_| Reason::Violation),
                Err(_) => Some(Reason::LostSight),
            };
            if reason.is_some() {
                // The next frame would tell.
                (run.success, run.reason, run.steps) = (false, reason, k + 1);
                break 'run;
            }
        }
        camera.advance(&moving, ts / f64::from(INSTANTS));
        k += 1;
    }
    run.pose_error = (run.success).then(|| pose_error(scene, &object(&camera, k as f64 * ts)));
    run.following = following.report().filter(|_| run.success);
    run.least_clearance_px = referee.least_clearance();
    run.least_between_px = referee.least_between();
    run.least_edge_px = referee.least_edge();
    run.cost = cost / cycles.max(1.0);
    run.change = mean(changes.into_iter());
    Ok(run)
}

/// The message of a frame, by its number.
fn message(frame: &Frame, sequence: u64) -> Features {
    let mut features = Features::new(&frame.points, frame.exposure_ns);
    features.stamp.sequence = sequence;
    features.visible = frame.visible;
    features
}

/// How far the object is from its pose at the goal: mm and mrad.
fn pose_error(scene: &Scene, object: &RigidPose) -> [f64; 2] {
    let goal = hw_sim::pose::from_scene(&scene.goal);
    let away = goal.translation.vector - object.translation.vector;
    [
        1e3 * away.norm(),
        1e3 * angle(&object.rotation, &goal.rotation),
    ]
}

/// The angle between two rotations, rad: by the sine of its half, which is exact where the arc
/// cosine of a trace is a NaN.
fn angle(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    let apart = (a.matrix() - b.matrix()).norm();
    2.0 * (apart / 8.0_f64.sqrt()).min(1.0).asin()
}

fn has_converged(record: &CycleRecord) -> bool {
    let status = SolverStatus::from_code(record.status);
    matches!(
        status,
        Some(SolverStatus::Idle | SolverStatus::Converged | SolverStatus::Stalled)
    )
}

/// The way point that a cycle tracked, px.
pub fn way_point(record: &CycleRecord) -> Option<Vec<[f64; 2]>> {
    let pairs = record.way_point.as_chunks().0.iter().copied();
    let points = pairs.take(record.way_point_count as usize).collect();
    (record.way_point_count > 0).then_some(points)
}

/// Replays the cycles of a run through the daemon `repeats` times and notes the median time of
/// each: other work on the machine disturbs a cycle here and there, not most repeats of the same
/// one. The caches are warm.
///
/// # Errors
/// [`NotRepeatable`] if a replay commands another twist than the run did, which the daemon
/// never may.
pub fn time(run: &mut Run, daemon: &mut Simulated, repeats: usize) -> Result<(), NotRepeatable> {
    let mut times = vec![Vec::with_capacity(repeats); run.history.len()];
    let mut slack = times.clone();
    run.simulated = 0;
    for _ in 0..repeats {
        daemon.restart();
        for (cycle, moment) in run.history.iter().enumerate() {
            let begin = Instant::now();
            let record = daemon.decide(&moment.inputs);
            times[cycle].push(micros(begin));
            if record.twist != moment.twist {
                return Err(NotRepeatable { cycle });
            }
            let begin = Instant::now();
            daemon.think();
            slack[cycle].push(micros(begin));
            run.simulated += u64::from(daemon.law().foreseen().simulated);
        }
    }
    run.simulated /= repeats.max(1) as u64;
    run.cycles_us = times.into_iter().filter_map(median).collect();
    run.slack_us = slack.into_iter().filter_map(median).collect();
    Ok(())
}

/// Bytes written to empty the caches: more than they hold.
const COLD_BYTES: usize = 48 << 20;

/// Times of decisions, us, that find their code and data in the caches, that do not, and that do
/// not but were rehearsed.
#[derive(Clone, Debug, Default)]
pub struct Caches {
    warm: Vec<f64>,
    cold: Vec<f64>,
    rehearsed: Vec<f64>,
    /// What is written to empty them.
    other: Vec<u8>,
}

impl Caches {
    /// Replays a run once for each; `cycles_us` of [`time`] are the warm ones.
    pub fn time(&mut self, run: &Run, daemon: &mut Simulated) {
        self.warm.extend(&run.cycles_us);
        for is_rehearsed in [false, true] {
            daemon.restart();
            for moment in &run.history {
                self.empty();
                if is_rehearsed {
                    daemon.rehearse(moment.inputs.now_ns);
                }
                let begin = Instant::now();
                std::hint::black_box(daemon.decide(&moment.inputs));
                let times = match is_rehearsed {
                    false => &mut self.cold,
                    true => &mut self.rehearsed,
                };
                times.push(micros(begin));
                daemon.think();
            }
        }
    }

    fn empty(&mut self) {
        self.other.resize(COLD_BYTES, 0);
        for line in self.other.chunks_mut(64) {
            line[0] = line[0].wrapping_add(1);
        }
        std::hint::black_box(&mut self.other);
    }
}

impl fmt::Display for Caches {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let of = |times: &Vec<f64>| median(times.clone()).unwrap_or(f64::NAN);
        let (warm, cold, rehearsed) = (of(&self.warm), of(&self.cold), of(&self.rehearsed));
        write!(
            f,
            "a decision takes {warm:.1} us with warm caches, {cold:.1} with cold ones ({:.1} times), {rehearsed:.1} with cold ones when it was rehearsed ({:.1} times): medians over {} decisions",
            cold / warm,
            rehearsed / warm,
            self.cold.len()
        )
    }
}

/// Time since then, us: whole nanoseconds.
fn micros(begin: Instant) -> f64 {
    begin.elapsed().as_nanos() as f64 / 1e3
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

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::angle;

    #[test]
    fn the_angle_between_rotations_is_a_number() {
        for k in 0..1000 {
            let a = Rotation3::new(Vector3::new(0.3, -0.4, 0.01 * f64::from(k)));
            assert!(angle(&a, &a) < 1e-15);
            let b = a * Rotation3::new(Vector3::new(0.0, 2e-6, 0.0));
            assert!((angle(&a, &b) - 2e-6).abs() < 1e-12);
        }
    }
}
