//! From what the robot tells to `vpc/robot`. Pure.

use std::collections::VecDeque;

use messages::{RobotFaults, RobotMode, RobotState};
use nalgebra::{Isometry3, UnitQuaternion};

use crate::config::{CommandFrame, Config, RobotKeys};
use crate::frames::{Frames, isometry, velocity};
use crate::message::{JointState, PoseStamped, TwistStamped};
use crate::refusal::{Refusal, check_frame, finite};
use crate::stamp::{Clocks, Order};

/// Time over which the change of the pose is measured, ns: at 500 Hz, ten poses.
const WINDOW_NS: u64 = 20_000_000;
/// Greatest age of the pose that turns twists into the base's frame, ns: the camera turns meanwhile.
const POSE_AGE_NS: u64 = 100_000_000;
/// Poses that are kept at most.
const POSES: usize = 64;

/// What vpcd's command is at this instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Command {
    /// None came since the start.
    #[default]
    None,
    /// One is in force.
    InForce,
    /// One is in force that was beyond the scene's limits.
    Limited,
    /// The last one ended.
    Stale,
}

/// Makes robot states.
#[derive(Clone, Debug)]
pub struct Arm {
    keys: RobotKeys,
    frames: Frames,
    max_age_ns: u64,
    joints: Option<(u64, [f64; 7], [f64; 7])>,
    poses: VecDeque<(u64, Isometry3<f64>)>,
    twists: Order,
    joint_states: Order,
}

impl Arm {
    /// That has heard nothing yet.
    pub fn new(config: &Config) -> Self {
        Self {
            keys: config.robot.clone(),
            frames: Frames::new(config),
            max_age_ns: config.max_age_ns,
            joints: None,
            poses: VecDeque::new(),
            twists: Order::default(),
            joint_states: Order::default(),
        }
    }

