//! The arm: a robot that carries the camera over an object that lies still on the table.

use std::io;
use std::net::SocketAddr;

use nalgebra::{Matrix3, Rotation3, Translation3, Vector3};
use panda::{
    Chain, DriveError, JOINTS, Joints, MotionKind, PlacementError, Pose, RequestError, Robot,
    RobotError, RobotSettings, State, drive, place,
};
use scene::Scene;

use super::bridge::{Bridge, Caps, ShaperError, bridge, ramps};
use super::calibration::HandEye;
use super::control_unit::{ControlUnit, FciSettings};
use super::inspector::Inspector;
use super::truth::Truth;
use crate::pose::{RigidPose, from_scene};

/// Where the pattern lies in the robot's base, unless an arm file tells it: 0.5 m in front of it,
/// 5 cm above its foot, facing up; its x axis points to the robot's right, its y axis towards it.
pub fn base_from_object() -> Pose {
    let axes = Matrix3::new(0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    Pose::from_parts(
        Translation3::new(0.5, 0.0, 0.05),
        Rotation3::from_matrix_unchecked(axes),
    )
}

/// Settings of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmSettings {
    /// The calibration that the bridge was given.
    pub hand_eye: HandEye,
    /// How the world differs from that.
    pub truth: Truth,
    /// Whether commands are shaped; unshaped, the staircase of 30 Hz shows what the robot says to
    /// it.
    pub is_shaped: bool,
    /// The robot.
    pub robot: RobotSettings,
    /// Whether clients of the vendor's interface command it, instead of the bridge.
    pub fci: Option<FciSettings>,
    /// Where the pattern lies in the robot's base.
    pub base_from_object: Pose,
    /// Joint positions in which it stands at the start; `None`: it is placed as far from the ends
    /// of the joints' ranges as can be.
    pub joints: Option<Joints>,
}

impl ArmSettings {
    /// The chain to the end effector, and where that is in the base when the camera sees the object
    /// at `start`.
    fn wanted(&self, start: &scene::Pose) -> (Chain, Pose) {
        let believed = self.hand_eye.flange_from_camera();
        let flange_from_camera = self.truth.flange_from_camera(&believed);
        let camera = self.base_from_object * from_scene(&self.truth.start(start)).inverse();
        let flange_from_ee = self.robot.flange_from_ee();
        let wanted = camera * flange_from_camera.inverse() * flange_from_ee;
        (self.robot.model.chain(flange_from_ee), wanted)
    }

    /// The joint positions of an arm that is driven from others to where its camera sees the object
    /// at `start`; see [`panda::drive`].
    ///
    /// # Errors
    /// [`DriveError`]: it cannot get there.
    pub fn driven(&self, from: &Joints, start: &scene::Pose) -> Result<Joints, DriveError> {
        let (chain, wanted) = self.wanted(start);
        drive(&chain, self.robot.model.limits(), from, &wanted)
    }
}

impl Default for ArmSettings {
    /// A robot with the hand, and a true calibration.
    fn default() -> Self {
        Self {
            hand_eye: HandEye::default(),
            truth: Truth::default(),
            is_shaped: true,
            robot: RobotSettings::with_hand(),
            fci: None,
            base_from_object: base_from_object(),
            joints: None,
        }
    }
}

/// Why an arm cannot be.
#[derive(Debug, thiserror::Error)]
pub enum ArmError {
    /// The start is out of reach.
    #[error("this start: {0}")]
    Placement(PlacementError),
    /// The robot refused its settings.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The shaper refused its settings.
    #[error(transparent)]
    Shaper(#[from] ShaperError),
    /// The vendor's interface cannot be offered there.
    #[error("--fci {address}: {source}")]
    Fci {
        /// Where.
        address: SocketAddr,
        /// Why not.
        source: io::Error,
    },
    /// The robot did not begin a motion.
    #[error("the robot begins no motion: {0}")]
    Motion(RequestError),
}

/// A robot with its bridge, stepped once a millisecond.
#[derive(Debug)]
pub struct Arm {
    /// From camera twists to commands of the robot, which it holds.
    pub bridge: Bridge,
    /// The scene's.
    caps: Caps,
    /// What commands the robot in its place.
    control_unit: Option<ControlUnit>,
    inspector: Inspector,
    /// Where the camera really sits.
    flange_from_camera: Pose,
    base_from_object: Pose,
}

impl Arm {
    /// An arm that stands where its camera sees the object at `start`, ready to be commanded.
    ///
    /// # Errors
    /// [`ArmError`]: the start is out of reach, or a setting out of its range.
    pub fn new(
        scene: &Scene,
        start: &scene::Pose,
        settings: &ArmSettings,
    ) -> Result<Self, ArmError> {
        let believed = settings.hand_eye.flange_from_camera();
        let placed = || {
            let (chain, wanted) = settings.wanted(start);
            place(&chain, settings.robot.model.limits(), &wanted).map_err(ArmError::Placement)
        };
        let joints = settings.joints.map_or_else(placed, Ok)?;
        let mut robot = Robot::new(settings.robot, joints)?;
        let open = |fci: FciSettings| {
            ControlUnit::open(&fci).map_err(|source| ArmError::Fci {
                address: fci.address,
                source,
            })
        };
        let control_unit = settings.fci.map(open).transpose()?;
        if control_unit.is_none() {
            robot
                .start(MotionKind::Cartesian)
                .map_err(ArmError::Motion)?;
        }
        let ramps = (settings.is_shaped).then(|| ramps(settings.robot.model, scene));
        Ok(Self {
            control_unit,
            inspector: Inspector::new(robot.state(), robot.limits()),
            bridge: bridge(robot, believed, ramps)?,
            caps: Caps::axes(scene.limits.velocity()),
            flange_from_camera: settings.truth.flange_from_camera(&believed),
            base_from_object: settings.base_from_object,
        })
    }

