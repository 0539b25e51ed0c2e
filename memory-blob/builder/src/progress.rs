//! What a build has found so far.

use serde::{Deserialize, Serialize};

use crate::store::Trajectory;

/// The state of a building, from which it can go on: what a Ctrl-C leaves behind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Successful trajectories.
    pub trajectories: Vec<Trajectory>,
    /// Starts at which the paper's algorithms failed, as points of R^6; from some the planner found
    /// a way. In builds for foresight, where a trajectory was needed.
    pub failures: Vec<[f64; 6]>,
    /// Why foresight needed each: how many times the best it paid without, infinitely many where it
    /// failed. Empty in other builds.
    pub paid: Vec<f64>,
    /// Starts tried.
    pub tried: u64,
    /// Batches done; with the seed it fixes every random choice to come.
    pub batches: u64,
    /// Failed starts by cause: stuck, no solution, violation, time out.
    pub causes: [u64; 4],
}
