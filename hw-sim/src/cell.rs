//! What the process steps: a camera, what carries it, and a referee, in simulated time and without
//! ports.

use messages::{RobotFaults, RobotMode, RobotState};

use crate::camera::Points;
use crate::eye::{EyeError, Shot};
use crate::outcome::Outcome;
use crate::pose::{RigidPose, to_scene};
use crate::progress::Progress;
use crate::recording::ArmRecord;

/// What a step showed.
#[derive(Clone, Debug, Default)]
pub struct Observation {
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
    /// Velocity of the object against the world: the twist with which a camera would keep its view
    /// (m/s, rad/s; camera frame, at the camera's origin).
    pub object_twist: [f64; 6],
}

/// A command for a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// Camera velocity, camera frame, m/s and rad/s.
    pub twist: [f64; 6],
    /// Velocity of the arm's elbow, rad/s.
    pub elbow: f64,
    /// When it was sent, ns.
    pub sent_ns: u64,
    /// When it ends, ns.
    pub until_ns: u64,
    /// Whether the controller that sent it may move the camera.
    pub is_armed: bool,
}

/// A camera, what carries it, and a referee.
pub trait Cell {
    /// Lets time begin: the first step is due at this instant. Call it once, first.
    fn begin(&mut self, epoch_ns: u64);

    /// When the next step is due, ns.
    fn due_ns(&self) -> u64;

    /// Where a client lets time pass: waits for a moment, and returns whether it does. Ask again
    /// where it does not.
    fn may_step(&self) -> bool {
        true
    }

    /// The step that is due began so much later, ns.
    fn late(&mut self, _late_ns: u64) {}

    /// Takes a command.
    fn obey(&mut self, order: &Order);

    /// What the camera does at `now_ns`, `due_ns` or a little later: exposes where a frame is due,
    /// delivers what has arrived. Call once a step.
    ///
    /// # Errors
    /// A picture could not be made.
    fn look(&mut self, now_ns: u64) -> Result<Observation, EyeError>;

    /// Ends the step.
    fn advance(&mut self);

    /// The run so far.
    fn progress(&mut self) -> &mut Progress;

    /// The camera velocity that the command asks for now.
    fn aimed(&self) -> [f64; 6];

    /// Whether no valid command moves the camera.
    fn is_stale(&self) -> bool;

    /// Its state in the words of the contract.
    fn state(&self) -> RobotState;

    /// What an arm adds to a recorded frame.
    fn arm(&self) -> Option<ArmRecord> {
        None
    }

    /// Adds to an outcome what only this cell knows.
    fn complete(&self, _outcome: &mut Outcome) {}
}

/// The part of a cell's state that every cell has. `object` is the object in the camera frame, as
/// if it had not moved since the run began: a robot knows its own motion, and not the object's.
pub(crate) fn state(
    progress: &Progress,
    object: &RigidPose,
    now_ns: u64,
    is_stale: bool,
    was_limited: bool,
) -> RobotState {
    let object = to_scene(object);
    let mut state = RobotState::free_camera(object.translation, object.rotation, now_ns);
    let mode = match (progress.has_begun(), is_stale) {
        (false, _) => RobotMode::Idle,
        (true, true) => RobotMode::Stale,
        (true, false) => RobotMode::Moving,
    };
    state.mode = mode.code();
    raise(
        &mut state,
        RobotFaults::STALE_COMMAND,
        mode == RobotMode::Stale,
    );
    raise(&mut state, RobotFaults::COMMAND_LIMITED, was_limited);
    state
}

/// Adds a fault, where there is one.
pub(crate) fn raise(state: &mut RobotState, fault: RobotFaults, is_raised: bool) {
    state.faults |= if is_raised { fault.0 } else { 0 };
}
