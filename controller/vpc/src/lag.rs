//! Lag: how late a motion follows its commands, by correlation over a second.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | d_k | `moved` | displacement that was measured in slot k |
//! | c_k(l) | [`Track::commanded`] | displacement that was commanded l seconds before the slot's time |
//! | g | `gain` | least-squares gain of d over c(l), in [1/2, 2] |
//! | V(l) | `misfit` | sum over the slots of abs(d_k - g c_k(l))^2 |
//!
//! A robot may have a low-pass filter instead: c is then what that makes of the commands. d and c
//! are taken without their mean velocities over the window: a steady motion tells no lag, and an
//! object that moves steadily does not hide one. The lag is where V is least.
#![expect(
    clippy::indexing_slicing,
    reason = "a dense kernel: indices run over the lags, of a constant count"
)]

use serde::{Deserialize, Serialize};

use crate::MAX_POINTS;

/// Least length of a slot, ns: three frames at 30 Hz, one at 10 Hz.
const SLOT_NS: u64 = 90_000_000;
/// Slots kept: a second and the largest lag.
const SLOTS: usize = 17;
/// A slot longer than this is a gap, in which a lag cannot be told, ns.
const GAP_NS: u64 = 3 * SLOT_NS;
/// Length of the window, ns.
const WINDOW_NS: u64 = 750_000_000;
/// Lags that are compared, and the distance between two of them, ns.
const LAGS: usize = 25;
const STEP_NS: u64 = 31_250_000;
/// The lag is known where V is below this share of V elsewhere.
const CLEARLY: f64 = 0.25;

/// A lag with which the law arrives as often as without, s; with 0.15 s it swings about the goal in
/// half of the runs, with 0.2 s in all, at 10 to 30 Hz.
const SERVED_LAG_S: f64 = 0.1;
/// The greatest lag that is not held, s.
pub const MOST_LAG_S: f64 = 0.17;

/// Time constants of low-pass filters that the law stands, s: a robot that has one is not late.
const LOW_PASSES_S: [f64; 2] = [0.15, 0.3];

/// The commands of all slots.
type Commands = [Displacement; SLOTS];

/// A displacement of each point, px; or of anything else that is told by as many numbers.
pub type Displacement = [[f32; 2]; MAX_POINTS];

/// What was commanded and measured of late, slot by slot. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Slots in use, 0 to 17.
    count: u32,
    /// The newest first; the rest is zero, so that an unknown command counts as none.
    slots: [Slot; SLOTS],
    /// Commanded since the newest slot, and until when.
    since: Displacement,
    until_ns: u64,
    steps: Steps,
}

/// The end of a slot, and the displacements in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Slot {
    end_ns: u64,
    moved: Displacement,
    commanded: Displacement,
    steps: Steps,
}

/// The steps from one measurement to the next that were compared: their number, and the squares of
/// what was measured and commanded in each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Steps {
    count: u32,
    moved: f32,
    commanded: f32,
}

impl Steps {
    const NONE: Self = Self {
        count: 0,
        moved: 0.0,
        commanded: 0.0,
    };
}

/// How many of the lags are at most this one, s.
const fn count(lag_s: f64) -> usize {
    1 + (lag_s * 1e9) as usize / STEP_NS as usize
}

impl Track {
    /// Nothing was measured yet.
    pub const NEW: Self = Self {
        count: 0,
        slots: [Slot {
            end_ns: 0,
            moved: [[0.0; 2]; MAX_POINTS],
            commanded: [[0.0; 2]; MAX_POINTS],
            steps: Steps::NONE,
        }; SLOTS],
        since: [[0.0; 2]; MAX_POINTS],
        until_ns: 0,
        steps: Steps::NONE,
    };

    /// Adds what was commanded until `until_ns` since the last call.
    pub fn command(&mut self, commanded: &Displacement, until_ns: u64) {
        add(&mut self.since, commanded, 1.0);
        self.until_ns = until_ns;
    }

