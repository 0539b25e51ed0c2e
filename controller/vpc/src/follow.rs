//! Checks that the image follows the commands. A frozen image with a little noise, another camera's
//! image, or a command of the wrong sign gives features that look good frame by frame.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | d | `seen` | displacement of all points over a window, measured, px |
//! | c | `commanded` | the same by the commands sent, up to half a second earlier, px |
//! | p = d'c / abs(c) | `along` | how much of the seen displacement is along the commanded one, px |
//! | o | `object` | most that an object can take from p by a motion of its own, px |
//!
//! The image does not follow if, for every lag of the robot, p + 3 px < abs(c) / 3 and p + o + 3 px
//! < 0.5 abs(c). The check is repeated for c without the shift that is common to all points, and
//! for c without their common turn and growth.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::measurement::Refusal;
use crate::prediction::{InitialState, Model};
use crate::task::Task;
use crate::{MAX_POINTS, Points, camera};

/// Length of a slot, ns: windows and lags are whole slots, each a little longer than this at 30 Hz.
const SLOT_NS: u64 = 125_000_000;
/// Slots of a window: half a second for a fast camera, a second for a slow one.
const WINDOWS: [usize; 2] = [4, 8];
/// Largest lag, slots: a shaper, a low-pass filter and the way there have half a second together,
/// as in the daemon's watch of the robot.
const MOST_LAG: usize = 4;
/// Lags looked at in each slot: where commands turn round, the displacement changes quickly with
/// the lag.
const STEPS: usize = 4;
/// The lag of a usual robot, slots.
const USUAL_LAG: usize = 2;
/// Slots kept: the longest window at the largest lag.
const SLOTS: usize = 12;

/// Share of the commanded displacement below which the image does not follow.
const SHARE: f64 = 1.0 / 3.0;
/// Least share that errors of gain, depth and calibration leave: what is missing from it must be a
/// motion of the object.
const LEAST_GAIN: f64 = 0.5;
/// Six times the deviation of p with a noise of 0.35 px on each coordinate, px.
const NOISE_PX: f64 = 3.0;
/// Where less than this share of the commanded displacement is no common shift, errors of
/// calibration may hide it.
const LEAST_SHAPE: f64 = 0.25;
/// An object may move, and turn about its middle, at this share of the camera's velocity limits:
/// 0.1 m/s and 0.2 rad/s in the paper's scene.
const OBJECT: f64 = 0.2;

/// A displacement of each point, px.
type Displacement = [[f32; 2]; MAX_POINTS];

/// What was seen and commanded of late. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Follow {
    /// Slots in use, 0 to 12.
    count: u32,
    /// The newest first; the rest is zero, so that an unknown command counts as none.
    slots: [Slot; SLOTS],
    /// Commanded since the newest slot.
    since: Displacement,
}

/// The measurement that ends a slot, and the commanded displacement in the slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Slot {
    exposed_ns: u64,
    points: Displacement,
    commanded: Displacement,
}

impl Follow {
    /// Nothing was seen yet.
    pub const NEW: Self = Self {
        count: 0,
        slots: [Slot {
            exposed_ns: 0,
            points: [[0.0; 2]; MAX_POINTS],
            commanded: [[0.0; 2]; MAX_POINTS],
        }; SLOTS],
        since: [[0.0; 2]; MAX_POINTS],
    };

    /// Adds a measurement, which may be filtered, and where the commands since the one before
    /// should have taken the points `from` there: `to`.
    ///
    /// # Errors
    /// [`Refusal::NotFollowing`] if the image does not follow the commands.
    pub fn add(
        &mut self,
        task: &Task,
        measured: &InitialState,
        [from, to]: [&Points; 2],
        exposed_ns: u64,
    ) -> Result<(), Refusal> {
        for (sum, (from, to)) in self.since.iter_mut().zip(from.iter().zip(to)) {
            let each = sum.iter_mut().zip(from.iter().zip(to));
            each.for_each(|(sum, (from, to))| *sum += (to - from) as f32);
        }
        let [newest, ..] = &self.slots;
        if self.count > 0 && exposed_ns.saturating_sub(newest.exposed_ns) < SLOT_NS {
            return Ok(());
        }
        let mut slot = Slot {
            exposed_ns,
            commanded: core::mem::take(&mut self.since),
            ..Slot::default()
        };
        for (to, from) in slot.points.iter_mut().zip(&measured.points) {
            *to = from.map(|x| x as f32);
        }
        self.slots.rotate_right(1);
        let [newest, ..] = &mut self.slots;
        *newest = slot;
        self.count = (self.count + 1).min(SLOTS as u32);
        let flow = flow(task, measured, Mover::Object);
        WINDOWS
            .into_iter()
            .try_for_each(|window| self.check(task, &measured.points, &flow, window))
    }

    /// How far a point goes at most on what was commanded of late, px: so far ahead of the image a
    /// robot's commands may be.
    pub fn ahead_px(&self) -> f64 {
        let slots = self.slots.iter().take(USUAL_LAG);
        let all = slots.map(|slot| &slot.commanded).chain([&self.since]);
        let mut most = [0.0_f64; MAX_POINTS];
        for commanded in all {
            for (sum, [u, v]) in most.iter_mut().zip(commanded) {
                *sum += libm::hypot(f64::from(*u), f64::from(*v));
            }
        }
        most.into_iter().fold(0.0, f64::max)
    }

