//! First guesses: what drafts begin with.
//!
//! At first the listed detours, then what is left of the memory's nearest trajectories; afterwards
//! in turn the incumbent, a drawn detour, and what the law does under a drawn candidate. Where the
//! incumbent is a refined way itself, it has a second turn, in which it is loosened, so that it may
//! leave the side of an occlusion that it is on; and every second detour gives way to a change of
//! some of its commands.

use nalgebra::Vector6;

use crate::Twist;
use crate::course::{Course, Detour};
use crate::random::uniform_of;

/// Listed first guesses pass so far to the side, m, or so far along both axes, and turn by so much
/// about an axis of the image, or about the line of sight, rad. Drawn ones stay within.
const SIDE: f64 = 0.25;
const DIAGONAL: f64 = SIDE * core::f64::consts::FRAC_1_SQRT_2;
const TILT: f64 = 0.5;
const ROLL: f64 = 0.6;
/// The first guesses of a run. Of 126, each after the first was chosen as the one that lowers the
/// least cost most, where more than 1.5 times the best counts as 1.5 times; over 360 starts of
/// paper-sim, cup-disc-bars and u-spot-bar (seed 5).
pub(crate) const DETOURS: [Detour; 16] = [
    detour([0.0, 0.0, 0.3], [0.0, 0.0, 0.0]),
    detour([-SIDE, 0.0, 0.2], [0.0, -TILT, 0.0]),
    detour([-DIAGONAL, DIAGONAL, 0.2], [0.0, 0.0, -ROLL]),
    detour([SIDE, 0.0, 0.2], [TILT, 0.0, 0.0]),
    detour([-DIAGONAL, DIAGONAL, 0.0], [-TILT, 0.0, 0.0]),
    detour([0.0, 0.0, 0.3], [0.0, 0.0, ROLL]),
    detour([DIAGONAL, DIAGONAL, 0.0], [0.0, 0.0, -ROLL]),
    detour([0.0, SIDE, 0.2], [TILT, 0.0, 0.0]),
    detour([SIDE, 0.0, 0.0], [0.0, 0.0, ROLL]),
    detour([-DIAGONAL, -DIAGONAL, 0.2], [0.0, TILT, 0.0]),
    detour([-DIAGONAL, DIAGONAL, 0.2], [TILT, 0.0, 0.0]),
    detour([0.0, -SIDE, 0.2], [0.0, 0.0, ROLL]),
    detour([0.0, -SIDE, 0.2], [0.0, 0.0, -ROLL]),
    detour([0.0, SIDE, 0.2], [0.0, 0.0, -ROLL]),
    detour([SIDE, 0.0, 0.2], [0.0, 0.0, 0.0]),
    detour([DIAGONAL, -DIAGONAL, 0.2], [-TILT, 0.0, 0.0]),
];

const fn detour(aside: [f64; 3], turn: [f64; 3]) -> Detour {
    Detour { aside, turn }
}

/// Clearance of a draft by a detour, or by a change of the incumbent, px, where the law's own is
/// less: more of these find a way, and refining brings the best of them closer. Chosen on 98 starts
/// of paper-sim, after a second of standing, among 0, 8, 10 and 13 px.
const WIDE_PX: f64 = 10.0;
/// The commands of the incumbent that a draft changes: the first, below this, and how many.
const CHANGED_FROM: f64 = 20.0;
const FEWEST_CHANGED: usize = 3;
const MORE_CHANGED: f64 = 12.0;
/// The nearest trajectories of the memory, so many, are first guesses after these.
const REMEMBERED: usize = 8;

/// What a draft begins with.
#[derive(Debug)]
pub(crate) enum Guess {
    /// A course past the side, to the goal.
    Detour(Detour),
    /// The same, as close to borders as the law passes.
    Close(Detour),
    /// What is left of a trajectory of the memory, by its rank; the nearest is 1.
    Remembered(usize),
    /// What the law does under the incumbent.
    Simulated,
    /// What is left of the incumbent, a refined way.
    Kept,
    /// The same; it may leave its side of an occlusion.
    Loosened,
    /// The same, with some commands changed.
    Changed(Change),
    /// What the law does under a drawn candidate.
    Candidate,
}

impl Guess {
    /// The guess of this draft, counted from 1, and what takes its place where there is no such
    /// thing. `is_refined`: whether the incumbent is a refined way.
    pub(crate) fn of(number: u64, is_refined: bool) -> impl Iterator<Item = Self> {
        let place = number.saturating_sub(1) as usize;
        let rank = (place + 1).saturating_sub(DETOURS.len());
        let first = match DETOURS.get(place) {
            Some(detour) => Some(Self::Detour(*detour)),
            None => (rank <= REMEMBERED).then_some(Self::Remembered(rank)),
        };
        let turn = match (number % 8, is_refined) {
            (0 | 4, true) => Self::Loosened,
            (0 | 4, false) => Self::Simulated,
            (2 | 6, true) => Self::Kept,
            (5, true) => Self::Changed(Change::drawn(number)),
            (3 | 7, _) => Self::Candidate,
            _ => Self::Detour(drawn(number)),
        };
        let last = Self::Close(drawn(number));
        [first, Some(turn), Some(last)].into_iter().flatten()
    }

    /// Clearance that the draft keeps beside the settings' margin, px.
    pub(crate) fn spare_px(&self) -> f64 {
        match self {
            Self::Detour(_) | Self::Changed(_) => WIDE_PX,
            _ => 0.0,
        }
    }
}

/// A detour by chance.
fn drawn(number: u64) -> Detour {
    let within = |most: f64, k| most * (2.0 * uniform_of(number, k) - 1.0);
    Detour {
        aside: [1, 2, 3].map(|k| within(SIDE, k)),
        turn: [(TILT, 4), (TILT, 5), (ROLL, 6)].map(|(most, k)| within(most, k)),
    }
}

/// A change of commands: a twist is added to some, and taken from as many after them.
#[derive(Debug)]
pub(crate) struct Change {
    /// The first of them.
    from: usize,
    /// How many.
    count: usize,
    /// The twist, as shares of the limits.
    shares: Twist,
}

impl Change {
    fn drawn(number: u64) -> Self {
        let uniform = |k| uniform_of(number, k);
        Self {
            from: (CHANGED_FROM * uniform(0)) as usize,
            count: FEWEST_CHANGED + (MORE_CHANGED * uniform(7)) as usize,
            shares: [1, 2, 3, 4, 5, 6].map(|k| 2.0 * uniform(k) - 1.0),
        }
    }

    /// Changes commands; they stay within the bounds.
    pub(crate) fn apply(&self, course: &Course<'_>, commands: &mut [Twist]) {
        let limits = Vector6::from(course.task.limits);
        let twist = limits.component_mul(&Vector6::from(self.shares));
        for (k, to) in commands.iter_mut().enumerate() {
            let command = Vector6::from(*to);
            let command = match k.checked_sub(self.from).map(|k| k / self.count) {
                Some(0) => command + twist,
                Some(1) => command - twist,
                _ => command,
            };
            *to = course.within(&command);
        }
    }
}
