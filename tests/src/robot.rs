//! One closed-loop run of the law against the emulated robot, in simulated time: no processes, no
//! clocks, and the same bits in every run. Everything else is what `hw-sim` steps in real time.

use hw_sim::End;
use hw_sim::cell::{Cell, Exposed, Order};
use hw_sim::eye::Shot;
use hw_sim::recording::ArmRecord;
use hw_sim::rig::{Rig, RigError, RigSettings};
use hw_sim::robot::inspector::ArmReport;
use scene::{Pose, Scene};
use serde::Serialize;
use vpc::{Controller, Measurement, MotionMemory};

/// Time that a command holds without a newer one: the daemon's three periods.
const PERIODS: f64 = 3.0;
/// Time without usable features after which the daemon disarms, ns.
const LOST_NS: u64 = 300_000_000;

/// The result of a run.
#[derive(Clone, Debug, Serialize)]
pub struct RobotRun {
    /// Whether the object was released at the goal and the robot retreated, without any violation.
    pub success: bool,
    /// Why not.
    pub reason: Option<Reason>,
    /// Seconds until the run was decided.
    pub time_s: f64,
    /// Seconds until the features arrived.
    pub arrived_s: Option<f64>,
    /// Least distance of a point from an occlusion or the border, px.
    pub least_clearance_px: f64,
    /// True s - s* at the end, largest component, px.
    pub error_px: f64,
    /// Frames with a hidden marker.
    #[serde(rename = "hidden_frames")]
    pub hidden: u64,
    /// Mean over the cycles of l(v) / Np, against the goal.
    pub cost: f64,
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
}

impl Reason {
    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Violation => "violation",
            Self::MarkerLost => "marker lost",
            Self::TimeOut => "time out",
            Self::Reflex => "reflex",
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

/// The daemon's part in simulated time: the law steps when a frame is delivered, its command stands
/// for three periods, a hidden marker means standing still, and 0.3 s without usable features end
/// the run.
struct Driver<'a> {
    controller: &'a mut Controller,
    memory: Option<&'a dyn MotionMemory>,
    period_ns: u64,
    /// Number of the last frame that the law used.
    last: u64,
    /// When the features were last usable.
    good_ns: u64,
    twist: [f64; 6],
    way_point: Option<Vec<[f64; 2]>>,
    hidden: u64,
    cost: f64,
    cycles: f64,
}

impl Driver<'_> {
    fn answer(&mut self, shot: &Shot, now_ns: u64) {
        self.way_point = None;
        if !shot.is_whole() {
            self.hidden += 1;
            self.send([0.0; 6], now_ns);
            return;
        }
        if self.last + 1 != shot.number {
            self.controller.skip_mismatch();
        }
        let measurement = Measurement::from_points(&shot.points).taken(shot.stamp_ns, now_ns);
        let twist = match self.controller.step(&measurement, self.memory) {
            Ok(step) => {
                (self.last, self.good_ns) = (shot.number, now_ns);
                self.cost += step.cost / self.controller.settings().np as f64;
                self.cycles += 1.0;
                self.way_point = step.way_point.map(|points| points.to_vec());
                step.twist
            }
            Err(_) => [0.0; 6],
        };
        self.send(twist, now_ns);
    }

    fn send(&mut self, twist: [f64; 6], now_ns: u64) {
        self.twist = twist;
        self.controller.sent(&twist, now_ns);
        self.controller.think(self.memory);
    }
}

/// Runs the law from a start until the run is decided.
///
/// # Errors
/// [`RigError`]: the start is out of the robot's reach, or a setting out of its range.
pub fn run(
    scene: &Scene,
    settings: &RigSettings,
    controller: &mut Controller,
    memory: Option<&dyn MotionMemory>,
    start: &Pose,
) -> Result<RobotRun, RigError> {
    controller.reset();
    let mut rig = Rig::new(scene, start, settings)?;
    let mut driver = Driver {
        controller,
        memory,
        period_ns: (1e9 / scene.camera.rate_hz) as u64,
        last: 0,
        good_ns: 0,
        twist: [0.0; 6],
        way_point: None,
        hidden: 0,
        cost: 0.0,
        cycles: 0.0,
    };
    let validity_ns = (PERIODS * driver.period_ns as f64) as u64;
    let mut history = Vec::new();
    let mut begun = false;
    let mut until_ns = 0;
    let mut lost = false;
    while rig.progress().end.is_none() && !lost {
        let now_ns = rig.now_ns();
        let instant = rig.look(now_ns)?;
        if let Some(shot) = &instant.shot {
            driver.answer(shot, now_ns);
            if !begun {
                driver.good_ns = now_ns;
            }
            begun = true;
            until_ns = now_ns + validity_ns;
            rig.obey(&Order {
                twist: driver.twist,
                sent_ns: now_ns,
                until_ns,
                is_armed: true,
            });
        } else if begun && now_ns == until_ns && driver.twist != [0.0; 6] {
            // The daemon brakes; the bridge's ramp is the quicker one.
            driver.send([0.0; 6], now_ns);
        }
        if let Some(Exposed { points, .. }) = instant.exposed {
            history.push(Sample {
                time_s: rig.progress().time_s,
                features: points.to_vec(),
                twist: rig.aimed(),
                way_point: driver.way_point.clone(),
                arm: rig.record(),
            });
        }
        rig.advance();
        let is_steered = rig.phase().obeys_controller();
        lost = begun && is_steered && now_ns.saturating_sub(driver.good_ns) > LOST_NS;
    }
    let reason = match &rig.progress().end {
        _ if lost => Some(Reason::MarkerLost),
        Some(End::Arrived) => None,
        Some(End::Reflex) => Some(Reason::Reflex),
        Some(End::Violation(_) | End::LostSight) => Some(Reason::Violation),
        _ => Some(Reason::TimeOut),
    };
    let arm = rig.report().clone();
    Ok(RobotRun {
        success: reason.is_none() && arm.is_clean(),
        reason,
        time_s: rig.progress().time_s,
        arrived_s: rig.progress().arrived_s,
        least_clearance_px: rig.progress().referee.least_clearance(),
        error_px: rig.progress().error_px,
        hidden: driver.hidden,
        cost: driver.cost / driver.cycles.max(1.0),
        arm,
        history,
    })
}

/// The samples until the robot let the object go.
pub fn approach(history: &[Sample]) -> &[Sample] {
    let mut phases = history.iter().map(|sample| sample.arm.phase);
    let end = phases.position(|phase| !phase.obeys_controller());
    &history[..end.unwrap_or(history.len())]
}
