//! The way out of a stall: back onto a stored trajectory.
//!
//! Beside an occlusion the law can come to rest far from the goal: the way point lies across a border, and no plan over
//! the window leads around. All samples of a memory belong to trajectories that reached the goal. So after a second
//! without progress the target is, for a while, not the way point but the *features* of a sample nearby; from there its
//! trajectory goes on. Where that does not help, the next try takes a sample further away.
//!
//! Not in the paper.

use crate::recall::MotionMemory;
use crate::settings::Strategy;
use crate::task::Task;
use crate::{MAX_POINTS, Points, features};

/// Cycles without progress that are a stall.
const PATIENCE: u32 = 30;
/// Decrease of the largest error that is progress, px.
const PROGRESS_PX: f64 = 3.0;
/// Errors below so many times the scene's threshold of convergence are regulation around the goal, not a stall.
const FAR: f64 = 10.0;
/// Most cycles of a detour.
const LENGTH: u32 = 40;
/// Cycles after a detour in which its trajectory is followed.
pub const FOLLOWING: u32 = 40;
/// The sample of each try is so many ranks further away than that of the try before.
const STRIDE: usize = 13;
/// Ranks of samples, by their distance.
const RANKS: usize = 64;

/// Whether the law makes progress, and the detour under way. Plain data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detour {
    /// Least largest error since the last detour or the start, px.
    pub best_px: f64,
    /// Cycles since it was reached.
    pub cycles: u32,
    /// Detours so far.
    pub tries: u32,
    /// Cycles left of the detour under way; 0 where none is.
    pub left: u32,
    /// Cycles left in which the trajectory is followed that a detour led to.
    pub following: u32,
    /// Points in `target`, 0 to 8.
    pub count: u32,
    /// What it tracks (u, v), px; the rest is zero.
    pub target: [[f64; 2]; MAX_POINTS],
}

impl Default for Detour {
    fn default() -> Self {
        Self::NONE
    }
}

impl Detour {
    /// No detour, and no progress yet to compare with.
    pub const NONE: Self = Self {
        best_px: f64::INFINITY,
        cycles: 0,
        tries: 0,
        left: 0,
        following: 0,
        count: 0,
        target: [[0.0; 2]; MAX_POINTS],
    };

    /// Looks at the features of a cycle, and tells what to track instead of way point and goal, if anything. They count
    /// as converged below `converged_px`.
    pub fn look(
        &mut self,
        task: &Task,
        points: &Points,
        converged_px: f64,
        memory: &dyn MotionMemory,
    ) -> Option<Points> {
        let error_px = features::largest_error(points, &task.goal);
        if error_px < FAR * converged_px {
            *self = Self::default();
            return None;
        }
        self.following = self.following.saturating_sub(1);
        if self.left > 0 {
            self.left -= 1;
            let target = self.target();
            if self.left == 0 || features::largest_error(points, &target) < converged_px {
                // Progress counts from here.
                (self.left, self.best_px, self.cycles) = (0, error_px, 0);
                self.following = FOLLOWING;
            }
        } else if error_px < self.best_px - PROGRESS_PX {
            (self.best_px, self.cycles) = (error_px, 0);
        } else {
            self.cycles += 1;
        }
        if self.left == 0 && self.cycles > PATIENCE {
            (self.best_px, self.cycles) = (error_px, 0);
            self.begin(task, points, memory);
        }
        (self.left > 0).then(|| self.target())
    }

    /// The strategy that asks the memory: after a detour, the one that follows a single trajectory. A mean would lead back
    /// into the stall.
    pub fn guide(&self, strategy: Strategy) -> Strategy {
        match self.following {
            0 => strategy,
            _ => Strategy::Knn { k: 1 },
        }
    }

    /// Tells that the camera was held: who does not move makes no progress, and is not stalled.
    pub fn hold(&mut self) {
        *self = Self {
            tries: self.tries,
            ..Self::default()
        };
    }

