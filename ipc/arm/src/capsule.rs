//! Shapes for distances, and the nearest points of two of them.
//!
//! A capsule is all that is no farther than its radius from a segment, its axis. So its distance
//! to another body is the axis's less the radius.
//!
//! Source: C. Ericson, "Real-Time Collision Detection", 2005, sections 5.1.2 and 5.1.9 (segments).
//! The distance of a segment to a box is convex along the segment and quadratic between the places
//! where it crosses a plane of the box's faces; its derivative vanishes in one such stretch.

use nalgebra::{Rotation3, Vector3};

/// The ends of a segment, m.
pub type Segment = [Vector3<f64>; 2];

/// A capsule on a link of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// The ends of its axis, where all joints stand at zero, in the base, m. Equal ends: a sphere.
    pub ends: Segment,
    /// m.
    pub radius: f64,
    /// How many joints move it: 0 is the base's.
    pub joints: usize,
}

/// A box that does not move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cuboid {
    /// In the base, m.
    pub center: Vector3<f64>,
    /// From the box's axes to the base's.
    pub rotation: Rotation3<f64>,
    /// Half its edges, m.
    pub half: Vector3<f64>,
}

impl Cuboid {
    /// The nearest points of a segment and the box, in the base; both the same where they touch.
    pub fn nearest(&self, segment: &Segment) -> Segment {
        let [from, to] = segment.map(|end| self.rotation.inverse() * (end - self.center));
        let along = to - from;
        let on_axis = |share: f64| from + along * share;
        let inside = |x: Vector3<f64>| x.zip_map(&self.half, |x, half| x.clamp(-half, half));
        // Half the derivative of the squared distance by the share of the segment: it never falls.
        let slope = |share: f64| {
            let x = on_axis(share);
            (x - inside(x)).dot(&along)
        };
        let mut stretch = [(0.0, slope(0.0)), (1.0, slope(1.0))];
        let share = if stretch[0].1 >= 0.0 {
            0.0
        } else if stretch[1].1 <= 0.0 {
            1.0
        } else {
            for k in 0..3 {
                for face in [-self.half[k], self.half[k]] {
                    let crossing = (face - from[k]) / along[k];
                    // A segment along the face never crosses it.
                    if crossing > stretch[0].0 && crossing < stretch[1].0 {
                        let found = (crossing, slope(crossing));
                        stretch[usize::from(found.1 > 0.0)] = found;
                    }
                }
            }
            let [(least, falls), (most, rises)] = stretch;
            least - (most - least) * falls / (rises - falls)
        };
        let x = on_axis(share);
        [x, inside(x)].map(|x| self.rotation * x + self.center)
    }
}

/// The nearest points of two segments; both the same where they cross.
pub fn nearest(a: &Segment, b: &Segment) -> Segment {
    // Either one is an end, or both are inside.
    let (of_a, of_b) = (
        |end: usize| [a[end], on(b, &a[end])],
        |end: usize| [on(a, &b[end]), b[end]],
    );
    let mut best = of_a(0);
    let mut least = squared(&best);
    let mut offer = |found: Segment| {
        let distance = squared(&found);
        if distance < least {
            (best, least) = (found, distance);
        }
    };
    offer(of_a(1));
    offer(of_b(0));
    offer(of_b(1));
    let (along_a, along_b, apart) = (a[1] - a[0], b[1] - b[0], a[0] - b[0]);
    let [aa, ab, bb] = [
        along_a.norm_squared(),
        along_a.dot(&along_b),
        along_b.norm_squared(),
    ];
    let share = (ab * along_b.dot(&apart) - bb * along_a.dot(&apart)) / (aa * bb - ab * ab);
    // Of parallel ones, which have none, an end is nearest, too.
    if share > 0.0 && share < 1.0 {
        let x = a[0] + along_a * share;
        offer([x, on(b, &x)]);
    }
    best
}

/// The point of a segment that is nearest to a point.
pub fn on(segment: &Segment, point: &Vector3<f64>) -> Vector3<f64> {
    let along = segment[1] - segment[0];
    let share = along.dot(&(point - segment[0])) / along.norm_squared();
    // Of a sphere, whose ends are the same, any.
    if share > 0.0 {
        segment[0] + along * share.min(1.0)
    } else {
        segment[0]
    }
}

fn squared(pair: &Segment) -> f64 {
    (pair[0] - pair[1]).norm_squared()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn drawn(random: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| random.random_range(-1.0..1.0))
    }

    /// The least distance of the points of two segments, or of one and a box, by a search that is
    /// refined about the best of a grid.
    fn searched(distance: impl Fn(f64, f64) -> f64) -> f64 {
        let (mut at, mut reach) = ([0.5, 0.5], 0.5);
        for _ in 0..40 {
            let grid = |k: i32| reach * f64::from(k) / 8.0;
            let places = (-8..=8).flat_map(|i| (-8..=8).map(move |j| [i, j]));
            let around = |[i, j]: [i32; 2]| [at[0] + grid(i), at[1] + grid(j)];
            let places = places.map(|at| around(at).map(|share| share.clamp(0.0, 1.0)));
            let near =
                |a: &[f64; 2], b: &[f64; 2]| distance(a[0], a[1]).total_cmp(&distance(b[0], b[1]));
            at = places.min_by(near).unwrap();
            reach *= 0.6;
        }
        distance(at[0], at[1])
    }

    #[test]
    fn no_two_points_of_segments_are_nearer_than_the_nearest() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for k in 0..300 {
            let mut a = [drawn(&mut random), drawn(&mut random)];
            let mut b = [drawn(&mut random), drawn(&mut random)];
            match k % 4 {
                0 => a[1] = a[0],
                // Parallel, and nearly so.
                1 => b[1] = b[0] + (a[1] - a[0]) * 0.7,
                2 => b[1] = b[0] + (a[1] - a[0]) * 0.7 + drawn(&mut random) * 1e-7,
                _ => (),
            }
            let found = squared(&nearest(&a, &b)).sqrt();
            let at = |s: &Segment, share: f64| s[0] + (s[1] - s[0]) * share;
            let judged = searched(|i, j| (at(&a, i) - at(&b, j)).norm());
            assert!((found - judged).abs() < 1e-6, "{k}: {found}, {judged}");
            assert!((squared(&nearest(&b, &a)).sqrt() - found).abs() < 1e-12);
        }
    }

    #[test]
    fn no_point_of_a_box_is_nearer_to_a_segment_than_the_nearest() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut touching = 0;
        for k in 0..400 {
            let cuboid = Cuboid {
                center: drawn(&mut random),
                rotation: Rotation3::new(drawn(&mut random) * 3.0),
                half: drawn(&mut random).map(|x| 0.5 * x.abs()),
            };
            let mut segment = [drawn(&mut random), drawn(&mut random)];
            match k % 4 {
                0 => segment[1] = segment[0],
                // Along an edge.
                1 => segment[1] = segment[0] + cuboid.rotation * Vector3::x(),
                _ => (),
            }
            let [at, on] = cuboid.nearest(&segment);
            let found = (at - on).norm();
            let judged = searched(|share, _| {
                let x = segment[0] + (segment[1] - segment[0]) * share;
                let x = cuboid.rotation.inverse() * (x - cuboid.center);
                x.zip_map(&cuboid.half, |x, half| (x.abs() - half).max(0.0))
                    .norm()
            });
            assert!((found - judged).abs() < 1e-6, "{k}: {found}, {judged}");
            touching += usize::from(found < 1e-9);
        }
        assert!((10..200).contains(&touching), "{touching}");
    }
}
