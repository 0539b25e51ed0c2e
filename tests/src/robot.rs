//! One closed-loop run of the daemon's decision step against the emulated robot, in simulated time:
//! no processes, no clocks, and the same bits in every run. Everything else is what `hw-sim` steps
//! in real time.

use hw_sim::End;
use hw_sim::cell::{Cell, Exposed, Order};
use hw_sim::eye::Shot;
use hw_sim::following::FollowingReport;
use hw_sim::motion::Motion;
use hw_sim::outcome::ReleaseReport;
use hw_sim::recording::ArmRecord;
use hw_sim::rig::{Rig, RigError, RigSettings};
use hw_sim::robot::inspector::ArmReport;
use messages::{CycleRecord, Features, Hold, TwistState};
use scene::{Pose, Scene};
use serde::Serialize;

use crate::edge::{Goal, ServoRule};
use crate::run::way_point;
use crate::simulated::Simulated;
use crate::steering::Steering;

/// Periods for which a command holds without a newer one, as the daemon's.
const PERIODS: f64 = 3.0;

/// The result of a run.
#[derive(Clone, Debug, Serialize)]
pub struct RobotRun {
    /// Whether the object was released at the goal and the robot retreated, without any violation.
    pub success: bool,
    /// Why not.
    pub reason: Option<Reason>,
    /// At a start at the edge of what the arm can do: whether it can be at the goal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
    /// Why the controller held the camera in the last cycle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hold: Option<String>,
    /// Seconds until the run was decided.
    pub time_s: f64,
    /// Seconds until the features arrived.
    pub arrived_s: Option<f64>,
    /// Least distance of a point from an occlusion or the border, px.
    pub least_clearance_px: f64,
    /// The same at the instants between frames.
    pub least_between_px: f64,
    /// Where markers have a size: least distance of any marker's edge, px; negative where one was
    /// partly hidden.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_edge_px: Option<f64>,
    /// True s - s* at the end, largest component, px.
    pub error_px: f64,
    /// Frames with a hidden marker.
    #[serde(rename = "hidden_frames")]
    pub hidden: u64,
    /// Mean over the cycles of l(v) / Np, against the goal.
    pub cost: f64,
    /// How well the camera followed after the arrival, where that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<FollowingReport>,
    /// How fast the camera moved relative to a pattern that moves, at the release.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release: Option<ReleaseReport>,
    /// What the robot's referee reports.
    pub arm: ArmReport,
    /// What was seen and sent at each exposure.
    #[serde(skip)]
    pub history: Vec<Sample>,
}

/// Why a run failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// A feature went too deep into an occlusion or out of the image.
    Violation,
    /// A marker was hidden for so long that the controller gave up.
    MarkerLost,
    /// The time ran out.
    TimeOut,
    /// The robot stopped itself.
    Reflex,
    /// The controller disarmed for another cause.
    Disarmed,
    /// A command was beyond the limits of velocity or acceleration.
    BeyondLimits,
}

impl Reason {
    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Violation => "violation",
            Self::MarkerLost => "marker lost",
            Self::TimeOut => "time out",
            Self::Reflex => "reflex",
            Self::Disarmed => "disarmed",
            Self::BeyondLimits => "beyond the limits",
        }
    }
}

/// The instant of an exposure.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Seconds since the start.
    pub time_s: f64,
    /// True features, px.
    pub features: Vec<[f64; 2]>,
    /// The command that stands.
    pub twist: [f64; 6],
    /// Way point tracked, px.
    pub way_point: Option<Vec<[f64; 2]>>,
    /// The robot.
    pub arm: ArmRecord,
}

/// What happens to a run.
#[derive(Clone, Debug)]
pub struct Course<'a> {
    /// How the object moves.
    pub motion: Motion,
    /// For how long the following is measured, from a second after the arrival on, s.
    pub follow_s: f64,
    /// What stands between the law and the bridge.
    pub rule: Option<&'a ServoRule>,
}