    /// Adds what was measured in one step beside what was commanded in it.
    pub fn compare(&mut self, moved: &Displacement, commanded: &Displacement) {
        self.steps.count += 1;
        self.steps.moved += dot(moved, moved) as f32;
        self.steps.commanded += dot(commanded, commanded) as f32;
    }

    /// Whether a measurement at this instant ends a slot.
    pub fn is_due(&self, at_ns: u64) -> bool {
        self.count == 0 || at_ns.saturating_sub(self.slots[0].end_ns) >= SLOT_NS
    }

    /// Ends a slot at the instant of the last command, with what was measured in it.
    pub fn end(&mut self, moved: Displacement) {
        self.slots.rotate_right(1);
        self.slots[0] = Slot {
            end_ns: self.until_ns,
            moved,
            commanded: core::mem::take(&mut self.since),
            steps: core::mem::take(&mut self.steps),
        };
        self.count = (self.count + 1).min(SLOTS as u32);
    }

    /// Slots of the shortest window of at least this length; `None` if so many are not known.
    pub fn window(&self, length_ns: u64) -> Option<usize> {
        let known = &self.slots[..self.count as usize];
        let newest = known.first()?.end_ns;
        known
            .iter()
            .position(|slot| newest.saturating_sub(slot.end_ns) >= length_ns)
    }

    /// What was measured in the newest `slots`, and how long they are, s.
    pub fn moved(&self, slots: usize) -> (Displacement, f64) {
        let mut sum = [[0.0; 2]; MAX_POINTS];
        let used = self.slots.iter().take(slots);
        used.for_each(|slot| add(&mut sum, &slot.moved, 1.0));
        (sum, self.seconds(0, slots))
    }

    /// What was commanded in the newest `slots`, `lag_ns` earlier.
    pub fn commanded(&self, slots: usize, lag_ns: u64) -> Displacement {
        let at = |i: usize| self.slots[i.min(SLOTS - 1)].end_ns.saturating_sub(lag_ns);
        let told = core::array::from_fn(|k| self.slots[k].commanded);
        self.between(&told, at(slots), at(0))
    }

    /// Over the single steps in the newest `slots`: the norm of what was measured; the greatest
    /// norm of what was commanded in these, or in as many that end up to so many slots earlier; and
    /// the number of steps.
    pub fn norms(&self, slots: usize) -> ([f64; 2], f64) {
        let sum = |skipped: usize, of: fn(&Steps) -> f64| -> f64 {
            let used = self.slots.iter().skip(skipped).take(slots);
            used.map(|slot| of(&slot.steps)).sum()
        };
        let commanded = (0..=slots).map(|skipped| sum(skipped, |steps| steps.commanded.into()));
        let squares = [
            sum(0, |steps| steps.moved.into()),
            commanded.fold(0.0, f64::max),
        ];
        (squares.map(libm::sqrt), sum(0, |steps| steps.count.into()))
    }

    /// How far a point goes at most on what was commanded in the last `length_ns`, px.
    pub fn path_px(&self, length_ns: u64) -> f64 {
        let from_ns = self.until_ns.saturating_sub(length_ns);
        let mut most = [0.0_f64; MAX_POINTS];
        let mut walk = |commanded: &Displacement, share: f32| {
            for (sum, [u, v]) in most.iter_mut().zip(commanded) {
                *sum += f64::from(share * libm::hypotf(*u, *v));
            }
        };
        let newest_ns = self.slots[0].end_ns;
        walk(
            &self.since,
            share(newest_ns, self.until_ns, from_ns, self.until_ns),
        );
        for (slot, begin) in self.slots.iter().zip(&self.slots[1..]) {
            let part = share(begin.end_ns, slot.end_ns, from_ns, self.until_ns);
            walk(&slot.commanded, part);
        }
        most.into_iter().fold(0.0, f64::max)
    }

