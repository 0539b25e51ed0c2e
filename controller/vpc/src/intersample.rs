//! Constraints between the sampling instants: the path of the features during the first step of the
//! window, or of the first period and a stop if that takes longer ([`Task::brakes`]).
//!
//! Features move up to 100 px in a step, further than many an occlusion is wide. Only the first
//! command of a plan is executed, so only its path is sampled between the steps. A later step is
//! sampled once it becomes the first.
//!
//! The path is cut into equal stretches, so that no feature near a border moves more than
//! [`SPACING_PX`] in one stretch; there are at most [`STRETCHES_A_STEP`] for each step. Between two
//! samples a feature that rounds a right-angled corner is at most 3 px inside.

use crate::clearance::{Clearance, Place};
use crate::constraint::{self, Border};
use crate::prediction::InitialState;
use crate::task::Task;
use crate::workspace::Workspace;
use crate::{MAX_POINTS, Twist};

/// Image motion between two samples of the path, px.
pub const SPACING_PX: f64 = 8.0;
/// Most stretches of one step's path.
pub const STRETCHES_A_STEP: usize = 12;
/// Most stretches of a whole path.
const MOST_STRETCHES: usize = 36;
/// A path is sampled if a marker's edge comes nearer to a border than this, px.
pub(crate) const NEAR_PX: f64 = 20.0;
/// A feature's way leaves the box about its ends by at most this share of its length, where the
/// camera turns by no more than [`TURN`].
const BEND: f64 = 0.1;
/// Longest turn of one piece of a path, rad. A circle's arc rises by tan(turn / 4) / 2 of its
/// chord.
const TURN: f64 = 0.7;
/// Most pieces of a path.
const MOST_PIECES: usize = 16;

/// Samples of the path of the features.
#[derive(Debug)]
pub(crate) struct Intersample<'w> {
    /// Stretches of the way; their ends are the places, the last one only if it is behind the
    /// first step.
    stretches: usize,
    /// Places that count.
    count: usize,
    /// The points whose way comes near a border.
    is_near: [bool; MAX_POINTS],
    /// A box about the way of each point: least and greatest (u, v), px.
    boxes: [[[f64; 2]; 2]; MAX_POINTS],
    /// The greatest radius of each point's marker, px.
    radii: [f64; MAX_POINTS],
    /// Points that there is room for at each place.
    room: usize,
    /// (u, v) and the radius of point i at place k, px, at `k * room + i`; of points that come near
    /// no border they mean nothing.
    places: &'w mut [[f64; 3]],
}

/// Most stretches of a task's ways.
pub(crate) fn most_stretches(task: &Task) -> usize {
    let steps = libm::ceil(task.reach / task.ts) as usize;
    (STRETCHES_A_STEP * steps).min(MOST_STRETCHES)
}

impl<'w> Intersample<'w> {
    /// Numbers of workspace for these counts of stretches and points.
    pub(crate) const fn room(stretches: usize, points: usize) -> usize {
        3 * stretches * points
    }

    pub(crate) fn cut(
        stretches: usize,
        points: usize,
        workspace: &mut Workspace<'w>,
    ) -> Option<Self> {
        Some(Self {
            stretches: 1,
            count: 0,
            is_near: [false; MAX_POINTS],
            boxes: [[[0.0; 2]; 2]; MAX_POINTS],
            radii: [0.0; MAX_POINTS],
            room: points,
            places: workspace.arrays(stretches * points)?,
        })
    }

