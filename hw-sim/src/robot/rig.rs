//! The whole cell in simulated time: arm, camera, sequence and referees, a millisecond at a time. Without clocks and
//! ports: the process steps it, in real time or in lockstep, and so does the table.

use panda::JOINTS;
use scene::{Pose, Scene};
use serde::{Deserialize, Serialize};

use super::arm::{Arm, ArmError, ArmSettings};
use super::inspector::ArmReport;
use super::sequence::{Phase, Sequence, SequenceSettings, Situation};
use crate::camera::{Points, project};
use crate::eye::{Eye, EyeError, EyeSettings, Shot};
use crate::pose::RigidPose;
use crate::referee::{Referee, Verdict};

/// Nanoseconds of a step.
pub const STEP_NS: u64 = 1_000_000;

/// What a cell is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigSettings {
    /// The arm.
    pub arm: ArmSettings,
    /// The camera.
    pub eye: EyeSettings,
    /// The task.
    pub sequence: SequenceSettings,
    /// Time for the approach, s.
    pub time_limit_s: f64,
    /// Whether pictures are drawn by a thread beside the caller's.
    pub is_live: bool,
}

impl RigSettings {
    /// The scene's limits and time, everything else by default.
    pub fn new(scene: &Scene) -> Self {
        Self {
            arm: ArmSettings::default(),
            eye: EyeSettings::default(),
            sequence: SequenceSettings::new(
                scene.success.convergence_px,
                2.0 * scene.limits.linear,
            ),
            time_limit_s: scene.success.time_s,
            is_live: false,
        }
    }
}

/// Why a cell cannot be, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The arm.
    #[error(transparent)]
    Arm(#[from] ArmError),
    /// The camera.
    #[error("camera: {0}")]
    Eye(#[from] EyeError),
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The object is released and the robot has retreated.
    Done,
    /// The approach took too long.
    TimeOut,
    /// The referee of the image saw a violation, or the pattern out of sight.
    Image(Verdict),
    /// The robot stopped itself.
    Reflex,
}

/// What an instant brought.
#[derive(Clone, Debug, Default)]
pub struct Instant {
    /// A frame was exposed: what is true of it.
    pub exposed: Option<Exposed>,
    /// A frame was delivered.
    pub shot: Option<Shot>,
}

/// What is true at an exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposed {
    /// True features, px.
    pub points: Points,
    /// Object in the camera frame.
    pub object: RigidPose,
}

/// What the robot's side adds to a recorded frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmRecord {
    /// Measured joint positions, rad.
    pub q: [f64; JOINTS],
    /// Measured joint velocities, rad/s.
    pub dq: [f64; JOINTS],
    /// What the sequence is about.
    pub phase: Phase,
    /// Mode of the robot.
    pub mode: String,
    /// Bit i: marker i was measured in the frame that was delivered last.
    pub visible: u32,
}

/// The cell.
#[derive(Debug)]
pub struct Rig {
    scene: Scene,
    real: Scene,
    settings: RigSettings,
    arm: Arm,
    eye: Eye,
    referee: Referee,
    sequence: Sequence,
    epoch_ns: u64,
    steps: u64,
    frames: u64,
    begun_ns: Option<u64>,
    arrived_ns: Option<u64>,
    error_px: f64,
    visible: u32,
    /// The newest frame, for the sequence.
    news: Option<Option<f64>>,
    grasped: Option<usize>,
    limited: u64,
    was_limited: bool,
    end: Option<End>,
}

impl Rig {
    /// A cell whose camera sees the object at `start`; time begins at `epoch_ns`.
    ///
    /// # Errors
    /// [`RigError`]: the start is out of reach, or a setting out of its range.
    pub fn new(
        scene: &Scene,
        start: &Pose,
        settings: &RigSettings,
        epoch_ns: u64,
    ) -> Result<Self, RigError> {
        let truth = &settings.arm.truth;
        let real = truth.scene(scene);
        let grasped = |occlusion: &scene::Occlusion| occlusion.name.contains("grasped");
        Ok(Self {
            arm: Arm::new(scene, start, &settings.arm)?,
            eye: Eye::new(&real, scene, start, &settings.eye, settings.is_live)?,
            referee: Referee::new(scene),
            sequence: Sequence::new(settings.sequence),
            grasped: scene.occlusions.iter().position(grasped),
            scene: scene.clone(),
            real,
            settings: *settings,
            epoch_ns,
            steps: 0,
            frames: 0,
            begun_ns: None,
            arrived_ns: None,
            error_px: f64::INFINITY,
            visible: 0,
            news: None,
            limited: 0,
            was_limited: false,
            end: None,
        })
    }

    /// Lets time begin at this instant; nothing may have happened before.
    pub fn set_epoch(&mut self, epoch_ns: u64) {
        self.epoch_ns = epoch_ns;
    }

    /// The present instant, ns.
    pub fn now_ns(&self) -> u64 {
        self.epoch_ns + self.steps * STEP_NS
    }

