//! A refined way, and how it is followed: its commands, with feedback on where the features should
//! be.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::motion::Motion;
use crate::task::Task;
use crate::{DOF, Twist, camera, interaction};

/// Commands of a way.
pub const COMMANDS: usize = 2 * HALF;
/// Half of them: longer arrays are no plain data.
const HALF: usize = 32;
/// Share of a deviation from the way that a command makes good.
const GAIN: f64 = 0.2;
/// Keeps the feedback finite where the features hardly tell of a direction, as a share.
const RIDGE: f64 = 1e-6;

/// Commands to the goal, one a step. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Way {
    /// Which way it is: ways are counted from 1.
    pub number: u32,
    /// The camera's velocity against the pattern in each step, m/s and rad/s.
    commands: [[Twist; HALF]; 2],
}

impl Way {
    /// No way.
    pub const NONE: Self = Self {
        number: 0,
        commands: [[[0.0; DOF]; HALF]; 2],
    };

    /// Becomes the next way, with commands of zero.
    pub(crate) fn renew(&mut self) {
        self.number = self.number.wrapping_add(1).max(1);
        self.commands_mut().fill([0.0; DOF]);
    }

    /// The commands.
    pub fn commands(&self) -> &[Twist] {
        self.commands.as_flattened()
    }

    /// The commands, to change them.
    pub fn commands_mut(&mut self) -> &mut [Twist] {
        self.commands.as_flattened_mut()
    }

    /// The last `ahead` commands.
    pub(crate) fn left(&self, ahead: u32) -> &[Twist] {
        let passed = COMMANDS.saturating_sub(ahead as usize);
        self.commands().get(passed..).unwrap_or_default()
    }
}

/// A pose of the pattern in the camera frame. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Placed {
    /// The rotation, column by column.
    rotation: [[f64; 3]; 3],
    /// The origin, m.
    translation: [f64; 3],
}

impl Placed {
    /// At the camera's.
    pub const ORIGIN: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };
}

impl From<&Motion> for Placed {
    fn from(motion: &Motion) -> Self {
        Self {
            rotation: motion.rotation.into(),
            translation: motion.translation.into(),
        }
    }
}

impl From<&Placed> for Motion {
    fn from(placed: &Placed) -> Self {
        Self {
            rotation: Matrix3::from(placed.rotation),
            translation: Vector3::from(placed.translation),
        }
    }
}

/// The velocity of the camera that brings the features a share nearer to where the pattern at
/// `reference` has them.
pub(crate) fn correction(task: &Task, reference: &Motion, points: &[[f64; 2]]) -> Option<Twist> {
    let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
    for (p, &point) in task.pattern.iter().zip(points) {
        let x = reference.apply(&Vector3::from(*p));
        let there = [x.x / x.z, x.y / x.z];
        let here = camera::normalise(&task.camera, point);
        let rows = interaction::of_point(there, x.z);
        for (row, (there, here)) in rows.into_iter().zip(there.into_iter().zip(here)) {
            let row = Vector6::from(row);
            normal += row * row.transpose();
            right += row * (there - here);
        }
    }
    let ridge = RIDGE * normal.trace();
    let back = (normal + Matrix6::from_diagonal_element(ridge)).cholesky()?;
    Some((back.solve(&right) * (GAIN / task.ts)).into())
}