    /// Follows the features under `twist` to where they are at the end of their way, which takes so
    /// many seconds, with markers of such radii there, and with places in between if it is dense.
    /// `false` if a point comes behind the camera.
    #[must_use]
    pub(crate) fn trace(
        &mut self,
        task: &Task,
        initial: &InitialState,
        (twist, seconds): (&Twist, f64),
        (ends, radii): (&[[f64; 2]], &[f64]),
        is_dense: bool,
    ) -> bool {
        // A depth hardly bends on the way: the greatest radius is that of an end.
        let begins = initial.radii(task);
        let radii = begins.iter().zip(radii).map(|(a, b)| a.max(*b));
        self.radii.iter_mut().zip(radii).for_each(|(to, r)| *to = r);
        // The end of the first step has rows of its own.
        let is_longer = task.brakes();
        let mut longest = 0.0_f64;
        let Some(ways) = ways(task, initial, (twist, seconds), ends) else {
            return false;
        };
        let boxes = self.boxes.iter_mut().zip(&self.radii);
        let points = self.is_near.iter_mut().zip(boxes);
        for ((is_near, (box_, radius)), Way { length: way, about }) in points.zip(ways) {
            *box_ = about;
            *is_near = (is_longer || way > SPACING_PX)
                && constraint::borders_near(task, *box_, NEAR_PX + radius)
                    .next()
                    .is_some();
            if *is_near {
                longest = longest.max(way);
            }
        }
        let most = if is_dense { most_stretches(task) } else { 1 };
        self.stretches = (libm::ceil(longest / SPACING_PX) as usize).clamp(1, most);
        self.count = self.stretches - usize::from(!is_longer);
        let stretches = self.stretches as f64;
        let places = self.places.chunks_exact_mut(self.room).take(self.count);
        places.enumerate().all(|(k, place)| {
            let share = (k + 1) as f64 / stretches;
            initial.passes(task, twist, (share, seconds), ends, &self.is_near, place)
        })
    }

    /// Places of the last trace.
    pub(crate) fn count(&self) -> u32 {
        self.count as u32
    }

    /// The points whose way comes near a border, where there are places.
    pub(crate) fn near(&self) -> impl Iterator<Item = usize> {
        let has_places = self.count > 0;
        let points = self.is_near.iter().enumerate();
        points.filter_map(move |(point, &is_near)| (is_near && has_places).then_some(point))
    }

    /// The violation of a point on its way, px: the sum over the borders of the greatest.
    pub(crate) fn violation(&self, task: &Task, point: usize, margin: f64) -> f64 {
        let near = self.borders(task, point, margin);
        let depth = |(_, border)| {
            let deepest = self.deepest(point, border);
            deepest.map_or(0.0, |(_, clearance)| margin - clearance.distance)
        };
        near.map(|border| depth(border).max(0.0)).sum()
    }

    /// The borders that a point's marker comes within `margin` px of on its way, with their
    /// indices.
    pub(crate) fn borders<'a>(
        &self,
        task: &'a Task,
        point: usize,
        margin: f64,
    ) -> impl Iterator<Item = (usize, Border<'a>)> {
        let box_ = self.boxes.get(point).copied().unwrap_or_default();
        let radius = self.radii.get(point).copied().unwrap_or_default();
        constraint::borders_near(task, box_, margin + radius)
    }

    /// The place at which a point's marker comes nearest to a border, as a share of its way, with
    /// the marker's clearance; `None` for one of a way that is short or comes near no border.
    pub(crate) fn deepest(&self, point: usize, border: Border<'_>) -> Option<(f64, Clearance)> {
        self.is_near.get(point).filter(|is_near| **is_near)?;
        let places = self.places.chunks_exact(self.room).take(self.count);
        let at = |(k, places): (usize, &[[f64; 3]])| {
            let share = (k + 1) as f64 / self.stretches as f64;
            let &[u, v, radius] = places.get(point)?;
            let pixel = [u, v];
            Some((share, border.clearance_of(Place { pixel, radius })))
        };
        let places = places.enumerate().filter_map(at);
        places.min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))
    }
}

/// The way of a feature.
#[derive(Clone, Copy)]
struct Way {
    /// Its length, px.
    length: f64,
    /// A box about it: least and greatest (u, v), px.
    about: [[f64; 2]; 2],
}

