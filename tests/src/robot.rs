//! One closed-loop run of a decision step against the emulated robot, in simulated time:
//! no processes, no clocks, and the same bits in every run. Everything else is what `hw-sim` steps
//! in real time.

use decision::Inputs;
use hw_sim::End;
use hw_sim::cell::{Cell, Order};
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
    /// Mean over the cycles of l(v) / Np, against the goal; a NaN where no cycle tells it.
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

/// Why a run cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum RunError<E> {
    /// The cell.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// What steers gives no command.
    #[error("{0}")]
    Steering(E),
}

/// Lets `steering` run from a start until the run is decided. As [`Trial`].
///
/// # Errors
/// [`RunError`]: the start is out of the robot's reach, a setting is out of its range, or
/// `steering` gives no command.
pub fn run<S: Steering>(
    scene: &Scene,
    settings: &RigSettings,
    course: Course<'_>,
    steering: &mut S,
    start: &Pose,
) -> Result<RobotRun, RunError<S::Error>> {
    steering.begin().map_err(RunError::Steering)?;
    let np = steering.np();
    let mut trial = Trial::new(scene, settings, course, start, np)?;
    while let Some(inputs) = trial.receive()? {
        let record = steering.answer(&inputs).map_err(RunError::Steering)?;
        let is_within = steering.is_within_limits(&record.twist, &trial.standing);
        trial.obey(&record, is_within);
    }
    Ok(trial.into_run())
}

/// A run of the emulated robot, which stands still wherever the controller decides: once a period,
/// from the newest frame that was delivered until then. It hears of the robot where the scene has
/// an arm.
#[derive(Debug)]
pub struct Trial<'a> {
    scene: Scene,
    rig: Rig,
    rule: Option<&'a ServoRule>,
    np: f64,
    cycle: u32,
    /// Delivered, and not yet received.
    shot: Option<Shot>,
    /// What this millisecond showed, and has not yet gone into the history.
    exposed: Option<Vec<[f64; 2]>>,
    is_looked_at: bool,
    shown: Option<Vec<[f64; 2]>>,
    hidden: u64,
    cost: f64,
    cycles: f64,
    standing: [f64; 6],
    stopped: Option<Reason>,
    hold: Option<String>,
    history: Vec<Sample>,
}

impl<'a> Trial<'a> {
    /// A robot at a start; costs are means over so many steps ahead.
    ///
    /// # Errors
    /// [`RigError`]: the start is out of the robot's reach, or a setting out of its range.
    pub fn new(
        scene: &Scene,
        settings: &RigSettings,
        course: Course<'a>,
        start: &Pose,
        np: usize,
    ) -> Result<Self, RigError> {
        let rig = Rig::new(scene, start, settings)?;
        Ok(Self {
            scene: scene.clone(),
            rig: rig.follow(course.motion, course.follow_s),
            rule: course.rule,
            np: np as f64,
            cycle: 0,
            shot: None,
            exposed: None,
            is_looked_at: false,
            shown: None,
            hidden: 0,
            cost: 0.0,
            cycles: 0.0,
            standing: [0.0; 6],
            stopped: None,
            hold: None,
            history: Vec::new(),
        })
    }

    /// Goes on to the next decision; returns what is received then, or `None` where the run has
    /// ended. [`obey`](Self::obey) what is decided, then call this again.
    ///
    /// # Errors
    /// [`RigError`]: a picture could not be made.
    pub fn receive(&mut self) -> Result<Option<Inputs>, RigError> {
        self.end_step();
        while self.rig.progress().end.is_none() && self.stopped.is_none() {
            let now_ns = self.rig.now_ns();
            let seen = self.rig.look(now_ns)?;
            self.is_looked_at = true;
            self.shot = seen.shot.or(self.shot.take());
            self.exposed = seen.exposed.map(|exposed| exposed.points.to_vec());
            let release_s = f64::from(self.cycle) * self.scene.sampling_time();
            if now_ns as f64 >= release_s * 1e9 {
                self.cycle += 1;
                let frame = self.shot.take();
                let is_hidden = frame.as_ref().is_some_and(|shot| !shot.is_whole());
                self.hidden += u64::from(is_hidden);
                let robot = self.scene.arm.as_ref().map(|_| self.rig.state());
                return Ok(Some(Simulated::heard(frame.map(message), robot, now_ns)));
            }
            self.end_step();
        }
        Ok(None)
    }

    /// Takes what was decided on what was received. A command beyond the limits ends the run.
    pub fn obey(&mut self, record: &CycleRecord, is_within: bool) {
        if record.cost.is_finite() {
            self.cost += record.cost / self.np;
            self.cycles += 1.0;
        }
        let is_armed = record.state != TwistState::Disarmed.code();
        self.standing = record.twist;
        let q = self.rig.record().q.into();
        let ruled = self.rule.map(|rule| rule.scale(&q, &record.twist));
        let now_ns = self.rig.now_ns();
        self.rig.obey(&Order {
            twist: ruled.unwrap_or(record.twist),
            elbow: record.elbow,
            sent_ns: now_ns,
            until_ns: now_ns + (1e9 * PERIODS * self.scene.sampling_time()) as u64,
            is_armed,
        });
        self.shown = way_point(record);
        self.hold = Hold::from_code(record.hold).map(|hold| hold.to_string());
        if self.rig.obeys_controller() {
            self.stopped = stop(is_armed, is_within, record);
        }
    }

    /// Ends the millisecond that was looked at.
    fn end_step(&mut self) {
        if !std::mem::take(&mut self.is_looked_at) {
            return;
        }
        if let Some(features) = self.exposed.take() {
            self.history.push(Sample {
                time_s: self.rig.progress().time_s,
                features,
                twist: self.rig.aimed(),
                way_point: self.shown.clone(),
                arm: self.rig.record(),
            });
        }
        self.rig.advance();
    }

    /// The cell, which only this trial steps.
    pub fn rig(&mut self) -> &mut Rig {
        &mut self.rig
    }

    /// True features of the newest exposure, px.
    pub fn features(&self) -> &[[f64; 2]] {
        let last = || self.history.last().map(|sample| &sample.features);
        self.exposed
            .as_ref()
            .or_else(last)
            .map_or(&[], Vec::as_slice)
    }

    /// The result; the run so far, if it has not ended.
    pub fn into_run(mut self) -> RobotRun {
        let progress = self.rig.progress();
        let reason = match &progress.end {
            _ if self.stopped.is_some() => self.stopped,
            Some(End::Arrived) => None,
            Some(End::Reflex) => Some(Reason::Reflex),
            Some(End::Violation(_) | End::LostSight) => Some(Reason::Violation),
            _ => Some(Reason::TimeOut),
        };
        let arm = self.rig.report().clone();
        let release = self.rig.release();
        let progress = self.rig.progress();
        RobotRun {
            success: reason.is_none() && arm.is_clean(),
            reason,
            goal: None,
            hold: self.hold,
            time_s: progress.time_s,
            arrived_s: progress.arrived_s,
            least_clearance_px: progress.referee.least_clearance(),
            least_between_px: progress.referee.least_between(),
            least_edge_px: progress.referee.least_edge(),
            error_px: progress.error_px,
            hidden: self.hidden,
            cost: self.cost / self.cycles,
            following: progress.following(),
            release,
            arm,
            history: self.history,
        }
    }
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