    /// The lag, s, if it is greater than [`MOST_LAG_S`] and known: the motion is then explained
    /// clearly better than by any lag up to `SERVED_LAG_S`, and what these leave is more than
    /// `noise`, the norm over all numbers and slots, and motions at `speed` of another cause, back
    /// and forth.
    pub fn late(&self, [noise, speed]: [f64; 2]) -> Option<f64> {
        let slots = self.window(WINDOW_NS)?;
        let ends = self.slots.iter().zip(&self.slots[1..]).take(slots);
        let is_gap = |(slot, begin): (&Slot, &Slot)| slot.end_ns - begin.end_ns > GAP_NS;
        if ends.clone().any(is_gap) {
            return None;
        }
        let told = core::array::from_fn(|k| self.slots[k].commanded);
        let misfits: [f64; LAGS] =
            core::array::from_fn(|k| self.misfit(&told, slots, k as u64 * STEP_NS));
        let soft = LOW_PASSES_S.map(|time_s| {
            let told = self.low_pass(time_s);
            let each =
                (0..count(SERVED_LAG_S)).map(|k| self.misfit(&told, slots, k as u64 * STEP_NS));
            each.fold(f64::INFINITY, f64::min)
        });
        let least = |from: usize, to: usize| {
            let each = misfits.iter().enumerate().take(to).skip(from);
            each.fold(
                (0, f64::INFINITY),
                |least, (k, &v)| {
                    if v < least.1 { (k, v) } else { least }
                },
            )
        };
        let (_, near) = least(0, count(SERVED_LAG_S));
        let near = soft.into_iter().fold(near, f64::min);
        let (k, far) = least(0, LAGS);
        let other = speed * self.seconds(0, slots) / libm::sqrt(slots as f64);
        let is_known = libm::sqrt(near) > noise + other && far < CLEARLY * near;
        let is_late = is_known && k >= count(MOST_LAG_S);
        is_late.then_some(k as f64 * STEP_NS as f64 * 1e-9)
    }

    /// What a low-pass filter of this time constant makes of the commands in each slot.
    fn low_pass(&self, time_s: f64) -> Commands {
        let mut told = [[[0.0; 2]; MAX_POINTS]; SLOTS];
        // The velocity that the filter has reached.
        let mut reached = [[0.0; 2]; MAX_POINTS];
        for k in (0..SLOTS - 1).rev() {
            let seconds = self.seconds(k, k + 1);
            if self.slots[k + 1].end_ns == 0 || seconds == 0.0 {
                continue;
            }
            let left = libm::exp(-seconds / time_s);
            // It begins a slot away from the command's velocity, and comes nearer to it.
            let mut away = reached;
            add(&mut away, &self.slots[k].commanded, -1.0 / seconds as f32);
            told[k] = self.slots[k].commanded;
            add(&mut told[k], &away, (time_s * (1.0 - left)) as f32);
            add(&mut reached, &away, (left - 1.0) as f32);
        }
        told
    }

    /// V of these commands at this lag.
    fn misfit(&self, told: &Commands, slots: usize, lag_ns: u64) -> f64 {
        let seconds = self.seconds(0, slots) as f32;
        let (moved, _) = self.moved(slots);
        let end = |i: usize| self.slots[i.min(SLOTS - 1)].end_ns.saturating_sub(lag_ns);
        let commanded = self.between(told, end(slots), end(0));
        let (mut dd, mut dc, mut cc) = (0.0, 0.0, 0.0);
        for k in 0..slots {
            let part = self.seconds(k, k + 1) as f32 / seconds;
            let mut d = self.slots[k].moved;
            add(&mut d, &moved, -part);
            let mut c = self.between(told, end(k + 1), end(k));
            add(&mut c, &commanded, -part);
            dd += dot(&d, &d);
            dc += dot(&d, &c);
            cc += dot(&c, &c);
        }
        let gain = if cc > 0.0 {
            (dc / cc).clamp(0.5, 2.0)
        } else {
            0.0
        };
        dd - 2.0 * gain * dc + gain * gain * cc
    }

