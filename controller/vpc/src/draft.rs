//! A draft: a way that is being refined, over several cycles if need be.
//!
//! The barrier begins soft, so that a way can leave the occlusions that its first guess leads
//! through, and becomes steeper pass by pass.

use serde::{Deserialize, Serialize};

use crate::course::{Barrier, Course};
use crate::motion::Motion;
use crate::refine::Refiner;
use crate::way::{Placed, Way};
use crate::{DOF, Twist};

/// Most passes over a draft.
const PASSES: u32 = 20;
/// Passes after which the barrier becomes steeper at the latest.
const EVERY: u32 = 2;
/// The first barrier where the first guess may lead through borders, and where it does not; what
/// it is multiplied by, and the last one.
pub(crate) const SOFT: Barrier = Barrier {
    weight: 20.0,
    depth: 20.0,
};
pub(crate) const CLOSE: Barrier = Barrier {
    weight: 1.0,
    depth: 0.5,
};
const STEEPER: Barrier = Barrier {
    weight: 0.65,
    depth: 0.5,
};
const FIRM: Barrier = Barrier {
    weight: 0.5,
    depth: 0.15,
};
/// A pass that gains less than this share of the merit is the last under its barrier.
const SETTLED: f64 = 1e-3;
/// A draft ends where it still violates more than this after so many passes.
const HOPELESS_PX: f64 = 10.0;
const HOPELESS: u32 = 12;
/// Passes after which a draft ends that costs more than the best known way.
const DEAR: u32 = 6;
/// Greatest violation of a way that is done, px. The simulated future of it corrects what is left.
const CLEAR_PX: f64 = 3.0;
/// Damping after a pass that gained nothing, its growth, and the greatest.
const DAMPING: f64 = 0.1;
const STRONGER: f64 = 10.0;
const STRONGEST: f64 = 100.0;
/// Steps in which a draft makes good where the camera went meanwhile.
const CATCHING_UP: usize = 8;
/// A whole step, less the rounding of a sum of shares.
const WHOLE: f64 = 1.0 - 1e-6;

/// How far a draft has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Progress {
    /// It needs more passes.
    Going,
    /// It is as good as it gets, and at most [`CLEAR_PX`] too deep.
    Done,
    /// It leads through a border, costs too much, or leads nowhere.
    Blocked,
}

/// A way that is being refined. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Draft {
    /// The way.
    pub way: Way,
    /// Passes so far; 0 where there is no draft.
    pub passes: u32,
    /// Where the pattern is at its beginning.
    start: Placed,
    /// The part of its first command that has passed, steps.
    since: f64,
    /// What clearances cost.
    barrier: Barrier,
    /// What it costs so far, with the barrier.
    merit: f64,
    /// Share of its curvature that is added to that of a command.
    damping: f64,
    /// Clearance that it keeps beside the settings' margin, px.
    pub spare_px: f64,
}

impl Draft {
    /// No draft.
    pub const NONE: Self = Self {
        way: Way::NONE,
        passes: 0,
        start: Placed::ORIGIN,
        since: 0.0,
        barrier: SOFT,
        merit: f64::INFINITY,
        damping: 0.0,
        spare_px: 0.0,
    };

    /// Begins the next one with the pattern at `start`; the commands, to make a first guess in.
    pub(crate) fn begin(&mut self, start: &Motion, barrier: Barrier) -> &mut [Twist] {
        self.way.renew();
        (self.passes, self.start, self.since) = (0, start.into(), 0.0);
        (self.barrier, self.spare_px) = (barrier, 0.0);
        (self.merit, self.damping) = (f64::INFINITY, 0.0);
        self.way.commands_mut()
    }

    /// Forgets it.
    pub(crate) fn discard(&mut self) {
        self.passes = 0;
    }

    /// Moves on by at most one step, in which the camera went its own way to the beginning of
    /// `course`. The first commands make good the difference.
    pub(crate) fn pass_by(&mut self, steps: f64, course: &Course<'_>) {
        let ts = course.task.ts;
        let mut expected = Motion::from(&self.start);
        let commands = self.way.commands_mut();
        if let Some(first) = commands.first() {
            expected = expected.then(&Motion::of_camera(first, steps * ts));
        }
        self.since += steps;
        if self.since >= WHOLE {
            self.since -= 1.0;
            commands.rotate_left(1);
            if let Some(last) = commands.last_mut() {
                *last = [0.0; DOF];
            }
        }
        let off = expected.inverse().then(&course.start).logarithm();
        let each = off / (CATCHING_UP as f64 * ts);
        for command in commands.iter_mut().take(CATCHING_UP) {
            let pairs = command.iter_mut().zip(&each);
            pairs.for_each(|(v, more)| *v += more);
        }
        (self.start, self.merit) = ((&course.start).into(), f64::INFINITY);
    }

    /// One pass. After [`DEAR`] passes, a draft that costs more than `most` is blocked.
    pub(crate) fn refine(
        &mut self,
        refiner: &mut Refiner<'_>,
        course: &Course<'_>,
        most: f64,
    ) -> Progress {
        let course = Course {
            barrier: self.barrier,
            damping: self.damping,
            ..*course
        };
        let Some((worth, is_better)) = refiner.pass(&course, self.way.commands_mut()) else {
            return Progress::Blocked;
        };
        self.passes += 1;
        let gained = self.merit - worth.merit();
        self.merit = worth.merit();
        self.damping = match is_better {
            true if self.damping <= DAMPING => 0.0,
            true => self.damping / STRONGER,
            false => (STRONGER * self.damping).max(DAMPING),
        };
        if self.passes >= DEAR && worth.cost > most {
            return Progress::Blocked;
        }
        let is_over = self.passes >= PASSES;
        if !is_better && self.damping <= STRONGEST && !is_over {
            return Progress::Going;
        }
        let is_settled = !is_better || gained < SETTLED * self.merit;
        let is_last = self.barrier == FIRM || worth.barrier == 0.0;
        let is_hopeless = self.passes >= HOPELESS && worth.worst_px > HOPELESS_PX;
        if is_over || is_hopeless || (is_settled && is_last) {
            return match worth.worst_px < CLEAR_PX {
                true => Progress::Done,
                false => Progress::Blocked,
            };
        }
        if is_settled || self.passes.is_multiple_of(EVERY) {
            self.barrier = self.barrier.steeper(&STEEPER, &FIRM);
            (self.merit, self.damping) = (f64::INFINITY, 0.0);
        }
        Progress::Going
    }
}
