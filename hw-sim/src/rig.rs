//! The whole cell in simulated time: arm, camera, sequence and referees, a millisecond at a time.
//! It has neither clock nor port: the process steps it in real time or in lockstep, and the table
//! in process.

use messages::RobotState;
use nalgebra::Vector3;
use panda::Mode;
use scene::{Pose, Scene};

use crate::camera::{Points, outlines, project};
use crate::cell::{self, Cell, Exposed, Observation, Order};
use crate::eye::{Eye, EyeError, EyeSettings};
use crate::motion::{Motion, relative};
use crate::outcome::{Outcome, ReleaseReport, Verdict};
use crate::pose::RigidPose;
use crate::progress::Progress;
use crate::recording::ArmRecord;
use crate::referee::{End, INSTANTS};
use crate::robot::arm::{Arm, ArmError, ArmSettings};
use crate::robot::inspector::ArmReport;
use crate::robot::sequence::{Sequence, SequenceSettings, Situation, TaskStep};

mod state;

/// Nanoseconds of a step.
pub const STEP_NS: u64 = 1_000_000;

/// Settings of a cell.
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

/// A cell cannot be made, or cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The arm.
    #[error(transparent)]
    Arm(#[from] ArmError),
    /// The camera.
    #[error("camera: {0}")]
    Eye(#[from] EyeError),
}

/// The cell.
#[derive(Debug)]
pub struct Rig {
    scene: Scene,
    real: Scene,
    settings: RigSettings,
    motion: Motion,
    arm: Arm,
    eye: Eye,
    sequence: Sequence,
    progress: Progress,
    epoch_ns: u64,
    steps: u64,
    visible: u32,
    /// The newest frame, for the sequence.
    news: Option<Option<f64>>,
    grasped: Option<usize>,
    release: Option<ReleaseReport>,
}

impl Rig {
    /// A cell whose camera sees the object at `start`; time begins at 0.
    ///
    /// # Errors
    /// [`RigError`]: the start is out of reach, or a setting out of its range.
    pub fn new(scene: &Scene, start: &Pose, settings: &RigSettings) -> Result<Self, RigError> {
        let truth = &settings.arm.truth;
        let real = truth.scene(scene);
        // True occlusions count, and the goal as it was told.
        let mut judged = scene.clone();
        judged.occlusions.clone_from(&real.occlusions);
        Ok(Self {
            arm: Arm::new(scene, start, &settings.arm)?,
            eye: Eye::new(&real, truth, &settings.eye, settings.is_live)?,
            progress: Progress::new(&judged),
            sequence: Sequence::new(settings.sequence),
            grasped: scene.occlusions.iter().position(|one| one.grasped),
            scene: scene.clone(),
            real,
            settings: *settings,
            motion: Motion::default(),
            epoch_ns: 0,
            steps: 0,
            visible: 0,
            news: None,
            release: None,
        })
    }

    /// The object moves, and after the arrival it is measured for `follow_s` seconds how well the
    /// camera follows, before the object is released.
    pub fn follow(mut self, motion: Motion, follow_s: f64) -> Self {
        self.sequence = Sequence::new(SequenceSettings {
            may_move: !motion.is_rest(),
            ..self.settings.sequence
        });
        self.motion = motion;
        self.progress.follow_for(&self.real, follow_s);
        self
    }

    /// The object in the camera frame, where it is now.
    pub fn object(&self) -> RigidPose {
        let time_s = self.progress.since_s(self.now_ns());
        self.motion.moved(&self.arm.object(), time_s)
    }

    /// Its velocity against the world, as [`Exposed`] has it.
    fn object_twist(&self) -> [f64; 6] {
        let time_s = self.progress.since_s(self.now_ns());
        self.motion.twist(&self.arm.object(), time_s)
    }

    /// How fast the camera moved relative to the object while the gripper opened; `None` where the
    /// object rests or was not released.
    pub fn release(&self) -> Option<ReleaseReport> {
        self.release
    }

    /// Measures that in one millisecond.
    fn note_release(&mut self) {
        let twist = relative(&self.arm.camera_twist(), &self.object_twist());
        let origin = self.object().translation.vector;
        let [velocity, turn] = [0, 3].map(|k| Vector3::from_column_slice(&twist[k..k + 3]));
        let release = self.release.get_or_insert_default();
        release.m_s = release.m_s.max((velocity + turn.cross(&origin)).norm());
        release.rad_s = release.rad_s.max(turn.norm());
    }

    /// The present instant, ns.
    pub fn now_ns(&self) -> u64 {
        self.epoch_ns + self.steps * STEP_NS
    }

    /// The present step of the task.
    pub fn phase(&self) -> TaskStep {
        self.sequence.phase()
    }

    /// Whether the controller's commands are obeyed.
    pub fn obeys_controller(&self) -> bool {
        self.sequence.obeys_controller()
    }

    /// The report of the robot's referee.
    pub fn report(&self) -> &ArmReport {
        self.arm.inspector().report()
    }

    /// For the recording.
    pub fn record(&self) -> ArmRecord {
        let state = self.arm.state();
        ArmRecord {
            q: state.q.into(),
            dq: state.dq.into(),
            phase: self.phase(),
            mode: state.robot_mode.name().to_owned(),
            visible: self.visible,
        }
    }

    /// Whether the object is where it belongs. A client keeps the robot to itself, so that nothing
    /// is released then.
    fn is_done(&self) -> bool {
        match self.arm.has_clients() {
            true => !self.obeys_controller(),
            false => self.phase() == TaskStep::Done && self.arm.is_at_rest(),
        }
    }

    fn judge(&mut self, points: &Points, object: &RigidPose) {
        if !self.obeys_controller() {
            self.progress.error_px = self.progress.referee.error(points);
            return;
        }
        let judgement = self.progress.judge(points, outlines(&self.real, object));
        if let Some(end @ End::Violation(_)) = judgement {
            self.progress.finish(end);
        }
    }
}

impl Cell for Rig {
    fn begin(&mut self, epoch_ns: u64) {
        self.epoch_ns = epoch_ns;
    }

    fn due_ns(&self) -> u64 {
        self.now_ns()
    }

    fn may_step(&self) -> bool {
        self.arm.may_step()
    }

    /// A client cannot answer in time what the machine was late for: the robot's time stands still
    /// with the machine's.
    fn late(&mut self, late_ns: u64) {
        if self.arm.has_clients() && late_ns > STEP_NS {
            self.epoch_ns += late_ns;
        }
    }

    /// The command counts while the sequence obeys the controller.
    fn obey(&mut self, order: &Order) {
        if order.is_armed {
            self.progress.begin(self.now_ns());
        }
        if self.obeys_controller() {
            let limited = self.arm.obey(&order.twist, order.elbow, order.until_ns);
            self.progress.limited += u64::from(limited);
        }
    }

    fn look(&mut self, _now_ns: u64) -> Result<Observation, EyeError> {
        let mut seen = Observation::default();
        let now_ns = self.now_ns();
        // Frame k is exposed in the millisecond nearest to k periods: 33 or 34 steps apart, exact
        // in the long run.
        let frames = self.progress.frames;
        let due = (1000.0 * frames as f64 / self.scene.camera.rate_hz).round() as u64;
        if self.steps >= due {
            self.progress.frames += 1;
            let (object, object_twist) = (self.object(), self.object_twist());
            let twist = relative(&self.arm.camera_twist(), &object_twist);
            self.eye.expose(&object, &twist, now_ns)?;
            match project(&self.real, &object) {
                Ok(points) => {
                    self.judge(&points, &object);
                    let command = self.aimed();
                    self.progress.follow(&points, &object, &command);
                    seen.exposed = Some(Exposed {
                        points,
                        object,
                        object_twist,
                    });
                }
                Err(_) => self.progress.finish(End::LostSight),
            }
        }
        seen.shot = self.eye.deliver(now_ns)?;
        if let Some(shot) = &seen.shot {
            self.visible = shot.visible;
            let error = self.progress.referee.error(&shot.points);
            self.news = Some(shot.is_whole().then_some(error));
        }
        Ok(seen)
    }

    fn advance(&mut self) {
        let now_ns = self.now_ns();
        let begun = self.sequence.step(&Situation {
            now_ns,
            is_commanded: self.progress.has_begun(),
            frame: self.news.take(),
            is_at_rest: self.arm.is_at_rest(),
            twist: self.arm.camera_twist(),
            may_release: self.progress.following_s() == 0.0 || self.progress.has_followed(),
        });
        if self.sequence.is_opening() && !self.motion.is_rest() {
            self.note_release();
        }
        if let Some(twist) = self.sequence.twist() {
            self.arm.move_by_itself(&twist, now_ns + 2 * STEP_NS);
        }
        if let (Some(TaskStep::Retreating), Some(occlusion)) = (begun, self.grasped) {
            self.eye.show(occlusion, false);
        }
        self.arm.step(now_ns);
        if self.obeys_controller() && self.progress.has_begun() {
            self.arm.note_steered();
        }
        self.steps += 1;
        self.progress.tick(self.now_ns());
        let between = (1000.0 / (self.scene.camera.rate_hz * f64::from(INSTANTS))) as u64;
        if self.steps.is_multiple_of(between.max(1)) && self.obeys_controller() {
            let object = self.object();
            match project(&self.real, &object) {
                Ok(points) => {
                    let outlines = outlines(&self.real, &object);
                    self.progress.judge_between(&points, outlines);
                }
                Err(_) => self.progress.finish(End::LostSight),
            }
        }
        // What a run that arrived in time may take longer for the rest of the sequence.
        let following_s = self.progress.following_s();
        let grace_s = self.progress.arrived_s.map_or(0.0, |_| 15.0 + following_s);
        let has_clients = self.arm.has_clients();
        if self.arm.state().robot_mode == Mode::Reflex {
            // Without a run that has begun, a client tries the robot by itself.
            if !has_clients || self.progress.has_begun() {
                self.progress.finish(End::Reflex);
            }
        } else if self.is_done() {
            self.progress.finish(End::Arrived);
        } else if self.progress.time_s >= self.settings.time_limit_s + grace_s {
            self.progress.finish(End::TimeOut);
        }
    }

    fn progress(&mut self) -> &mut Progress {
        &mut self.progress
    }

    fn aimed(&self) -> [f64; 6] {
        self.arm.bridge.aimed(self.now_ns())
    }

    fn is_stale(&self) -> bool {
        self.obeys_controller() && self.arm.bridge.is_stale(self.now_ns())
    }

    fn state(&self) -> RobotState {
        let (object, limited) = (self.arm.object(), self.arm.bridge.limited().is_cut);
        let now_ns = self.now_ns();
        let mut state = cell::state(&self.progress, &object, now_ns, self.is_stale(), limited);
        state.twist = self.arm.camera_twist();
        let joints = self.settings.arm.robot.model.frames().count;
        state::add_arm(
            &mut state,
            self.arm.state(),
            joints,
            self.obeys_controller(),
        );
        state
    }

    fn arm(&self) -> Option<ArmRecord> {
        Some(self.record())
    }

    fn complete(&self, outcome: &mut Outcome) {
        if outcome.is_success() && !self.report().is_clean() {
            outcome.verdict = Verdict::ArmViolation;
        }
        outcome.step = Some(self.phase().name());
        outcome.arrived_s = self.progress.arrived_s;
        outcome.release = self.release;
        outcome.arm = Some(self.report().clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moving_box_is_released_at_its_own_velocity() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let settings = RigSettings::new(&scene);
        let keys = ["conveyor:0.005", "turn:0.02"].map(|text| text.parse().unwrap());
        let rig = Rig::new(&scene, &scene.goal, &settings).unwrap();
        let mut rig = rig.follow(Motion::new(&keys), 1.0);
        let (mut away, mut standing) = (0.0, 0.0);
        for ms in 0..9000 {
            // A controller that follows the object exactly.
            rig.obey(&Order {
                twist: rig.object_twist(),
                elbow: 0.0,
                sent_ns: ms * STEP_NS,
                until_ns: u64::MAX,
                is_armed: true,
            });
            rig.look(ms * STEP_NS).unwrap();
            rig.advance();
            if rig.phase() == TaskStep::Retreating {
                away = rig.object().translation.z - scene.goal.translation[2];
                standing = rig.arm.object().translation.x;
            }
        }
        assert_eq!(rig.progress().end, Some(End::Arrived));
        // The robot went with the object, and backed away from it.
        assert!(
            (standing - scene.goal.translation[0]).abs() > 0.01,
            "{standing}"
        );
        assert!((away - settings.sequence.retreat_m).abs() < 3e-3, "{away}");
        let release = rig.release().unwrap();
        assert!(release.m_s < 1e-4 && release.rad_s < 1e-3, "{release:?}");
        let following = rig.progress().following().unwrap();
        assert!(
            following.frames >= 30 && following.rms_mm < 1.0,
            "{following:?}"
        );
        assert!(rig.report().is_clean());
    }

    #[test]
    fn the_robot_backs_away_from_the_goal_by_as_much_as_it_is_told() {
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let settings = RigSettings::new(&scene);
        let mut rig = Rig::new(&scene, &scene.goal, &settings).unwrap();
        rig.obey(&Order {
            twist: [0.0; 6],
            elbow: 0.0,
            sent_ns: 0,
            until_ns: u64::MAX,
            is_armed: true,
        });
        for ms in 0..6000 {
            rig.look(ms * STEP_NS).unwrap();
            rig.advance();
        }
        assert_eq!(rig.progress().end, Some(End::Arrived));
        let away = rig.arm.object().translation.z - scene.goal.translation[2];
        assert!((away - settings.sequence.retreat_m).abs() < 1e-3, "{away}");
        assert!(rig.report().is_clean());
    }
}
