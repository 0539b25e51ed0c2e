//! The arm: a Panda that carries the camera over an object that lies still on the table.

use std::io;
use std::net::SocketAddr;

use nalgebra::{Matrix3, Rotation3, Translation3};
use panda::{
    Chain, DriveError, JOINTS, Joints, MotionKind, Mount, PlacementError, Pose, RequestError,
    Robot, RobotError, RobotSettings, ShaperError, State, drive, place,
};
use scene::Scene;

use super::bridge::{Bridge, Shaping};
use super::calibration::HandEye;
use super::control_unit::{ControlUnit, FciSettings};
use super::inspector::Inspector;
use super::truth::Truth;
use crate::pose::{RigidPose, from_scene};

/// Where the pattern lies in the robot's base: 0.5 m in front of it, 5 cm above its foot, facing
/// up; its x axis points to the robot's right, its y axis towards the robot.
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
    /// Whether commands are shaped.
    pub shaping: Shaping,
    /// The robot.
    pub robot: RobotSettings,
    /// Whether clients of the vendor's interface command it, instead of the bridge.
    pub fci: Option<FciSettings>,
    /// Joint positions in which it stands at the start; `None`: it is placed as far from the ends of
    /// the joints' ranges as can be.
    pub joints: Option<Joints>,
}

impl ArmSettings {
    /// The chain to the end effector, and where that is in the base when the camera sees the object
    /// at `start`.
    fn wanted(&self, start: &scene::Pose) -> (Chain, Pose) {
        let mount = self.truth.mount(&self.hand_eye.mount());
        let camera = base_from_object() * from_scene(&self.truth.start(start)).inverse();
        let flange_from_ee = self.robot.flange_from_ee();
        let wanted = mount.flange(&camera) * flange_from_ee;
        (Chain::new(flange_from_ee), wanted)
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
            shaping: Shaping::default(),
            robot: RobotSettings::with_hand(),
            fci: None,
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

/// A Panda with its bridge, stepped once a millisecond.
#[derive(Debug)]
pub struct Arm {
    robot: Robot,
    /// From camera twists to commands of the robot.
    pub bridge: Bridge,
    /// Who commands the robot in its place.
    control_unit: Option<ControlUnit>,
    inspector: Inspector,
    /// Where the camera really sits.
    mount: Mount,
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
        let believed = settings.hand_eye.mount();
        let mount = settings.truth.mount(&believed);
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
        Ok(Self {
            control_unit,
            inspector: Inspector::new(robot.state(), robot.limits()),
            robot,
            bridge: Bridge::new(
                believed,
                scene.limits,
                settings.robot.model.limits(),
                settings.shaping,
            )?,
            mount,
            base_from_object: base_from_object(),
        })
    }

    /// The robot's state.
    pub fn state(&self) -> &State {
        self.robot.state()
    }

    /// The robot's referee.
    pub fn inspector(&self) -> &Inspector {
        &self.inspector
    }

    /// Whether clients of the vendor's interface command it.
    pub fn has_clients(&self) -> bool {
        self.control_unit.is_some()
    }

    /// One millisecond: the bridge, or a client, answers the robot's state; the robot steps.
    pub fn step(&mut self, now_ns: u64) {
        match &mut self.control_unit {
            Some(control_unit) => control_unit.step(&mut self.robot),
            None => {
                let command = self.bridge.answer(self.robot.state(), now_ns);
                self.robot.step(&[command]);
            }
        }
        self.inspector.look(self.robot.state());
    }

    /// The object in the camera frame, by the measured joints.
    pub fn object(&self) -> RigidPose {
        self.mount.camera(&self.state().flange()).inverse() * self.base_from_object
    }

    /// The camera's velocity in the camera frame (m/s, rad/s), by the desired joints.
    pub fn camera_twist(&self) -> [f64; 6] {
        let state = self.robot.state();
        self.mount
            .to_camera(&state.o_t_ee.rotation, &state.f_t_ee, &state.o_dp_ee_d)
            .into()
    }

    /// Whether the end effector stands, by the commands and by the desired joints. The elbow may
    /// still be creeping back to its place, which takes it 10 s and more in some postures: it moves
    /// nothing that the gripper holds.
    pub fn is_at_rest(&self) -> bool {
        let state = self.robot.state();
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