    /// Takes a command of the controller: camera velocity in the camera frame (m/s, rad/s), to hold
    /// until `until_ns`, and that of the elbow, rad/s. Returns whether it was outside the limits and
    /// was cut.
    pub fn obey(&mut self, twist: &[f64; 6], elbow: f64, until_ns: u64) -> bool {
        self.bridge.obey(twist, until_ns, &self.caps);
        self.bridge.turn_elbow(elbow);
        self.bridge.limited().is_cut
    }

    /// Notes that the robot obeys the controller in this millisecond.
    pub fn note_steered(&mut self) {
        self.inspector.steered(self.bridge.limited().by_joint);
    }

    /// Takes a command of the robot's own side, to which the limits of the servoing do not apply.
    pub fn move_by_itself(&mut self, twist: &[f64; 6], until_ns: u64) {
        self.bridge.obey(twist, until_ns, &Caps::NONE);
    }

    /// The robot's state.
    pub fn state(&self) -> &State {
        self.bridge.driver.robot.state()
    }

    /// The robot's referee.
    pub fn inspector(&self) -> &Inspector {
        &self.inspector
    }

    /// Whether clients of the vendor's interface command it.
    pub fn has_clients(&self) -> bool {
        self.control_unit.is_some()
    }

    /// Where a client paces the robot: waits for a moment, and returns whether the next step may be
    /// taken.
    pub fn may_step(&self) -> bool {
        let robot = &self.bridge.driver.robot;
        let control_unit = self.control_unit.as_ref();
        control_unit.is_none_or(|control_unit| control_unit.may_step(robot))
    }

    /// One millisecond: the bridge, or a client, answers the robot's state; the robot steps.
    pub fn step(&mut self, now_ns: u64) {
        match &mut self.control_unit {
            Some(control_unit) => control_unit.step(&mut self.bridge.driver.robot),
            None => self.bridge.step(now_ns),
        }
        self.inspector.look(self.bridge.driver.robot.state());
    }

    /// O_T_C, the true camera in the base, by the measured joints.
    fn camera(&self) -> Pose {
        self.state().flange() * self.flange_from_camera
    }

    /// The object in the camera frame, by the measured joints.
    pub fn object(&self) -> RigidPose {
        self.camera().inverse() * self.base_from_object
    }

    /// The camera's velocity in the camera frame (m/s, rad/s), by the desired joints.
    pub fn camera_twist(&self) -> [f64; 6] {
        let (state, camera) = (self.state(), self.camera());
        let lever = camera.translation.vector - state.o_t_ee.translation.vector;
        let [x, y, z, rx, ry, rz] = state.o_dp_ee_d.into();
        let turn = Vector3::new(rx, ry, rz);
        let velocity = Vector3::new(x, y, z) + turn.cross(&lever);
        let along = [velocity, turn].map(|v| camera.rotation.inverse() * v);
        std::array::from_fn(|k| along[k / 3][k % 3])
    }

    /// Whether the end effector stands, by the commands and by the desired joints. The elbow may
    /// still be creeping back to its place, which takes it 10 s and more in some postures: it moves
    /// nothing that the gripper holds.
    pub fn is_at_rest(&self) -> bool {
        let state = self.state();
        state.o_dp_ee_d.amax() < AT_REST && state.o_dp_ee_c.amax() < AT_REST
    }
}

/// Speed below which the end effector counts as standing, m/s and rad/s. After a ramp the feedback
/// of the inverse kinematics decays from below this within a few tenths of a second.
const AT_REST: f64 = 2e-4;

/// The limits of a Panda's joints for a picture: least and greatest position, greatest speed.
pub fn joint_limits() -> [[f64; 3]; JOINTS] {
    let limits = panda::limits::Model::Panda.limits();
    limits
        .joints
        .map(|bound| [bound.lower, bound.upper, bound.velocity])
}