    /// Takes it that a cycle whose largest error was `error_px` tracked the target of a detour, or of none, whatever
    /// this one says; `was_away`: whether the cycle before it did, where that is known. Tells whether all but `tries`
    /// is right by that.
    pub fn follow(
        &mut self,
        target: Option<&[[f64; 2]]>,
        was_away: Option<bool>,
        error_px: f64,
    ) -> bool {
        let is_under_way = self.left > 0;
        let Some(target) = target else {
            if is_under_way || was_away == Some(true) {
                (self.left, self.best_px, self.cycles) = (0, error_px, 0);
            }
            if was_away == Some(true) {
                self.following = FOLLOWING;
            }
            return was_away == Some(true);
        };
        if was_away == Some(true) && is_under_way && self.target() == target {
            return false;
        }
        self.target = [[0.0; 2]; MAX_POINTS];
        for (to, from) in self.target.iter_mut().zip(target) {
            *to = *from;
        }
        self.count = target.len().min(MAX_POINTS) as u32;
        (self.left, self.best_px, self.cycles) = (LENGTH, error_px, 0);
        was_away == Some(false)
    }

    fn begin(&mut self, task: &Task, points: &Points, memory: &dyn MotionMemory) {
        let rank = 1 + (self.tries as usize).wrapping_mul(STRIDE) % RANKS;
        self.tries = self.tries.saturating_add(1);
        let mut found = [0.0; features::MAX_INPUTS];
        let input = task.recall_input(points);
        let Some(found) = found.get_mut(..input.len()) else {
            return;
        };
        let is_finite = |found: &[f64]| found.iter().all(|x| x.is_finite());
        if !memory.neighbour(&input, rank, found) || !is_finite(found) {
            return;
        }
        for (to, from) in self.target.iter_mut().zip(found.chunks_exact(2)) {
            to.copy_from_slice(from);
        }
        (self.count, self.left) = (points.len() as u32, LENGTH);
    }

    fn target(&self) -> Points {
        let target = self.target.iter().copied();
        target.take(self.count as usize).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A memory whose sample of each rank lies that many px to the right.
    struct Ranks;

    impl MotionMemory for Ranks {
        fn infer(&self, _: Strategy, _: &[f64], _: &mut [f64]) -> bool {
            false
        }

        fn neighbour(&self, input: &[f64], rank: usize, found: &mut [f64]) -> bool {
            found.copy_from_slice(input);
            found.iter_mut().step_by(2).for_each(|u| *u += rank as f64);
            true
        }
    }

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    fn shifted(points: &Points, by: f64) -> Points {
        points.iter().map(|p| [p[0] + by, p[1]]).collect()
    }

    #[test]
    fn a_stall_leads_to_samples_further_and_further_away() {
        let task = task();
        let stuck = shifted(&task.goal, 200.0);
        let mut detour = Detour::default();
        let mut targets = Vec::new();
        for _ in 0..4 * (PATIENCE + LENGTH) {
            if let Some(target) = detour.look(&task, &stuck, 4.0, &Ranks) {
                let by = target[0][0] - stuck[0][0];
                if targets.last() != Some(&by) {
                    targets.push(by);
                }
            }
        }
        assert_eq!(targets[..3], [1.0, 14.0, 27.0]);
    }

    #[test]
    fn it_ends_where_the_sample_is_reached() {
        let task = task();
        let stuck = shifted(&task.goal, 200.0);
        let mut detour = Detour {
            tries: 1,
            ..Detour::default()
        };
        let target = (0..=PATIENCE + 1).find_map(|_| detour.look(&task, &stuck, 4.0, &Ranks));
        assert!(detour.look(&task, &stuck, 4.0, &Ranks).is_some());
        assert_eq!(detour.look(&task, &target.unwrap(), 4.0, &Ranks), None);
    }

    #[test]
    fn progress_nearness_and_a_held_camera_are_no_stall() {
        let task = task();
        let mut detour = Detour::default();
        for k in 0..100 {
            let points = shifted(&task.goal, 600.0 - 3.1 * f64::from(k));
            assert_eq!(detour.look(&task, &points, 4.0, &Ranks), None);
        }
        for _ in 0..100 {
            let points = shifted(&task.goal, 39.0);
            assert_eq!(detour.look(&task, &points, 4.0, &Ranks), None);
        }
        for _ in 0..100 {
            let points = shifted(&task.goal, 300.0);
            assert_eq!(detour.look(&task, &points, 4.0, &Ranks), None);
            detour.hold();
        }
    }
}
