//! Counted work: the cost of a solution, in ns of the processor on which the prices were measured.
//!
//! No clock decides in the law, so a replay gives the same bits. The law counts work instead: it
//! depends on the window, the points, the occlusions, the rows and the changes of the active set.
//! The prices are within a factor of two of the times of windows of 3 to 40 steps, 1 to 4 free
//! commands, 4 and 8 points, and 6 and 47 parts, on a virtual machine of 2026 (`cargo run --release
//! -p vpc --example step_times`).

use crate::constraint::SIDES;
use crate::size::Size;

/// Work of a simulated step of foresight, in iterations.
const ITERATIONS_A_STEP: u32 = 2;
/// Stretches of a first command's path that an iteration may take.
const STRETCHES: u32 = 11;
/// Changes of the active set that an iteration may take.
const CHANGES: u32 = 12;
/// Of this many possible rows, usually one is near enough to count.
const PAIRS_A_ROW: usize = 20;
/// Previews of the window beside the solution: the last check with its halvings, the running cost.
const OTHER_PREVIEWS: u32 = 8;

/// Looking for the nearest of so many samples of a memory, ns.
pub(crate) const fn search(samples: usize, inputs: usize) -> u64 {
    samples as u64 * inputs as u64 / 4
}

/// Looking for the nearest trajectories, and for the rest of one, ns.
pub(crate) const fn search_trajectory(samples: usize, inputs: usize) -> u64 {
    search(samples, inputs) + 2 * samples as u64
}

/// What the parts of a solution cost for problems of one size, ns.
#[derive(Clone, Copy, Debug)]
pub struct Prices {
    /// Previewing a window with its derivatives, and summing up cost and violations.
    pub evaluation: u32,
    /// Following the features to a place on the way of the first command.
    pub place: u32,
    /// Expanding cost and clearances about a plan, and factorising the quadratic program.
    pub expansion: u32,
    /// Making a row.
    pub row: u32,
    /// Looking whether a row is violated.
    pub look: u32,
    /// A change of the active set.
    pub change: u32,
    /// The dampers of an arm, and its joints a step later.
    pub arm: u32,
    /// Rows of a program, usually.
    rows: u32,
}

impl Prices {
    /// The prices of problems of this size.
    pub const fn of(size: Size) -> Self {
        let (points, places) = (size.points as u32, (size.np * size.points) as u32);
        let pairs = size.np * size.np * size.points * (SIDES + size.obstacles);
        let rows = pairs / PAIRS_A_ROW;
        let rows = if rows < size.rows { rows } else { size.rows };
        let n = 6 * size.nc as u32;
        // Every place is compared with the box of every occlusion.
        let boxes = 3 * size.obstacles as u32 / 2;
        Self {
            evaluation: places * (20 + 7 * n / 2 + boxes),
            place: 60 + points * 10,
            expansion: places * (20 + 10 * n * n / 17 + boxes) + n * n * n / 10,
            row: 2 + size.clearance_ns,
            look: 1 + n,
            change: 50 + 10 * n * n / 7,
            arm: size.arm_ns,
            rows: rows as u32,
        }
    }

    /// An iteration.
    pub const fn iteration(self) -> u32 {
        self.expansion
            + self.evaluation
            + STRETCHES * self.place
            + CHANGES * self.change
            + self.rows * (self.row + 2 * self.look)
    }

    /// Most work of a solution in at most `iterations`, from all starts together. An iteration or a
    /// line search that is under way may exceed it by half.
    ///
    /// Hard problems stay within a few times their median by it
    /// (`tests/tests/promises/bounded.rs`), and it hardly ever ends a search that would have led
    /// somewhere.
    pub const fn budget(self, iterations: u32) -> u32 {
        iterations.saturating_mul(self.iteration())
    }

    /// Most work of a decision whose solution has this budget.
    pub const fn decision(self, budget: u32) -> u32 {
        (budget.saturating_add(budget / 2))
            .saturating_add(OTHER_PREVIEWS * self.evaluation + self.arm)
    }

    /// The work of a simulated step of foresight, usually.
    pub const fn step(self) -> u32 {
        self.iteration()
            .saturating_mul(ITERATIONS_A_STEP)
            .saturating_add(self.arm)
    }
}