/// The path of each point under `twist`, by the chords of pieces in which the camera turns little;
/// `None` if a point comes behind the camera.
fn ways(
    task: &Task,
    initial: &InitialState,
    (twist, seconds): (&Twist, f64),
    ends: &[[f64; 2]],
) -> Option<heapless::Vec<Way, MAX_POINTS>> {
    let [.., x, y, z] = initial.relative(twist);
    let turn = seconds * libm::sqrt(x * x + y * y + z * z);
    let pieces = (libm::ceil(turn / TURN) as usize).clamp(1, MOST_PIECES);
    let mut from = initial.points.clone();
    let nowhere = Way {
        length: 0.0,
        about: [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]],
    };
    let mut ways: heapless::Vec<Way, MAX_POINTS> = from.iter().map(|_| nowhere).collect();
    for piece in 1..=pieces {
        let mut to = [[0.0; 3]; MAX_POINTS];
        let share = piece as f64 / pieces as f64;
        let (at, all) = ((share, seconds), [true; MAX_POINTS]);
        if piece < pieces && !initial.passes(task, twist, at, ends, &all, &mut to) {
            return None;
        }
        let places = from.iter_mut().zip(to.iter().zip(ends));
        for (way, (from, (&[u, v, _], end))) in ways.iter_mut().zip(places) {
            let to = if piece < pieces { [u, v] } else { *end };
            let chord = libm::hypot(to[0] - from[0], to[1] - from[1]);
            let bend = BEND * chord;
            let [low, high] = &mut way.about;
            for ((low, high), (a, b)) in low.iter_mut().zip(high).zip(from.iter().zip(to)) {
                *low = low.min(a.min(b) - bend);
                *high = high.max(a.max(b) + bend);
            }
            way.length += chord;
            *from = to;
        }
    }
    Some(ways)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::Model;

    #[test]
    fn a_point_far_from_borders_forgets_its_earlier_way() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
        let mut workspace = vec![0.0; Intersample::room(12, 4)];
        let mut inside = Intersample::cut(12, 4, &mut Workspace(&mut workspace)).unwrap();
        let mut mixed = 0;
        for start in &starts {
            let points = task.features_at(start).unwrap();
            let initial = InitialState::new(&task, Model::Pose, &points);
            for twist in [[0.5; 6], [0.1, -0.1, 0.3, 0.2, 0.1, 0.4]] {
                let (ends, radii) = initial.ends(&task, &twist, task.ts).unwrap();
                let (twist, ends) = ((&twist, task.ts), (ends.as_slice(), radii.as_slice()));
                assert!(inside.trace(&task, &initial, twist, ends, true));
                let near: heapless::Vec<usize, MAX_POINTS> = inside.near().collect();
                mixed += usize::from(!near.is_empty() && near.len() < points.len());
                for point in (0..points.len()).filter(|point| !near.contains(point)) {
                    for (_, border) in inside.borders(&task, point, 1e4) {
                        assert!(inside.deepest(point, border).is_none());
                    }
                }
            }
        }
        assert!(mixed > 50, "{mixed}");
    }

    #[test]
    fn the_way_of_a_long_turn_is_its_arc() {
        let task = Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap();
        let seconds = 5.0;
        let points = task.features_at(&scene::Pose {
            translation: [0.0, 0.0, 1.2],
            rotation: [0.0; 3],
        });
        let initial = InitialState::new(&task, Model::Pose, &points.unwrap());
        for turn in [0.3_f64, 1.0, 3.0, 6.2] {
            let twist = [0.0, 0.0, 0.0, 0.0, 0.0, turn / seconds];
            let (ends, _) = initial.ends(&task, &twist, seconds).unwrap();
            let radius = 100.0 * std::f64::consts::SQRT_2;
            for way in ways(&task, &initial, (&twist, seconds), &ends).unwrap() {
                assert!((way.length / (radius * turn) - 1.0).abs() < 0.03, "{turn}");
            }
            // No place on the way is outside the boxes.
            let found = ways(&task, &initial, (&twist, seconds), &ends).unwrap();
            for k in 0..=100 {
                let mut places = [[0.0; 3]; 4];
                let share = f64::from(k) / 100.0;
                let at = (share, seconds);
                assert!(initial.passes(&task, &twist, at, &ends, &[true; 4], &mut places));
                for (
                    [u, v, _],
                    Way {
                        about: [low, high], ..
                    },
                ) in places.iter().zip(&found)
                {
                    assert!(low[0] <= *u && *u <= high[0] && low[1] <= *v && *v <= high[1]);
                }
            }
        }
    }
}