    /// The commanded displacement over a window of this many slots, `step` steps earlier.
    fn commanded(&self, step: usize, window: usize) -> Displacement {
        let (lag, part) = (step / STEPS, (step % STEPS) as f32 / STEPS as f32);
        let mut sum = [[0.0; 2]; MAX_POINTS];
        for slot in self.slots.iter().skip(lag).take(window) {
            add(&mut sum, &slot.commanded, 1.0);
        }
        // The newest slot leaves the window as the one before its oldest comes in.
        for (i, sign) in [(lag, -part), (lag + window, part)] {
            if let Some(slot) = self.slots.get(i) {
                add(&mut sum, &slot.commanded, sign);
            }
        }
        sum
    }

    /// Checks a window of so many slots.
    fn check(
        &self,
        task: &Task,
        points: &Points,
        flow: &[Displacement; 6],
        window: usize,
    ) -> Result<(), Refusal> {
        let ([newest, ..], Some(oldest)) = (&self.slots, self.slots.get(window)) else {
            return Ok(());
        };
        if self.count as usize <= window {
            return Ok(());
        }
        let mut seen = newest.points;
        add(&mut seen, &oldest.points, -1.0);
        let seconds = newest.exposed_ns.saturating_sub(oldest.exposed_ns) as f64 * 1e-9;
        let object = |along: &Displacement| {
            // Speed and turning rate, in any direction.
            let kinds = flow.chunks(3).zip(task.limits.chunks(3));
            let parts = kinds.map(|(flow, limits)| {
                let each = flow.iter().zip(limits);
                let each = each.map(|(flow, limit)| limit * dot(flow, along));
                libm::sqrt(each.map(|x| x * x).sum())
            });
            OBJECT * seconds * parts.sum::<f64>()
        };
        for without in [Without::Nothing, Without::Shift, Without::Similarity] {
            let mut least = (f64::INFINITY, 0.0);
            let mut lags = (0..=MOST_LAG * STEPS).map(|step| {
                let mut commanded = self.commanded(step, window);
                let whole = libm::sqrt(dot(&commanded, &commanded));
                without.leave_out(&mut commanded, points);
                let length = libm::sqrt(dot(&commanded, &commanded));
                let along = dot(&seen, &commanded) / length;
                if length < least.0 {
                    least = (length, along);
                }
                // False also for a NaN, where nothing was commanded.
                length > LEAST_SHAPE * whole
                    && along + NOISE_PX < SHARE * length
                    && along + object(&commanded) / length + NOISE_PX < LEAST_GAIN * length
            });
            if lags.all(|is_missing| is_missing) {
                let (commanded_px, seen_px) = least;
                return Err(Refusal::NotFollowing {
                    commanded_px,
                    seen_px,
                });
            }
        }
        Ok(())
    }
}

/// What is left out of a displacement, because a slow motion of the object changes it much.
#[derive(Clone, Copy, PartialEq)]
enum Without {
    Nothing,
    /// The shift that is common to all points, as of an object that moves sideways.
    Shift,
    /// Also its turn and growth, as of an object that turns about its normal or comes nearer.
    Similarity,
}

impl Without {
    fn leave_out(self, displacement: &mut Displacement, points: &Points) {
        let count = points.len().max(1) as f32;
        let mean = |all: &Displacement| -> [f32; 2] {
            core::array::from_fn(|i| all.iter().filter_map(|d| d.get(i)).sum::<f32>() / count)
        };
        let centre = |all: &mut Displacement| {
            let [u, v] = mean(all);
            let used = all.iter_mut().take(points.len());
            used.for_each(|d| *d = [d[0] - u, d[1] - v]);
        };
        if self == Self::Nothing {
            return;
        }
        centre(displacement);
        if self == Self::Shift {
            return;
        }
        let mut growth = [[0.0; 2]; MAX_POINTS];
        for (to, from) in growth.iter_mut().zip(points) {
            *to = from.map(|x| x as f32);
        }
        centre(&mut growth);
        let turn = growth.map(|[u, v]| [-v, u]);
        for pattern in [growth, turn] {
            let share = dot(displacement, &pattern) / dot(&pattern, &pattern);
            add(displacement, &pattern, -share as f32);
        }
    }
}

/// Largest motion of an object in the image by itself in this time, px.
pub fn object_px(task: &Task, points: &Points, seconds: f64) -> f64 {
    let at = InitialState::new(task, Model::AreaDepth, points);
    OBJECT * seconds * fastest(task, &flow(task, &at, Mover::Object))
}

/// Largest motion of the points in this time by a camera at its limits, px.
pub fn camera_px(task: &Task, points: &Points, seconds: f64) -> f64 {
    let at = InitialState::new(task, Model::AreaDepth, points);
    seconds * fastest(task, &flow(task, &at, Mover::Camera))
}

