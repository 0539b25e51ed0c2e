//! How large the problems of a solver are.

use ::arm::damper::{MAX_BOUNDS, WITHOUT_SHAPES};

use crate::constraint::SIDES;
use crate::intersample::most_stretches;
use crate::obstacle::Obstacle;
use crate::qp::MAX_ROWS;
use crate::task::Task;
use crate::{DOF, MAX_NC, MAX_NP, arm};

/// How large the problems of a solver are, and with them its workspace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Steps of the window.
    pub(crate) np: usize,
    /// Free commands.
    pub(crate) nc: usize,
    /// Points of the pattern.
    pub(crate) points: usize,
    /// Most rows of a quadratic program.
    pub(crate) rows: usize,
    /// Most stretches of the way of a first command.
    pub(crate) stretches: usize,
    /// Parts and areas of occlusions.
    pub(crate) obstacles: usize,
    /// What the arm costs a command where it is known, else 0, [work](crate::work).
    pub(crate) arm_ns: u32,
    /// What the clearance from the dearest of them costs, [work](crate::work).
    pub(crate) clearance_ns: u32,
}

impl Size {
    /// The size of the problems of a task with a window of `np` steps (1 to [`MAX_NP`]) and `nc`
    /// free commands (1 to [`MAX_NC`]).
    pub fn of(task: &Task, np: usize, nc: usize) -> Self {
        let (np, points) = (np.clamp(1, MAX_NP), task.pattern.len());
        // One for each damper and free command, and for each point and border in every step and on
        // the way of the first command.
        let obstacles = task.obstacles().count();
        let dampers = task.arm.as_ref().map_or(0, |arm| {
            let still = 2 * (DOF - arm.chain.count().min(DOF));
            let bounds = match arm.shapes.pairs.is_empty() {
                true => WITHOUT_SHAPES,
                false => MAX_BOUNDS,
            };
            nc * (bounds + still)
        });
        let rows = dampers + (np + 1) * points * (SIDES + obstacles);
        Self {
            np,
            nc: nc.clamp(1, MAX_NC),
            points,
            rows: rows.min(MAX_ROWS),
            stretches: most_stretches(task),
            obstacles,
            arm_ns: task.arm.as_ref().map_or(0, arm::work_ns),
            clearance_ns: task.obstacles().map(Obstacle::price_ns).max().unwrap_or(0),
        }
    }
}