    /// What the camera does now: exposes where a frame is due, delivers what has arrived. Call once an instant.
    ///
    /// # Errors
    /// A picture could not be made.
    pub fn look(&mut self) -> Result<Instant, RigError> {
        let mut instant = Instant::default();
        let now_ns = self.now_ns();
        // Frame k is exposed in the millisecond nearest to k periods: 33 or 34 steps apart, exact in the long run.
        let due = (1000.0 * self.frames as f64 / self.scene.camera.rate_hz).round() as u64;
        if self.steps >= due {
            self.frames += 1;
            let object = self.arm.object();
            self.eye.expose(&object, &self.arm.camera_twist(), now_ns)?;
            match project(&self.real, &object) {
                Ok(points) => {
                    self.judge(&points);
                    instant.exposed = Some(Exposed { points, object });
                }
                Err(_) => self.finish(End::Image(Verdict::LostSight)),
            }
        }
        instant.shot = self.eye.deliver(now_ns)?;
        if let Some(shot) = &instant.shot {
            self.visible = shot.visible;
            self.news = Some(shot.is_whole().then(|| self.referee.error(&shot.points)));
        }
        Ok(instant)
    }

    /// A command of the controller: camera velocity in the camera frame, to hold until `valid_until_ns`. It counts
    /// while the sequence obeys the controller. `is_armed` is false where the controller says that it may not move.
    pub fn command(&mut self, twist: &[f64; 6], valid_until_ns: u64, is_armed: bool) {
        if is_armed && self.begun_ns.is_none() {
            self.begun_ns = Some(self.now_ns());
        }
        if self.sequence.phase().obeys_controller() {
            self.was_limited = self.arm.bridge().command(twist, valid_until_ns);
            self.limited += u64::from(self.was_limited);
        }
    }

    /// The next millisecond; gives the phase of the sequence that began in it.
    pub fn advance(&mut self) -> Option<Phase> {
        let now_ns = self.now_ns();
        let begun = self.sequence.step(&Situation {
            now_ns,
            is_commanded: self.begun_ns.is_some(),
            frame: self.news.take(),
            is_at_rest: self.arm.is_at_rest(),
        });
        if let Some(twist) = self.sequence.twist() {
            self.arm.bridge().command(&twist, now_ns + 2 * STEP_NS);
        }
        if begun == Some(Phase::Retreating)
            && let Some(occlusion) = self.grasped
        {
            self.eye.show(occlusion, false);
        }
        self.arm.step(now_ns);
        self.steps += 1;
        if self.arm.is_in_reflex() {
            self.finish(End::Reflex);
        } else if self.sequence.phase() == Phase::Done && self.arm.is_at_rest() {
            self.finish(End::Done);
        } else if self.time_s() >= self.settings.time_limit_s + self.grace_s() {
            self.finish(End::TimeOut);
        }
        begun
    }

    /// How the run ended, once it has.
    pub fn end(&self) -> Option<&End> {
        self.end.as_ref()
    }

    /// Seconds since the first command of an armed controller; 0 before.
    pub fn time_s(&self) -> f64 {
        self.begun_ns
            .map_or(0.0, |begun| (self.now_ns() - begun) as f64 * 1e-9)
    }

    /// Seconds from the beginning until the referee first saw the features at the goal.
    pub fn arrived_s(&self) -> Option<f64> {
        let (begun, arrived) = (self.begun_ns?, self.arrived_ns?);
        Some(arrived.saturating_sub(begun) as f64 * 1e-9)
    }

    /// Frames exposed so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Commands that were outside the limits.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// Whether the last command was outside the limits.
    pub fn was_limited(&self) -> bool {
        self.was_limited
    }

    /// Largest component of the true s - s*, px, at the last exposure.
    pub fn error_px(&self) -> f64 {
        self.error_px
    }

    /// The sequence.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    /// The arm.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Whether no valid command moves the robot: the controller's is stale.
    pub fn is_stale(&mut self) -> bool {
        let now_ns = self.now_ns();
        self.sequence.phase().obeys_controller() && self.arm.bridge().is_stale(now_ns)
    }

    /// The camera velocity that the bridge aims at.
    pub fn aimed(&mut self) -> [f64; 6] {
        let now_ns = self.now_ns();
        self.arm.bridge().aimed(now_ns)
    }

    /// The referee of the image.
    pub fn referee(&self) -> &Referee {
        &self.referee
    }

    /// What the referee of the robot reports.
    pub fn report(&self) -> &ArmReport {
        self.arm.inspector().report()
    }

    /// For the recording.
    pub fn record(&self) -> ArmRecord {
        let state = self.arm.state();
        ArmRecord {
            q: state.q.into(),
            dq: state.dq.into(),
            phase: self.sequence.phase(),
            mode: state.robot_mode.name().to_owned(),
            visible: self.visible,
        }
    }

    /// What a run that arrived in time may take longer for the rest of the sequence, s.
    fn grace_s(&self) -> f64 {
        if self.arrived_ns.is_some() { 15.0 } else { 0.0 }
    }

    fn judge(&mut self, points: &Points) {
        self.error_px = self.referee.error(points);
        if !self.sequence.phase().obeys_controller() {
            return;
        }
        match self.referee.judge(points, 0.0) {
            Verdict::Running | Verdict::TimeOut => {}
            Verdict::Arrived => {
                let now_ns = self.now_ns();
                self.arrived_ns.get_or_insert(now_ns);
            }
            verdict => self.finish(End::Image(verdict)),
        }
    }

    fn finish(&mut self, end: End) {
        self.end.get_or_insert(end);
    }
}