/// The velocity of the fastest point with each component of the twist at its limit, px/s.
fn fastest(task: &Task, flow: &[Displacement; 6]) -> f64 {
    let mut most = [[0.0_f64; 2]; MAX_POINTS];
    for (flow, limit) in flow.iter().zip(&task.limits) {
        for (sum, rate) in most.iter_mut().zip(flow) {
            let each = sum.iter_mut().zip(rate);
            each.for_each(|(sum, rate)| *sum += limit * f64::from(*rate).abs());
        }
    }
    let each = most.iter().map(|[u, v]| libm::hypot(*u, *v));
    each.fold(0.0, f64::max)
}

/// What moves.
#[derive(Clone, Copy, PartialEq)]
enum Mover {
    /// The camera, which turns about itself.
    Camera,
    /// The object, which turns about its middle.
    Object,
}

/// Image velocity of each point by a velocity of 1 in each component of the object, or of the
/// camera with the other sign, px/s.
fn flow(task: &Task, at: &InitialState, mover: Mover) -> [Displacement; 6] {
    let places = at.points.iter().zip(at.depths()).map(|(&pixel, depth)| {
        let [x, y] = camera::normalise(&task.camera, pixel);
        Vector3::new(x, y, 1.0) * depth
    });
    let places: heapless::Vec<Vector3<f64>, MAX_POINTS> = places.collect();
    let middle = match mover {
        Mover::Camera => Vector3::zeros(),
        Mover::Object => places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64,
    };
    let mut flow = [[[0.0; 2]; MAX_POINTS]; 6];
    for (k, column) in flow.iter_mut().enumerate() {
        let axis = Vector3::from_fn(|i, _| if i == k % 3 { 1.0 } else { 0.0 });
        for (rate, x) in column.iter_mut().zip(&places) {
            let velocity = match k < 3 {
                true => axis,
                false => axis.cross(&(x - middle)),
            };
            let along = |focal: f64, v: f64, x: f64, z: f64| focal * (v - x / z * velocity.z) / z;
            *rate = [
                along(task.camera.fx, velocity.x, x.x, x.z) as f32,
                along(task.camera.fy, velocity.y, x.y, x.z) as f32,
            ];
        }
    }
    flow
}

fn add(sum: &mut Displacement, other: &Displacement, sign: f32) {
    let pairs = sum.as_flattened_mut().iter_mut().zip(other.as_flattened());
    pairs.for_each(|(sum, x)| *sum += sign * x);
}

fn dot(a: &Displacement, b: &Displacement) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1.0 / 30.0;

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    /// When, if ever in 6 s, an image that moves by `moves(s)` px/s under a command of `speed(s)`
    /// px/s along u is found not to follow, s.
    fn found(speed: impl Fn(f64) -> f64, moves: impl Fn(f64) -> f64) -> Option<f64> {
        let task = task();
        let mut follow = Follow::NEW;
        let mut u = 0.0;
        (1..180).map(|k| f64::from(k) * PERIOD).find(|&s| {
            u += moves(s) * PERIOD;
            let from = &task.goal;
            let to = from
                .iter()
                .map(|p| [p[0] + speed(s) * PERIOD, p[1]])
                .collect();
            let seen: Points = from.iter().map(|p| [p[0] + u, p[1]]).collect();
            let seen = InitialState::new(&task, Model::AreaDepth, &seen);
            let added = follow.add(&task, &seen, [from, &to], (s * 1e9) as u64);
            added.is_err()
        })
    }

    /// Stands for a second, then goes.
    fn go(s: f64) -> f64 {
        if s < 1.0 { 0.0 } else { 400.0 }
    }

    #[test]
    fn an_image_that_stands_or_goes_the_other_way_does_not_follow() {
        let stands = found(go, |_| 0.0).unwrap();
        assert!((1.5..2.2).contains(&stands), "{stands}");
        let other = found(go, |s| -go(s)).unwrap();
        assert!((1.5..2.2).contains(&other), "{other}");
        // Frozen on its way.
        let froze = found(go, |s| if s < 1.6 { go(s) } else { 0.0 }).unwrap();
        assert!((1.9..2.8).contains(&froze), "{froze}");
    }

    #[test]
    fn late_weak_and_moving_images_still_follow() {
        assert_eq!(found(go, go), None);
        assert_eq!(found(go, |s| go(s - 0.5)), None);
        assert_eq!(found(go, |s| 0.6 * go(s)), None);
        // There and back, late.
        let swings = |s: f64| if s % 2.0 < 1.0 { 400.0 } else { -400.0 };
        for lag in [0.0, 0.05, 0.1, 0.2, 0.35, 0.5] {
            assert_eq!(found(swings, |s| 0.8 * swings(s - lag)), None, "{lag}");
        }
        // The camera keeps up with an object.
        assert_eq!(found(|_| 100.0, |_| 0.0), None);
        assert_eq!(found(go, |s| go(s) - 100.0), None);
    }

    #[test]
    fn a_gap_or_no_command_is_no_matter() {
        assert_eq!(found(|_| 0.0, go), None);
        assert_eq!(found(|_| 0.0, |_| 0.0), None);
    }
}
