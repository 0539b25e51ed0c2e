//! Checks that the image follows the commands. A frozen image with a little noise, another camera's
//! image, or a command of the wrong sign gives features that look good frame by frame.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | d | `seen` | displacement of all points over a window, measured, px |
//! | c | [`Track::commanded`] | the same by the commands sent, up to half a second earlier, px |
//! | p = d'c / abs(c) | `along` | how much of the seen displacement is along the commanded one, px |
//! | o | `object` | most that an object can take from p, or add to it, by a motion of its own, px |
//!
//! The image does not follow if, for every lag of the robot, p + 3 px < abs(c) / 3 and p + o + 3 px
//! < 0.5 abs(c). The check is repeated for c without the shift that is common to all points, and
//! for c without their common turn and growth. It moves more than commanded if over a quarter of
//! a second abs(d) > 2 abs(c) + o + 6 px, where the norms are taken over each image and c begins a
//! quarter of a second earlier. It is late if a lag beyond [`crate::lag::MOST_LAG_S`] explains it,
//! and none with which the law is served does.
//!
//! Only images that show all points end a slot: predicted points do as they are told.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::lag::{Displacement, MOST_LAG_S, Track, add, dot};
use crate::measurement::Refusal;
use crate::prediction::{InitialState, Model};
use crate::task::Task;
use crate::{MAX_POINTS, Points, camera};

/// Windows: half a second for a fast camera, a second for a slow one, ns.
const WINDOWS_NS: [u64; 2] = [500_000_000, 1_000_000_000];
/// Lags at which an image may follow, and the distance between two of them, ns: a shaper, a
/// low-pass filter and the way there have half a second together, as in the daemon's watch of the
/// robot. Where commands turn round, the displacement changes quickly with the lag.
const LAGS: u64 = 17;
const STEP_NS: u64 = 31_250_000;
/// The greatest lag of a usual robot, and the window in which it moves more than commanded, ns.
const USUAL_LAG_NS: u64 = 250_000_000;
/// Within this time a second push is none, ns.
const PUSH_NS: u64 = 1_000_000_000;

/// Share of the commanded displacement below which the image does not follow.
const SHARE: f64 = 1.0 / 3.0;
/// Least share that errors of gain, depth and calibration leave: what is missing from it must be a
/// motion of the object.
const LEAST_GAIN: f64 = 0.5;
/// The greatest that they leave.
const MOST_GAIN: f64 = 2.0;
/// A camera that is told to move less than this share of what an object may do tells no gain: the
/// object may be carried along.
const LEAST_OF_OBJECT: f64 = 0.5;
/// The share of an object's speed by which it may turn round in a window that tells a lag: what an
/// object does by itself is no late answer to commands.
const LAGGING: f64 = 0.7;
/// Six times the deviation of p with a noise of 0.35 px on each coordinate, px.
const NOISE_PX: f64 = 3.0;
/// The same of all coordinates in all slots of a window, px.
const NOISE_OF_SLOTS_PX: f64 = 6.0;
/// Where less than this share of the commanded displacement is no common shift, errors of
/// calibration may hide it.
const LEAST_SHAPE: f64 = 0.25;
/// An object may move, and turn about its middle, at this share of the camera's velocity limits:
/// 0.1 m/s and 0.2 rad/s in the paper's scene.
const OBJECT: f64 = 0.2;
/// What was seen and commanded of late. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Follow {
    track: Track,
    /// The points at the end of the newest slot.
    points: Displacement,
    /// Whether the last image showed all points.
    was_whole: bool,
    /// The exposure that showed the last push, ns; 0 before the first.
    pushed_ns: u64,
}

impl Follow {
    /// Nothing was seen yet.
    pub const NEW: Self = Self {
        track: Track::NEW,
        points: [[0.0; 2]; MAX_POINTS],
        was_whole: false,
        pushed_ns: 0,
    };

