//! When to take a view: while nothing moves, at a place that is new.

use vision_calibration_core::Iso3;

use crate::view::View;

/// Points move by less from one frame to the next, RMS, px.
const MOVED_PX: f64 = 0.4;
/// The flange stays within this, m and rad.
const RESTS: [f64; 2] = [3e-4, 1e-3];
/// So long, s.
const REST: f64 = 0.8;
/// Images that are older may show the arm before it came to rest, s.
pub const LATE: f64 = 0.5;
/// A view is new where its points are this far from those of every other, RMS, of the image's
/// width; or where they have no point in common; or where the flange is turned by so much, rad.
const NEW: f64 = 0.04;
const TURNED: f64 = 0.1;
/// Fewest points of a view that is taken.
const POINTS: usize = 8;

/// Watches frames and the arm.
#[derive(Debug)]
pub struct Still {
    width: f64,
    /// Where the flange came to rest.
    flange: Option<Iso3>,
    since: Option<f64>,
    last: Option<View>,
    taken: Vec<(View, Option<Iso3>)>,
}

impl Still {
    /// For images of this width, px.
    pub fn new(width: u32) -> Self {
        Self {
            width: f64::from(width),
            flange: None,
            since: None,
            last: None,
            taken: Vec::new(),
        }
    }

    /// The flange is there, in the base.
    pub fn arm(&mut self, flange: &Iso3) {
        let rests = self.flange.is_some_and(|known| {
            let off = known.inverse() * flange;
            off.translation.vector.norm() < RESTS[0] && off.rotation.angle() < RESTS[1]
        });
        if !rests {
            (self.flange, self.since) = (Some(*flange), None);
        }
    }

    /// A frame came: whether to take it. `time` is the present, s.
    pub fn take(&mut self, time: f64, view: &View) -> bool {
        let moved = self.last.as_ref().and_then(|last| distance(last, view));
        self.last = Some(view.clone());
        if moved.is_none_or(|moved| moved > MOVED_PX) || view.points.len() < POINTS {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(time);
        let is_new = |(known, flange): &(View, Option<Iso3>)| {
            let ends = flange.as_ref().zip(self.flange.as_ref());
            let turned = ends.is_some_and(|(a, b)| a.rotation.angle_to(&b.rotation) > TURNED);
            turned || distance(known, view).is_none_or(|off| off > NEW * self.width)
        };
        let take = time - since >= REST && self.taken.iter().all(is_new);
        if take {
            self.taken.push((view.clone(), self.flange));
        }
        take
    }

    /// An image is too old.
    pub fn miss(&mut self) {
        self.since = None;
    }

    /// How many were taken.
    pub fn count(&self) -> usize {
        self.taken.len()
    }
}

/// How far common points are apart, RMS, px; `None` without common points.
fn distance(a: &View, b: &View) -> Option<f64> {
    let common = a.points.iter().filter_map(|(number, p)| {
        let q = b.points.get(number)?;
        Some((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2))
    });
    let (sum, count) = common.fold((0.0, 0), |(sum, count), square| (sum + square, count + 1));
    (count > 0).then(|| (sum / f64::from(count)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::Tag;

    fn at(u: f64) -> View {
        let tag = |number: u32| Tag {
            number,
            corners: [[u, 10.0], [u + 20.0, 10.0], [u + 20.0, 30.0], [u, 30.0]],
        };
        View::of_tags("", &[0, 1].map(tag))
    }

    /// Frames from a time on, 0.1 s apart: when one is taken.
    fn watch(still: &mut Still, from: f64, frames: u32, place: impl Fn(u32) -> f64) -> Vec<u32> {
        let take = |k: &u32| still.take(from + 0.1 * f64::from(*k), &at(place(*k)));
        (0..frames).filter(take).collect()
    }

    #[test]
    fn a_view_is_taken_once_and_only_where_it_is_new() {
        let mut still = Still::new(640);
        assert!(watch(&mut still, 0.0, 20, |k| 10.0 * f64::from(k)).is_empty());
        assert_eq!(watch(&mut still, 2.0, 20, |_| 190.2), [9]);
        // Not again here, nor close by.
        assert!(watch(&mut still, 4.0, 20, |_| 205.0).is_empty());
        assert_eq!(watch(&mut still, 6.0, 20, |_| 300.0), [9]);
        assert_eq!(still.count(), 2);
    }

    #[test]
    fn after_an_old_image_the_wait_begins_anew() {
        let mut still = Still::new(640);
        assert!(watch(&mut still, 0.0, 8, |_| 10.0).is_empty());
        still.miss();
        assert_eq!(watch(&mut still, 0.8, 20, |_| 10.0), [8]);
    }

    #[test]
    fn an_arm_that_creeps_is_waited_for() {
        let mut still = Still::new(640);
        let mut place = 0.0;
        for k in 0..30 {
            place += 1e-4;
            still.arm(&Iso3::translation(place, 0.0, 0.0));
            assert!(!still.take(0.1 * f64::from(k), &at(10.0)));
        }
        still.arm(&Iso3::translation(place + 1e-5, 0.0, 0.0));
        assert_eq!(watch(&mut still, 3.0, 20, |_| 10.0).len(), 1);
        // A small board hardly changes in the image where the arm is turned.
        let turn = Iso3::rotation(vision_calibration_core::Vec3::new(0.2, 0.0, 0.0));
        still.arm(&turn);
        assert_eq!(watch(&mut still, 5.0, 20, |_| 12.0).len(), 1);
    }
}
