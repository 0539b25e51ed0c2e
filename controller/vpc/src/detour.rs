//! The way out of a stall: back onto a stored trajectory.
//!
//! Beside an occlusion the law can come to rest far from the goal: the way point lies across a
//! border, and no plan over the window leads around. All samples of a memory belong to trajectories
//! that reached the goal. After a second without progress the law therefore tracks, for a while,
//! the *features* of a sample, and then follows its trajectory. The first attempts take near
//! samples, each further away than the one before. Some can be reached round a corner, but many lie
//! on the other side of the border that stalls the law, so every second later attempt takes the
//! nearest sample in sight. The search for it looks at a share of the memory in each cycle. A
//! detour that makes no progress is given up.
//!
//! Not in the paper.

use serde::{Deserialize, Serialize};

use crate::recall::MotionMemory;
use crate::sight::Sight;
use crate::strategy::Strategy;
use crate::task::Task;
use crate::{MAX_POINTS, Points, features};

/// Cycles without progress that are a stall.
const PATIENCE: u32 = 30;
/// Decrease of the largest error that is progress, px.
const PROGRESS_PX: f64 = 3.0;
/// Errors below this multiple of the scene's threshold of convergence are regulation around the
/// goal, not a stall.
const FAR: f64 = 10.0;
/// Most cycles of a detour.
const LENGTH: u32 = 40;
/// Cycles of a detour without progress after which it is given up.
const BLOCKED: u32 = 10;
/// The first `RANKED` attempts, and every second one after them, pick a sample by rank; the others
/// pick one in sight.
const RANKED: u32 = 4;
/// Samples looked at in a cycle of the search.
const SHARE: usize = 256;
/// Passes of the search through the memory, each through other samples.
const PASSES: usize = 4;
/// Each of `RINGS` attempts in sight picks a sample that is at least this much further away than
/// the one before, px; then the distance begins at zero again.
const RING_PX: f64 = 30.0;
const RINGS: u32 = 4;
/// Cycles after a detour in which its trajectory is followed.
const FOLLOWING: u32 = 40;
/// Difference between the ranks of two attempts by rank, modulo `RANKS`.
const STRIDE: usize = 13;
const RANKS: usize = 64;

/// The progress of the law, and the detour under way. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detour {
    /// Least largest error since the last detour or the start, px; on a detour, towards its target.
    pub best_px: f64,
    /// Cycles since it was reached; they also count the progress of the search.
    pub cycles: u32,
    /// Detours so far.
    pub tries: u32,
    /// Cycles left of the detour under way; 0 where none is.
    pub left: u32,
    /// Cycles left in which the trajectory is followed that a detour led to.
    pub following: u32,
    /// Points in `target`, 0 to 8; 0 while the search has found none.
    pub count: u32,
    /// What it tracks, or the best that the search has found (u, v), px; the rest is zero.
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

    /// Takes the features of a cycle and returns what to track instead of way point and goal, if
    /// anything. They count as converged below `converged_px`.
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
            let away_px = features::largest_error(points, &self.target());
            self.note(away_px);
            if self.left == 0 || self.cycles > BLOCKED || away_px < converged_px {
                // Progress counts from here.
                (self.left, self.best_px, self.cycles) = (0, error_px, 0);
                self.following = FOLLOWING;
            }
        } else {
            self.note(error_px);
        }
        if self.left == 0 && self.cycles > PATIENCE {
            let is_over = self.search(task, points, memory);
            if is_over && self.left == 0 {
                // Nothing to go to: patience begins again.
                (self.best_px, self.cycles) = (error_px, 0);
            }
        }
        (self.left > 0).then(|| self.target())
    }

    /// The strategy that asks the memory: after a detour, the one that follows a single trajectory.
    /// A mean would lead back into the stall.
    pub fn guide(&self, strategy: Strategy) -> Strategy {
        match self.following {
            0 => strategy,
            _ => Strategy::Knn { k: 1 },
        }
    }

    /// Records that the camera was held: missing progress is then no stall.
    pub fn hold(&mut self) {
        *self = Self {
            tries: self.tries,
            ..Self::default()
        };
    }

    /// Counts a cycle in which so much was left to go, px.
    fn note(&mut self, left_px: f64) {
        if left_px < self.best_px - PROGRESS_PX {
            (self.best_px, self.cycles) = (left_px, 0);
        } else {
            self.cycles += 1;
        }
    }

    /// Picks a sample by its rank, if that is this attempt's turn. Otherwise looks through this
    /// cycle's share of the memory for the nearest sample in sight: first at one in [`PASSES`]
    /// samples. The detour begins after the first pass that found one, and after the last. Returns
    /// whether the search is over.
    fn search(&mut self, task: &Task, points: &Points, memory: &dyn MotionMemory) -> bool {
        let mut found = [0.0; features::MAX_INPUTS];
        let input = task.recall_input(points);
        let Some(found) = found.get_mut(..input.len()) else {
            return true;
        };
        let turn = match turn(self.tries) {
            Turn::Ranked(turn) => {
                self.count = 0;
                self.begin(turn, points, &input, memory, found);
                return true;
            }
            Turn::InSight(turn) => turn,
        };
        let count = memory.count();
        let rows = count.div_ceil(PASSES);
        let first = (self.cycles.saturating_sub(PATIENCE + 1) as usize).saturating_mul(SHARE);
        if first == 0 {
            self.count = 0;
        }
        let mut best_px = match self.count {
            0 => f64::INFINITY,
            _ => features::rms_distance(points, &self.target()),
        };
        let least_px = RING_PX * f64::from(turn % RINGS);
        let sight = Sight::from(task, points);
        for look in first..first.saturating_add(SHARE) {
            let (pass, row) = (look / rows.max(1), look % rows.max(1));
            if pass >= PASSES || rows == 0 || (row == 0 && pass > 0 && self.count > 0) {
                self.begin(turn, points, &input, memory, found);
                return true;
            }
            let index = row * PASSES + (pass + turn as usize) % PASSES;
            if index >= count || !memory.sample(index, found) {
                continue;
            }
            let sample = pairs(found, points.len());
            let away_px = features::rms_distance(points, &sample);
            // What is not finite is no nearer.
            if away_px >= least_px && away_px < best_px && sight.is_free(&sample) {
                best_px = away_px;
                self.aim(&sample);
            }
        }
        false
    }

    /// Begins a detour to the sample that the search found; where it found none, to one by its
    /// rank.
    fn begin(
        &mut self,
        turn: u32,
        points: &Points,
        input: &[f64],
        memory: &dyn MotionMemory,
        found: &mut [f64],
    ) {
        let rank = 1 + (turn as usize).wrapping_mul(STRIDE) % RANKS;
        self.tries = self.tries.saturating_add(1);
        if self.count == 0 {
            let is_finite = |found: &[f64]| found.iter().all(|x| x.is_finite());
            if !memory.neighbour(input, rank, found) || !is_finite(found) {
                return;
            }
            self.aim(&pairs(found, points.len()));
        }
        // What is progress on the way is known from its first cycle on.
        (self.left, self.best_px, self.cycles) = (LENGTH, f64::MAX, 0);
    }

    fn aim(&mut self, target: &[[f64; 2]]) {
        self.target = [[0.0; 2]; MAX_POINTS];
        for (to, from) in self.target.iter_mut().zip(target) {
            *to = *from;
        }
        self.count = target.len().min(MAX_POINTS) as u32;
    }

    fn target(&self) -> Points {
        let target = self.target.iter().copied();
        target.take(self.count as usize).collect()
    }
}