    /// Takes the joints that the configuration names; others may be in the message. Returns the
    /// instant of it, ns; `None` for a message of others alone, such as a gripper's. A velocity that
    /// is not a number counts as 0: ros2_control tells so what the hardware does not measure.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn joints(
        &mut self,
        message: &JointState,
        clocks: &Clocks,
        now_ns: u64,
    ) -> Result<Option<u64>, Refusal> {
        let JointState {
            name,
            position,
            velocity,
            ..
        } = message;
        if !name.iter().any(|name| self.keys.joints.contains(name)) {
            return Ok(None);
        }
        let instant = clocks.instant(&message.header.stamp, 0, now_ns)?;
        // Robots that do not tell velocities send none.
        let has_velocity = !velocity.is_empty();
        if position.len() != name.len() || has_velocity && velocity.len() != name.len() {
            return Err(Refusal::Lengths {
                names: name.len(),
                positions: position.len(),
                velocities: velocity.len(),
            });
        }
        let (mut q, mut dq) = ([0.0; 7], [0.0; 7]);
        for (k, wanted) in self.keys.joints.iter().enumerate().take(q.len()) {
            let mut places = (0..name.len()).filter(|i| name[*i] == *wanted);
            let Some(place) = places.next() else {
                return Err(Refusal::Joint(wanted.clone()));
            };
            if places.next().is_some() {
                return Err(Refusal::TwiceJoint(wanted.clone()));
            }
            q[k] = position[place];
            let told = velocity.get(place).copied().unwrap_or_default();
            dq[k] = if told.is_nan() { 0.0 } else { told };
        }
        finite("a joint", q.iter().chain(&dq))?;
        self.joint_states.after(instant)?;
        self.joints = Some((instant, q, dq));
        Ok(Some(instant))
    }

    /// Takes the tool's pose in the base; returns the state where the robot tells its motion so.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn pose(
        &mut self,
        message: &PoseStamped,
        clocks: &Clocks,
        now_ns: u64,
        command: Command,
    ) -> Result<Option<RobotState>, Refusal> {
        check_frame(&message.header.frame_id, &self.keys.base)?;
        let instant = clocks.instant(&message.header.stamp, 0, now_ns)?;
        let pose = isometry(&message.pose).ok_or(Refusal::NotFinite("the pose"))?;
        if self.poses.back().is_some_and(|(last, _)| *last >= instant) {
            return Err(crate::stamp::StampError::Order.into());
        }
        // After a pause the motion is measured anew.
        let (end, max_age) = (instant, self.max_age_ns);
        self.poses.retain(|(at, _)| end - at <= max_age);
        self.poses.push_back((instant, pose));
        if self.poses.len() > POSES {
            self.poses.pop_front();
        }
        // The newest pose that is a window ago.
        while self.poses.len() > 2 && instant - self.poses[1].0 >= WINDOW_NS {
            self.poses.pop_front();
        }
        if self.keys.executed != crate::config::Executed::Pose {
            return Ok(None);
        }
        let (begin, from) = self.poses[0];
        if instant - begin < WINDOW_NS {
            return Ok(None);
        }
        let tool = velocity(&from, &pose, 1e-9 * (instant - begin) as f64);
        let camera = self.frames.camera(&tool, CommandFrame::Tool, None);
        let camera = camera.unwrap_or_default();
        // It is the mean of the window.
        let middle = begin + (instant - begin) / 2;
        self.state(camera, middle, command, now_ns).map(Some)
    }

    /// The state by a twist that is carried out.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn twist(
        &mut self,
        message: &TwistStamped,
        clocks: &Clocks,
        now_ns: u64,
        command: Command,
    ) -> Result<RobotState, Refusal> {
        let turn = self.base_from_tool(now_ns);
        let camera = self.frames.told(message, turn.as_ref())?;
        let instant = clocks.instant(&message.header.stamp, 0, now_ns)?;
        self.twists.after(instant)?;
        self.state(camera, instant, command, now_ns)
    }

    /// The tool's rotation in the base, while a fresh pose tells it.
    pub fn base_from_tool(&self, now_ns: u64) -> Option<UnitQuaternion<f64>> {
        let (at, pose) = self.poses.back()?;
        let most = self.max_age_ns.min(POSE_AGE_NS);
        (now_ns.saturating_sub(*at) <= most).then_some(pose.rotation)
    }

    /// vpcd's twist in the frame that the robot is commanded in; `None` where that is not known.
    pub fn command(&self, twist: &[f64; 6], now_ns: u64) -> Option<[f64; 6]> {
        let turn = self.base_from_tool(now_ns);
        self.frames
            .out(twist, self.keys.command_frame, turn.as_ref())
    }

    fn state(
        &self,
        twist: [f64; 6],
        data_ns: u64,
        command: Command,
        now_ns: u64,
    ) -> Result<RobotState, Refusal> {
        let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], data_ns);
        if !self.keys.joints.is_empty() {
            let is_fresh = |at: u64| now_ns.saturating_sub(at) <= self.max_age_ns;
            let joints = self.joints.filter(|(at, ..)| is_fresh(*at));
            let missing = || Refusal::NoJoints(self.keys.joint_states.clone());
            let (at, q, dq) = joints.ok_or_else(missing)?;
            // Both count from one instant on: the older one.
            state.stamp.data_ns = data_ns.min(at);
            state.joints = self.keys.joints.len() as u32;
            (state.q, state.dq) = (q, dq);
        }
        // Numbers that are too large for the change of frames.
        finite("the camera's twist", &twist)?;
        state.twist = twist;
        let (mode, faults) = match command {
            Command::None => (RobotMode::Idle, RobotFaults::default()),
            Command::InForce => (RobotMode::Moving, RobotFaults::default()),
            Command::Limited => (RobotMode::Moving, RobotFaults::COMMAND_LIMITED),
            Command::Stale => (RobotMode::Stale, RobotFaults::STALE_COMMAND),
        };
        (state.mode, state.faults) = (mode.code(), faults.0);
        Ok(state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::of_keys;
    use crate::message::{Header, Point, Pose, Quaternion, Twist};
    use crate::stamp::wall;

    const NOW: u64 = 10_000_000_000;
    const MS: u64 = 1_000_000;

    fn header(frame: &str, at_ns: u64) -> Header {
        Header {
            stamp: wall(at_ns, 0),
            frame_id: frame.to_owned(),
        }
    }

    fn clocks() -> Clocks {
        Clocks::new(0, 200 * MS)
    }

    fn pose(arm: &mut Arm, at_ns: u64, x: f64) -> Result<Option<RobotState>, Refusal> {
        let (y, z, w) = (0.2, 0.3, 1.0);
        let message = PoseStamped {
            header: header("base_link", at_ns),
            pose: Pose {
                position: Point { x, y, z },
                orientation: Quaternion {
                    w,
                    ..Quaternion::default()
                },
            },
        };
        arm.pose(&message, &clocks(), at_ns, Command::InForce)
    }

    #[test]
    fn the_change_of_the_pose_over_a_window_is_the_twist() {
        let keys = "[robot]\nexecuted = \"pose\"\npose = \"/pose\"";
        let mut arm = Arm::new(&of_keys(keys));
        let mut told = Vec::new();
        for k in 0..20 {
            told.extend(pose(&mut arm, NOW + 2 * MS * k, 1e-4 * k as f64).unwrap());
        }
        // From the eleventh on, 2 ms apart: 0.1 mm each.
        assert_eq!(told.len(), 10);
        for state in &told {
            assert!((state.twist[0] - 0.05).abs() < 1e-9, "{:?}", state.twist);
            assert!(state.twist[1..].iter().all(|v| v.abs() < 1e-9));
        }
        assert_eq!(told[0].stamp.data_ns, NOW + 10 * MS);
        assert_eq!(told[0].mode(), Some(RobotMode::Moving));
        let again = pose(&mut arm, NOW + 38 * MS, 0.0).unwrap_err();
        assert_eq!(again.kind(), "out of order");
        assert_eq!(pose(&mut arm, NOW + 400 * MS, 0.5), Ok(None));
    }

    #[test]
    fn a_twist_along_base_axes_needs_a_fresh_pose() {
        let mut arm = Arm::new(&of_keys("[robot]\npose = \"/pose\""));
        let twist = |arm: &mut Arm, frame: &str, at_ns| {
            let message = TwistStamped {
                header: header(frame, at_ns),
                twist: Twist::from_array([0.1, 0.0, 0.0, 0.0, 0.0, 0.2]),
            };
            arm.twist(&message, &clocks(), at_ns, Command::Stale)
        };
        let missing = twist(&mut arm, "base_link", NOW).unwrap_err();
        assert_eq!(missing.kind(), "pose missing");
        pose(&mut arm, NOW, 0.0).unwrap();
        let state = twist(&mut arm, "base_link", NOW + 100 * MS).unwrap();
        assert_eq!(state.twist, [0.1, 0.0, 0.0, 0.0, 0.0, 0.2]);
        assert_eq!(state.mode(), Some(RobotMode::Stale));
        assert!(twist(&mut arm, "base_link", NOW + 201 * MS).is_err());
        let other = twist(&mut arm, "world", NOW + 202 * MS).unwrap_err();
        assert_eq!(other.kind(), "other frame_id");
        // Without joints in the configuration none are told.
        assert_eq!(state.joints, 0);
    }

    #[test]
    fn joints_are_told_by_name() {
        let mut arm = Arm::new(&of_keys("[robot]\njoints = [\"b\", \"a\"]"));
        let message = JointState {
            header: header("", NOW),
            name: ["a", "finger", "b"].map(str::to_owned).into(),
            position: vec![1.0, 9.0, 2.0],
            velocity: vec![0.1, 0.9, 0.2],
            effort: vec![],
        };
        arm.joints(&message, &clocks(), NOW).unwrap();
        let state = arm.state([0.0; 6], NOW, Command::None, NOW).unwrap();
        assert_eq!(
            (state.joints, &state.q[..2], &state.dq[..2]),
            (2, &[2.0, 1.0][..], &[0.2, 0.1][..])
        );
        let at = |twist_ns| {
            let state = arm.state([0.0; 6], twist_ns, Command::None, NOW + 100 * MS);
            state.unwrap().stamp.data_ns
        };
        assert_eq!([at(NOW - MS), at(NOW + 100 * MS)], [NOW - MS, NOW]);
        let late = arm.state([0.0; 6], NOW, Command::None, NOW + 201 * MS);
        assert_eq!(late.unwrap_err().kind(), "joints missing");
        let refused = |change: fn(&mut JointState)| {
            let mut message = message.clone();
            change(&mut message);
            let refusal = arm.clone().joints(&message, &clocks(), NOW);
            refusal.unwrap_err().kind()
        };
        assert_eq!(refused(|m| m.name[2] = "c".to_owned()), "joints missing");
        assert_eq!(refused(|m| m.name[1] = "a".to_owned()), "name twice");
        assert_eq!(refused(|m| m.position[0] = f64::NAN), "bad number");
        assert_eq!(refused(|m| m.velocity.truncate(1)), "wrong length");
        assert_eq!(refused(|m| m.velocity[2] = f64::INFINITY), "bad number");
        assert_eq!(refused(|_| ()), "out of order");
        // A gripper's, without a stamp or positions.
        let mut other = message.clone();
        (other.name, other.position) = (vec!["finger".to_owned()], vec![]);
        other.header = Header::default();
        assert_eq!(arm.joints(&other, &clocks(), NOW), Ok(None));
        let mut unmeasured = message.clone();
        unmeasured.header = header("", NOW + 1);
        unmeasured.velocity[2] = f64::NAN;
        assert_eq!(
            arm.joints(&unmeasured, &clocks(), NOW + 1),
            Ok(Some(NOW + 1))
        );
        let state = arm.state([0.0; 6], NOW, Command::None, NOW).unwrap();
        assert_eq!(state.dq[..2], [0.0, 0.1]);
    }
}