/// Runs the daemon from a start until the run is decided. It decides once a period, from the newest
/// frame that was delivered until then, and hears of the robot where the scene has an arm.
///
/// # Errors
/// [`RigError`]: the start is out of the robot's reach, or a setting out of its range.
pub fn run(
    scene: &Scene,
    settings: &RigSettings,
    course: Course<'_>,
    daemon: &mut Simulated,
    start: &Pose,
) -> Result<RobotRun, RigError> {
    daemon.restart();
    let mut rig = Rig::new(scene, start, settings)?.follow(course.motion, course.follow_s);
    let np = daemon.law().settings().np as f64;
    let mut history = Vec::new();
    let (mut cycle, mut shot): (u32, Option<Shot>) = (0, None);
    let (mut shown, mut hidden, mut cost, mut cycles) = (None, 0, 0.0, 0.0_f64);
    let (mut standing, mut stopped, mut hold) = ([0.0; 6], None, None);
    while rig.progress().end.is_none() && stopped.is_none() {
        let now_ns = rig.now_ns();
        let instant = rig.look(now_ns)?;
        shot = instant.shot.or(shot);
        let release_s = f64::from(cycle) * scene.sampling_time();
        if now_ns as f64 >= release_s * 1e9 {
            cycle += 1;
            let frame = shot.take();
            hidden += u64::from(frame.as_ref().is_some_and(|shot| !shot.is_whole()));
            let robot = scene.arm.as_ref().map(|_| rig.state());
            let inputs = Simulated::heard(frame.map(message), robot, now_ns);
            let record = daemon.decide(&inputs);
            daemon.think();
            if record.cost.is_finite() {
                cost += record.cost / np;
                cycles += 1.0;
            }
            let is_armed = record.state != TwistState::Disarmed.code();
            let is_within = daemon.is_within_limits(&record.twist, &standing);
            standing = record.twist;
            let q = rig.record().q.into();
            let ruled = course.rule.map(|rule| rule.scale(&q, &record.twist));
            rig.obey(&Order {
                twist: ruled.unwrap_or(record.twist),
                elbow: record.elbow,
                sent_ns: now_ns,
                until_ns: now_ns + (1e9 * PERIODS * scene.sampling_time()) as u64,
                is_armed,
            });
            shown = way_point(&record);
            hold = Hold::from_code(record.hold).map(|hold| hold.to_string());
            if rig.obeys_controller() {
                stopped = stop(is_armed, is_within, &record);
            }
        }
        if let Some(Exposed { points, .. }) = instant.exposed {
            history.push(Sample {
                time_s: rig.progress().time_s,
                features: points.to_vec(),
                twist: rig.aimed(),
                way_point: shown.clone(),
                arm: rig.record(),
            });
        }
        rig.advance();
    }
    let reason = match &rig.progress().end {
        _ if stopped.is_some() => stopped,
        Some(End::Arrived) => None,
        Some(End::Reflex) => Some(Reason::Reflex),
        Some(End::Violation(_) | End::LostSight) => Some(Reason::Violation),
        _ => Some(Reason::TimeOut),
    };
    let arm = rig.report().clone();
    Ok(RobotRun {
        success: reason.is_none() && arm.is_clean(),
        reason,
        goal: None,
        hold,
        time_s: rig.progress().time_s,
        arrived_s: rig.progress().arrived_s,
        least_clearance_px: rig.progress().referee.least_clearance(),
        least_between_px: rig.progress().referee.least_between(),
        least_edge_px: rig.progress().referee.least_edge(),
        error_px: rig.progress().error_px,
        hidden,
        cost: cost / cycles.max(1.0),
        following: rig.progress().following(),
        release: rig.release(),
        arm,
        history,
    })
}

/// A delivered frame as the daemon receives it.
fn message(shot: Shot) -> Features {
    let mut features = Features::new(&shot.points, shot.stamp_ns);
    features.visible = shot.visible;
    features.stamp.sequence = shot.number;
    features
}

/// Why the daemon ends the run, if it does.
fn stop(is_armed: bool, is_within: bool, record: &CycleRecord) -> Option<Reason> {
    match (is_armed, Hold::from_code(record.hold)) {
        (false, Some(Hold::Lost)) => Some(Reason::MarkerLost),
        (false, _) => Some(Reason::Disarmed),
        // A stop goes to zero at once.
        (true, _) => (!is_within).then_some(Reason::BeyondLimits),
    }
}

/// The samples until the robot let the object go.
pub fn approach(history: &[Sample]) -> &[Sample] {
    let mut phases = history.iter().map(|sample| sample.arm.phase);
    let end = phases.position(|phase| !phase.is_approach());
    &history[..end.unwrap_or(history.len())]
}