/// How an attempt picks its sample, and how many attempts picked theirs in this way before.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Turn {
    Ranked(u32),
    InSight(u32),
}

/// The turn after some tries.
fn turn(tries: u32) -> Turn {
    let later = tries.saturating_sub(RANKED);
    match (tries < RANKED, later % 2) {
        (true, _) => Turn::Ranked(tries),
        (false, 0) => Turn::InSight(later / 2),
        (false, _) => Turn::Ranked(RANKED + later / 2),
    }
}

/// The points of a sample's input.
fn pairs(input: &[f64], count: usize) -> Points {
    input.as_chunks().0.iter().copied().take(count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A memory whose sample of each rank lies that many px to the right, none of them in sight.
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

        fn count(&self) -> usize {
            0
        }

        fn sample(&self, _: usize, _: &mut [f64]) -> bool {
            false
        }
    }

    /// A memory of these samples; counts how often one was looked at.
    struct Samples {
        points: Vec<Points>,
        looks: std::cell::Cell<usize>,
    }

    impl Samples {
        fn of(points: Vec<Points>) -> Self {
            let looks = std::cell::Cell::new(0);
            Self { points, looks }
        }
    }

    impl MotionMemory for Samples {
        fn infer(&self, _: Strategy, _: &[f64], _: &mut [f64]) -> bool {
            false
        }

        fn neighbour(&self, _: &[f64], _: usize, _: &mut [f64]) -> bool {
            false
        }

        fn count(&self) -> usize {
            self.points.len()
        }

        fn sample(&self, index: usize, input: &mut [f64]) -> bool {
            self.looks.set(self.looks.get() + 1);
            for (to, from) in input.iter_mut().zip(self.points[index].as_flattened()) {
                *to = *from;
            }
            true
        }
    }

    /// A pattern with one corner below the bar at the bottom, as the law gets stuck there: the goal
    /// is above it.
    fn stuck_below() -> Points {
        let points = [
            [300.0, 310.0],
            [724.0, 309.0],
            [691.0, 946.0],
            [334.0, 730.0],
        ];
        points.into_iter().collect()
    }

    /// The same with that corner elsewhere.
    fn corner_at(pixel: [f64; 2]) -> Points {
        let mut points = stuck_below();
        points[2] = pixel;
        points
    }

    /// No detour yet, but so many tries: the next one takes a sample in sight.
    fn in_sight() -> Detour {
        Detour {
            tries: RANKED,
            ..Detour::default()
        }
    }

    /// The targets of so many cycles in which nothing moves, each once; the first is in sight.
    fn targets(memory: &dyn MotionMemory, points: &Points, cycles: u32) -> Vec<Points> {
        let (task, mut detour) = (task(), in_sight());
        let mut targets = Vec::new();
        for _ in 0..cycles {
            if let Some(target) = detour.look(&task, points, 2.0, memory)
                && targets.last() != Some(&target)
            {
                targets.push(target);
            }
        }
        targets
    }

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    fn shifted(points: &Points, by: f64) -> Points {
        points.iter().map(|p| [p[0] + by, p[1]]).collect()
    }

    #[test]
    fn four_tries_go_by_rank_then_every_other_one_in_sight() {
        use Turn::{InSight, Ranked};
        let first: Vec<_> = (0..9).map(turn).collect();
        let later = [InSight(0), Ranked(4), InSight(1), Ranked(5), InSight(2)];
        assert_eq!(first[..4], [0, 1, 2, 3].map(Ranked));
        assert_eq!(first[4..], later);
    }

    #[test]
    fn a_stall_leads_to_samples_further_and_further_away() {
        let task = task();
        let stuck = shifted(&task.goal, 200.0);
        let mut detour = Detour::default();
        let mut targets = Vec::new();
        for _ in 0..4 * (PATIENCE + BLOCKED + 2) {
            if let Some(target) = detour.look(&task, &stuck, 4.0, &Ranks) {
                let by = target[0][0] - stuck[0][0];
                if targets.last() != Some(&by) {
                    targets.push(by);
                }
            }
        }
        assert_eq!(targets, [1.0, 14.0, 27.0, 40.0]);
    }

    #[test]
    fn a_stall_leads_to_the_nearest_sample_that_no_border_hides() {
        let above = corner_at([691.0, 840.0]);
        let (near, far) = (corner_at([760.0, 960.0]), corner_at([840.0, 960.0]));
        for order in [[&above, &near, &far], [&far, &near, &above]] {
            // Whatever the pass that each of them is looked at in.
            for shift in 0..PASSES {
                let mut points = vec![above.clone(); shift];
                for point in order {
                    points.push(point.clone());
                    points.extend(vec![above.clone(); PASSES - 1]);
                }
                let memory = Samples::of(points);
                let found = targets(&memory, &stuck_below(), PATIENCE + BLOCKED);
                assert_eq!(found, std::slice::from_ref(&near), "{shift}");
            }
        }
        let hidden = Samples::of(vec![above; 10]);
        assert!(targets(&hidden, &stuck_below(), 10 * PATIENCE).is_empty());
    }

    #[test]
    fn the_next_try_goes_to_a_sample_further_away() {
        let at = |v: f64| corner_at([691.0 + v, 960.0]);
        // All of them in every pass.
        let of = |v: f64| vec![at(v); PASSES];
        let memory = Samples::of([10.0, 70.0, 150.0, 190.0].map(of).concat());
        // 30 px of all points are 60 of the one that moves. Between them tries by rank find
        // nothing.
        let found = targets(&memory, &stuck_below(), 5 * (2 * PATIENCE + BLOCKED + 8));
        assert_eq!(found[..4], [10.0, 70.0, 150.0, 190.0].map(at));
    }

    #[test]
    fn no_cycle_of_the_search_looks_at_more_than_its_share() {
        let (task, mut detour) = (task(), in_sight());
        let above = corner_at([691.0, 840.0]);
        let mut points = vec![above; 10 * SHARE];
        // The last one of all passes.
        points[10 * SHARE - 1] = corner_at([760.0, 960.0]);
        let memory = Samples::of(points);
        let mut cycles = 0;
        while detour.look(&task, &stuck_below(), 2.0, &memory).is_none() {
            assert!(memory.looks.replace(0) <= SHARE);
            cycles += 1;
            assert!(cycles < 100);
        }
        assert_eq!(cycles, PATIENCE + 1 + 10);
    }

    #[test]
    fn a_detour_that_is_blocked_is_given_up_and_one_that_goes_on_is_not() {
        let task = task();
        let stuck = shifted(&task.goal, 200.0);
        // That its target is nearer than nothing counts once as progress.
        for (px_a_cycle, expected) in [(0.0, BLOCKED + 1), (1.0, LENGTH - 1)] {
            let mut detour = Detour {
                tries: RANKS as u32 - 1,
                ..Detour::default()
            };
            (0..=PATIENCE + 1).find_map(|_| detour.look(&task, &stuck, 2.0, &Ranks));
            detour.aim(&shifted(&stuck, 300.0));
            let points = |k: u32| shifted(&stuck, px_a_cycle * f64::from(k));
            let away = (0..200).take_while(|&k| {
                let target = detour.look(&task, &points(k), 2.0, &Ranks);
                target.is_some()
            });
            assert_eq!(away.count() as u32, expected);
        }
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