    /// Adds a measurement, which may be filtered, and where the commands since the one before
    /// should have taken the points `from` there: `to`.
    ///
    /// # Errors
    /// [`Refusal::NotFollowing`], [`Refusal::Exceeding`] or [`Refusal::Lagging`] if the image does
    /// not follow the commands.
    pub fn add(
        &mut self,
        task: &Task,
        measured: &InitialState,
        [from, to]: [&Points; 2],
        exposed_ns: u64,
        is_whole: bool,
    ) -> Result<(), Refusal> {
        let points = plain(&measured.points);
        let [commanded, moved] = [plain(to), points].map(|to| less(to, &plain(from)));
        self.track.command(&commanded, exposed_ns);
        let was_whole = core::mem::replace(&mut self.was_whole, is_whole);
        if is_whole && was_whole {
            self.track.compare(&moved, &commanded);
        }
        if !is_whole || !self.track.is_due(exposed_ns) {
            return Ok(());
        }
        let before = core::mem::replace(&mut self.points, points);
        self.track.end(less(points, &before));
        let flow = flow(task, measured, Mover::Object);
        WINDOWS_NS
            .into_iter()
            .try_for_each(|window_ns| self.check(task, &measured.points, &flow, window_ns))?;
        let speed = OBJECT * object_speed(task, &flow);
        self.check_gain(speed)?;
        match self.track.late([NOISE_OF_SLOTS_PX, LAGGING * speed]) {
            Some(lag_s) => Err(Refusal::Lagging {
                lag_s,
                most_s: MOST_LAG_S,
            }),
            None => Ok(()),
        }
    }

    /// An image shows a push: further than a command of the wrong sign would take it, it is no
    /// matter of the commands. A camera is not pushed again and again.
    pub fn push(&mut self, exposed_ns: u64) {
        let is_again = exposed_ns.saturating_sub(self.pushed_ns) < PUSH_NS;
        if !is_again {
            *self = Self::NEW;
        }
        self.pushed_ns = exposed_ns;
    }

    /// How far a point goes at most on what was commanded of late, px: so far ahead of the image a
    /// robot's commands may be.
    pub fn ahead_px(&self) -> f64 {
        self.track.path_px(USUAL_LAG_NS)
    }

    /// Checks the shortest window of at least this length.
    fn check(
        &self,
        task: &Task,
        points: &Points,
        flow: &[Displacement; 6],
        window_ns: u64,
    ) -> Result<(), Refusal> {
        let Some(slots) = self.track.window(window_ns) else {
            return Ok(());
        };
        let (seen, seconds) = self.track.moved(slots);
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
            let mut is_missing = true;
            for lag in 0..LAGS {
                let mut commanded = self.track.commanded(slots, lag * STEP_NS);
                let whole = libm::sqrt(dot(&commanded, &commanded));
                without.leave_out(&mut commanded, points);
                let length = libm::sqrt(dot(&commanded, &commanded));
                let along = dot(&seen, &commanded) / length;
                if length < least.0 {
                    least = (length, along);
                }
                // False also for a NaN, where nothing was commanded.
                is_missing &= length > LEAST_SHAPE * whole
                    && along + NOISE_PX < SHARE * length
                    && along + object(&commanded) / length + NOISE_PX < LEAST_GAIN * length;
            }
            if is_missing {
                let (commanded_px, seen_px) = least;
                return Err(Refusal::NotFollowing {
                    commanded_px,
                    seen_px,
                });
            }
        }
        Ok(())
    }

    /// Checks that the image does not move more than commanded, where an object moves at this speed
    /// at most, px/s.
    fn check_gain(&self, speed: f64) -> Result<(), Refusal> {
        let Some(slots) = self.track.window(USUAL_LAG_NS) else {
            return Ok(());
        };
        let (_, seconds) = self.track.moved(slots);
        let ([seen_px, commanded_px], steps) = self.track.norms(slots);
        let other = NOISE_OF_SLOTS_PX + speed * seconds / libm::sqrt(steps.max(1.0));
        let tells = commanded_px > LEAST_OF_OBJECT * other;
        match tells && seen_px > MOST_GAIN * commanded_px + other {
            true => Err(Refusal::Exceeding {
                commanded_px,
                seen_px,
            }),
            false => Ok(()),
        }
    }
}