    /// The time from the end of one slot to that of a newer one, s.
    fn seconds(&self, newer: usize, older: usize) -> f64 {
        let end = |i: usize| self.slots[i.min(SLOTS - 1)].end_ns;
        end(newer).saturating_sub(end(older)) as f64 * 1e-9
    }

    /// What these commands of all slots are between two instants, evenly in each slot.
    fn between(&self, told: &Commands, from_ns: u64, to_ns: u64) -> Displacement {
        let mut sum = [[0.0; 2]; MAX_POINTS];
        let slots = self.slots.iter().zip(&self.slots[1..]);
        for ((slot, begin), told) in slots.zip(told) {
            let part = share(begin.end_ns, slot.end_ns, from_ns, to_ns);
            if part > 0.0 {
                add(&mut sum, told, part);
            }
        }
        sum
    }
}

/// The share of the time between `begin` and `end` that lies between `from` and `to`.
fn share(begin: u64, end: u64, from: u64, to: u64) -> f32 {
    // Of the oldest slot the begin is unknown.
    if begin == 0 || end <= begin {
        return 0.0;
    }
    let inside = |at: u64| at.clamp(begin, end);
    inside(to).saturating_sub(inside(from)) as f32 / (end - begin) as f32
}

/// Adds a displacement, `factor` times.
pub fn add(sum: &mut Displacement, other: &Displacement, factor: f32) {
    let pairs = sum.as_flattened_mut().iter_mut().zip(other.as_flattened());
    pairs.for_each(|(sum, x)| *sum += factor * x);
}

/// The inner product of two displacements.
pub fn dot(a: &Displacement, b: &Displacement) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lag that is told in four seconds at this rate, if any, where `moves(s)` answers the
    /// command `told(s)`, both in px/s.
    fn late(rate_hz: f64, told: impl Fn(f64) -> f64, moves: impl Fn(f64) -> f64) -> Option<f64> {
        let mut track = Track::NEW;
        let mut moved = Displacement::default();
        (1..(4.0 * rate_hz) as u64).find_map(|k| {
            let seconds = k as f64 / rate_hz;
            let step = |v: f64| [[(v / rate_hz) as f32, 0.0]; MAX_POINTS];
            let at_ns = 1_000_000_000 + (seconds * 1e9) as u64;
            add(&mut moved, &step(moves(seconds)), 1.0);
            track.command(&step(told(seconds)), at_ns);
            if !track.is_due(at_ns) {
                return None;
            }
            track.end(core::mem::take(&mut moved));
            track.late([6.0, 150.0])
        })
    }

    /// To and fro, at the limits.
    fn swing(s: f64) -> f64 {
        if s < 0.0 {
            0.0
        } else {
            400.0 * (1.0 - 2.0 * libm::floor(2.0 * s).rem_euclid(2.0))
        }
    }

    #[test]
    fn a_lag_is_told_where_commands_change() {
        for rate in [10.0, 15.0, 30.0, 250.0] {
            for lag in [0.3, 0.4] {
                for gain in [0.6, 1.0, 1.8] {
                    let told = late(rate, swing, |s| gain * swing(s - lag)).unwrap();
                    assert!((told - lag).abs() < 0.1, "{rate} {lag} {gain}: {told}");
                }
            }
            for lag in [0.0, 0.05, 0.1] {
                assert_eq!(late(rate, swing, |s| swing(s - lag)), None, "{rate} {lag}");
            }
        }
    }

    #[test]
    fn what_stands_moves_steadily_or_by_itself_has_no_lag() {
        assert_eq!(late(30.0, |_| 400.0, |_| 200.0), None);
        assert_eq!(late(30.0, swing, |_| 0.0), None);
        assert_eq!(late(30.0, swing, |_| 300.0), None);
        assert_eq!(late(30.0, |_| 0.0, swing), None);
        // Commands that are small beside what moves by itself.
        assert_eq!(
            late(30.0, |s| 0.1 * swing(s), |s| 0.1 * swing(s - 0.4)),
            None
        );
        assert_eq!(late(30.0, swing, |s| swing(s) + 100.0), None);
    }
}
