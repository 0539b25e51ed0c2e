//! The joints of the arm that carries the camera: where they truly are, and where it says that they
//! are. Kinematics are the emulator's, which share nothing with the law's.

use std::collections::VecDeque;

use messages::RobotState;
use nalgebra::{Rotation3, SMatrix, Translation3, Vector3, Vector6};
use panda::{Chain, READY};

use crate::fault::Fault;
use crate::world::TICK_NS;

/// The arm's ranges by its description, rad.
const RANGES: [[f64; 2]; 7] = [
    [-2.8973, 2.8973],
    [-1.7628, 1.7628],
    [-2.8973, 2.8973],
    [-3.0718, -0.0698],
    [-2.8973, 2.8973],
    [-0.0175, 3.7525],
    [-2.8973, 2.8973],
];
/// Joint 7 at first, rad: near the end of its range, towards which it is turned.
const JOINT_7: f64 = 1.9;
/// Another posture's, rad.
const OTHER_7: f64 = -2.0;

/// Them.
pub struct Joints {
    chain: Chain,
    q: [f64; 7],
    fault: Option<Fault>,
    /// Where they were when the fault began, rad.
    frozen: [f64; 7],
    /// Where they were, the newest first.
    past: VecDeque<[f64; 7]>,
    told: u64,
}

impl Default for Joints {
    fn default() -> Self {
        // The mounting of `panda.toml`.
        let (xy, z) = (0.049_497_474_683_058_33, 0.04);
        let camera = panda::Pose::from_parts(
            Translation3::new(xy, -xy, z),
            Rotation3::new(Vector3::z() * std::f64::consts::FRAC_PI_4),
        );
        let mut q = READY;
        q[6] = JOINT_7;
        Self {
            chain: Chain::new(camera),
            q,
            fault: None,
            frozen: q,
            past: VecDeque::new(),
            told: 0,
        }
    }
}

impl Joints {
    /// From now on it says something else.
    pub fn fail(&mut self, fault: Fault) {
        (self.fault, self.frozen) = (Some(fault), self.q);
    }

    /// From now on it says where they are.
    pub fn recover(&mut self) {
        self.fault = None;
    }

    /// How far the worst joint is beyond its range, rad; negative inside.
    pub fn beyond(&self) -> f64 {
        let each =
            std::iter::zip(self.q, RANGES).map(|(q, [least, most])| (least - q).max(q - most));
        each.fold(f64::NEG_INFINITY, f64::max)
    }

    /// A tick in which the camera moves so, and joint 3 so, rad/s.
    pub fn tick(&mut self, twist: &[f64; 6], elbow: f64) {
        self.past.push_front(self.q);
        self.past.truncate(256);
        if *twist == [0.0; 6] && elbow == 0.0 {
            return;
        }
        let posture = self.chain.posture(&panda::Joints::from(self.q));
        let rotation = posture.pose.rotation;
        let linear = rotation * Vector3::new(twist[0], twist[1], twist[2]);
        let angular = rotation * Vector3::new(twist[3], twist[4], twist[5]);
        let mut wanted = Vector6::new(
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
        );
        wanted -= posture.jacobian.column(2) * elbow;
        let mut rest = SMatrix::<f64, 6, 6>::zeros();
        let others = [0, 1, 3, 4, 5, 6];
        for (column, joint) in others.into_iter().enumerate() {
            rest.set_column(column, &posture.jacobian.column(joint));
        }
        let Some(speeds) = rest.lu().solve(&wanted) else {
            return;
        };
        let seconds = TICK_NS as f64 * 1e-9;
        self.q[2] += elbow * seconds;
        for (column, joint) in others.into_iter().enumerate() {
            self.q[joint] += speeds[column] * seconds;
        }
    }

    /// Writes what it says about them at `now_ns`.
    pub fn tell(&mut self, state: &mut RobotState, now_ns: u64) {
        self.told += 1;
        (state.joints, state.q) = (7, self.q);
        let second = self.told.is_multiple_of(2);
        let late = (200_000_000 / TICK_NS) as usize;
        match self.fault {
            Some(Fault::JointsFrozen) => state.q = self.frozen,
            Some(Fault::JointsFuture) => {
                state.q = self.frozen;
                state.stamp.data_ns = now_ns + 1_000_000_000_000_000_000;
            }
            Some(Fault::JointsJump) if second => state.q[6] = OTHER_7,
            Some(Fault::JointsWrapped) => state.q[6] -= std::f64::consts::TAU,
            Some(Fault::JointsOther) => state.q[6] = OTHER_7,
            Some(Fault::JointsHuge) => state.q[6] = 1e300,
            Some(Fault::JointsDegrees) => state.q = self.q.map(f64::to_degrees),
            Some(Fault::JointsLate) => state.q = self.past.get(late).copied().unwrap_or(self.q),
            Some(Fault::JointsFew) => state.joints = 6,
            _ => (),
        }
    }
}