/// The displacement from `other` to `points`.
fn less(mut points: Displacement, other: &Displacement) -> Displacement {
    add(&mut points, other, -1.0);
    points
}

fn plain(points: &Points) -> Displacement {
    let mut plain = [[0.0; 2]; MAX_POINTS];
    for (to, from) in plain.iter_mut().zip(points) {
        *to = from.map(|x| x as f32);
    }
    plain
}

/// The norm of the image velocities of an object at the camera's limits of speed and turning rate,
/// in the direction and about the axis in which it is greatest, px/s.
fn object_speed(task: &Task, flow: &[Displacement; 6]) -> f64 {
    let kinds = flow.chunks(3).zip(task.limits.chunks(3));
    let most = kinds.map(|(flow, limits)| {
        let each = flow.iter().zip(limits);
        let each = each.map(|(flow, limit)| limit * libm::sqrt(dot(flow, flow)));
        each.fold(0.0, f64::max)
    });
    most.sum()
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

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1.0 / 30.0;

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    /// When, if ever in 6 s, an image that moves by `moves(s)` px/s under a command of `speed(s)`
    /// px/s along u is refused, s, and why.
    fn refused(speed: impl Fn(f64) -> f64, moves: impl Fn(f64) -> f64) -> Option<(f64, Refusal)> {
        let task = task();
        let mut follow = Follow::NEW;
        let mut u = 0.0;
        (1..180).map(|k| f64::from(k) * PERIOD).find_map(|s| {
            let at = |u: f64| -> Points { task.goal.iter().map(|p| [p[0] + u, p[1]]).collect() };
            let (from, to) = (at(u), at(u + speed(s) * PERIOD));
            u += moves(s) * PERIOD;
            let seen = at(u);
            let seen = InitialState::new(&task, Model::AreaDepth, &seen);
            let added = follow.add(&task, &seen, [&from, &to], (s * 1e9) as u64, true);
            Some((s, added.err()?))
        })
    }

    /// The same without the reason.
    fn found(speed: impl Fn(f64) -> f64, moves: impl Fn(f64) -> f64) -> Option<f64> {
        refused(speed, moves).map(|(s, _)| s)
    }

    /// To and fro, at the limits.
    fn swings(s: f64) -> f64 {
        if s % 2.0 < 1.0 { 400.0 } else { -400.0 }
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
        assert_eq!(found(go, |s| go(s - 0.15)), None);
        assert_eq!(found(go, |s| 0.6 * go(s)), None);
        for lag in [0.0, 0.05, 0.1, 0.15] {
            assert_eq!(found(swings, |s| 0.8 * swings(s - lag)), None, "{lag}");
        }
        // The camera keeps up with an object.
        assert_eq!(found(|_| 100.0, |_| 0.0), None);
        assert_eq!(found(go, |s| go(s) - 100.0), None);
    }

    #[test]
    fn an_image_that_moves_three_times_as_far_exceeds_its_commands() {
        let fast = found(go, |s| 3.0 * go(s)).unwrap();
        assert!((1.1..1.8).contains(&fast), "{fast}");
        for lag in [0.0, 0.1] {
            assert_eq!(found(go, |s| 1.5 * go(s - lag)), None);
        }
        // An object that is carried along.
        assert_eq!(found(|_| 10.0, |_| 300.0), None);
    }

    #[test]
    fn an_image_that_is_later_than_the_law_stands_is_late() {
        for lag in [0.4, 0.5] {
            let (_, refusal) = refused(swings, |s| 0.8 * swings(s - lag)).unwrap();
            let Refusal::Lagging { lag_s, .. } = refusal else {
                panic!("{lag}: {refusal}");
            };
            assert!((lag_s - lag).abs() < 0.1, "{lag}: {lag_s}");
        }
    }

    #[test]
    fn a_gap_or_no_command_is_no_matter() {
        assert_eq!(found(|_| 0.0, go), None);
        assert_eq!(found(|_| 0.0, |_| 0.0), None);
    }
}
