//! Links that keep off each other, boxes and walls: the distances of their capsules, and what of
//! them a damper needs.
//!
//! Of two convex bodies, the plane that is perpendicular to the way between their nearest points
//! and touches the one has it wholly behind. So the other one keeps off it while both ends of its
//! axis keep off that plane, which moves with the one: two rows for a pair. A single row, of the
//! nearest point, would let two parallel bodies sink into each other, first at one end, then at the
//! other.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | n | `Gap::normal` | unit vector from the one body to the other |
//! | p | `Gap::point` | the nearest point of the one |
//! | h = n (x - p) - r | `Row::left` | what is left to an end x of the other's axis; r: radii, gap |
//! | dh/dq | `Row::gradient` | n times the velocity of x as seen from the one |
//!
//! The distance itself has the derivative of the point that is nearest: a mean of those of the two
//! ends.
//!
//! Source: B. Faverjon and P. Tournassoud, as [`crate::damper`].

use nalgebra::{RowSVector, Vector3};

use crate::capsule::{Capsule, Segment, nearest};
use crate::description::{Arm, MAX_CAPSULES, Other, Pair, Shapes, Wall};
use crate::kinematics::{JOINTS, Jacobian, Joints, Pose};

/// Pairs that bound a motion at once: the nearest.
pub const NEAREST: usize = 8;
/// Most rows of these.
pub const MAX_ROWS: usize = 2 * NEAREST;

/// A pair that has more left than this bounds no motion, m: an arm that keeps to a quarter of its
/// joints' speeds hardly uses it up in a step of the law's window.
const REACH: f64 = 0.25;

/// What is left to one end of a capsule's axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Row {
    pub pair: Pair,
    /// h, m; negative where it is too near.
    pub left: f64,
    /// dh/dq, m/rad; of a joint that slides, 1.
    pub gradient: RowSVector<f64, JOINTS>,
}

/// A pair's distance, and the plane between its bodies.
#[derive(Clone, Copy)]
struct Gap {
    pair: Pair,
    /// Between the surfaces, m; negative of bodies that overlap, down to where their axes do.
    distance: f64,
    normal: Vector3<f64>,
    point: Vector3<f64>,
    /// The two radii, m.
    radii: f64,
    /// Joints that move the other body.
    before: usize,
}

impl Arm {
    /// The distances of its pairs at `q`, m; negative of bodies that overlap. Those whose axes
    /// cross, or whose axis touches the box, have no less than minus their radii.
    pub fn distances(&self, q: &Joints) -> impl Iterator<Item = (Pair, f64)> {
        let axes = self.shapes.axes(&self.chain.moved_links(q));
        let gap = move |pair: &Pair| self.shapes.gap(*pair, &axes, &self.walls);
        let gaps = self.shapes.pairs.iter().filter_map(gap);
        gaps.map(|gap| (gap.pair, gap.distance))
    }

    /// The rows of the nearest pairs at `q`, where the camera and its Jacobian are these.
    pub(crate) fn rows_of_pairs(
        &self,
        q: &Joints,
        camera: &Pose,
        jacobian: &Jacobian,
    ) -> heapless::Vec<Row, MAX_ROWS> {
        let (mut rows, shapes) = (heapless::Vec::new(), &self.shapes);
        if shapes.pairs.is_empty() {
            return rows;
        }
        let axes = shapes.axes(&self.chain.moved_links(q));
        for gap in &shapes.nearest(&axes, &self.walls) {
            let shape = usize::from(gap.pair.shape);
            let (Some(axis), Some(capsule)) = (axes.get(shape), shapes.capsules.get(shape)) else {
                continue;
            };
            let ends = if axis[0] == axis[1] { 1 } else { 2 };
            for end in &axis[..ends] {
                let left = gap.normal.dot(&(end - gap.point)) - gap.radii - shapes.clearance;
                if left > REACH {
                    continue;
                }
                let from_camera = end - camera.translation.vector;
                let mut gradient = RowSVector::zeros();
                for joint in gap.before..capsule.joints {
                    let part = |from| Vector3::from(jacobian.fixed_view::<3, 1>(from, joint));
                    let velocity = part(0) + part(3).cross(&from_camera);
                    gradient[joint] = gap.normal.dot(&velocity);
                }
                let row = Row {
                    pair: gap.pair,
                    left,
                    gradient,
                };
                let has_room = rows.push(row).is_ok();
                debug_assert!(has_room, "more than {MAX_ROWS} rows");
            }
        }
        rows
    }
}

impl Shapes {
    /// The axes of the capsules on these links.
    fn axes(&self, moved: &[Pose; JOINTS + 1]) -> heapless::Vec<Segment, MAX_CAPSULES> {
        let axis = |capsule: &Capsule| {
            let link = moved[capsule.joints.min(JOINTS)];
            let place = |end: Vector3<f64>| link.rotation * end + link.translation.vector;
            capsule.ends.map(place)
        };
        self.capsules.iter().map(axis).collect()
    }

    /// The nearest pairs, nearest first, of those within reach.
    fn nearest(&self, axes: &[Segment], walls: &[Wall]) -> heapless::Vec<Gap, NEAREST> {
        let mut nearest: heapless::Vec<Gap, NEAREST> = heapless::Vec::new();
        for pair in &self.pairs {
            if self.is_far(*pair, axes) {
                continue;
            }
            let Some(gap) = self.gap(*pair, axes, walls) else {
                continue;
            };
            let is_near = gap.distance <= self.clearance + REACH;
            let place = nearest.iter().position(|at| gap.distance < at.distance);
            let place = place.unwrap_or(nearest.len());
            if is_near && place < NEAREST {
                nearest.truncate(NEAREST - 1);
                let has_room = nearest.insert(place, gap).is_ok();
                debug_assert!(has_room, "more than {NEAREST} pairs");
            }
        }
        nearest
    }

    /// Whether two links are out of reach, by spheres about them.
    fn is_far(&self, pair: Pair, axes: &[Segment]) -> bool {
        let Other::Link(other) = pair.other else {
            return false;
        };
        let sphere = |index: u8| {
            let index = usize::from(index);
            let (axis, capsule) = (axes.get(index)?, self.capsules.get(index)?);
            let half = (capsule.ends[1] - capsule.ends[0]) / 2.0;
            Some(((axis[0] + axis[1]) / 2.0, half.norm() + capsule.radius))
        };
        let (Some(a), Some(b)) = (sphere(pair.shape), sphere(other)) else {
            return true;
        };
        let most = a.1 + b.1 + self.clearance + REACH;
        (a.0 - b.0).norm_squared() > most * most
    }

    /// A pair's distance, if there are such bodies.
    fn gap(&self, pair: Pair, axes: &[Segment], walls: &[Wall]) -> Option<Gap> {
        let (axis, capsule) = (
            axes.get(usize::from(pair.shape))?,
            self.capsules.get(usize::from(pair.shape))?,
        );
        let between = |[at, point]: [Vector3<f64>; 2], radii: f64, before: usize| {
            let (way, least) = (at - point, 1e-12);
            let apart = way.norm();
            // Where they touch, no direction leads apart.
            let normal = if apart > least {
                way / apart
            } else {
                way * 0.0
            };
            Gap {
                pair,
                distance: apart - radii,
                normal,
                point,
                radii,
                before,
            }
        };
        Some(match pair.other {
            Other::Link(other) => {
                let other = usize::from(other);
                let (other_axis, other) = (axes.get(other)?, self.capsules.get(other)?);
                let radii = capsule.radius + other.radius;
                between(nearest(axis, other_axis), radii, other.joints)
            }
            Other::Box(index) => {
                let cuboid = self.boxes.get(usize::from(index))?;
                between(cuboid.nearest(axis), capsule.radius, 0)
            }
            Other::Wall(index) => {
                let wall = walls.get(usize::from(index))?;
                let apart = wall.distance(&axis[0]).min(wall.distance(&axis[1]));
                let normal = Vector3::from(wall.normal);
                Gap {
                    pair,
                    distance: apart - capsule.radius,
                    normal,
                    point: normal * wall.offset,
                    radii: capsule.radius,
                    before: 0,
                }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Translation3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::capsule::Cuboid;
    use crate::damper::{Bound, Cause, Dampers};
    use crate::limits::Model;
    use crate::{Chain, READY};

    const CLEARANCE: f64 = 0.02;

    /// A Panda with shapes for its base, forearm and hand, a box before it, and a table.
    fn arm() -> Arm {
        let camera = Pose::from_parts(
            Translation3::new(0.05, -0.05, 0.04),
            Rotation3::new(Vector3::z() * 0.8),
        );
        // Straight up at zero, as the chain: the wrist 8.8 cm before the base.
        let capsule = |from: [f64; 3], to: [f64; 3], radius, joints| Capsule {
            ends: [from.into(), to.into()],
            radius,
            joints,
        };
        let capsules = [
            capsule([0.0, 0.0, 0.05], [0.0, 0.0, 0.05], 0.1, 0),
            capsule([0.0, 0.0, 0.333], [0.0, 0.0, 0.6], 0.07, 2),
            capsule([0.0, 0.0, 0.75], [0.0, 0.06, 1.0], 0.07, 5),
            capsule([0.088, -0.08, 0.9], [0.088, 0.08, 0.9], 0.05, 7),
        ];
        let cuboid = Cuboid {
            center: Vector3::new(0.55, 0.1, 0.15),
            rotation: Rotation3::new(Vector3::new(0.1, 0.2, 0.3)),
            half: Vector3::new(0.1, 0.3, 0.1),
        };
        let wall = Wall {
            normal: [0.0, 0.0, 1.0],
            offset: 0.0,
        };
        let pair = |shape, other| Pair { shape, other };
        let pairs = [
            pair(2, Other::Link(0)),
            pair(3, Other::Link(0)),
            pair(2, Other::Link(1)),
            pair(3, Other::Link(1)),
            pair(2, Other::Box(0)),
            pair(3, Other::Box(0)),
            pair(2, Other::Wall(0)),
            pair(3, Other::Wall(0)),
        ];
        Arm {
            chain: Chain::FRANKA.with_ee(camera),
            shaped: Chain::FRANKA,
            limits: *Model::Panda.limits(),
            margin: 0.2,
            speed: 0.25,
            strain: 0.6,
            is_elbow_free: true,
            walls: [wall].into_iter().collect(),
            points: Default::default(),
            shapes: Shapes {
                capsules: capsules.into_iter().collect(),
                boxes: [cuboid].into_iter().collect(),
                pairs: pairs.into_iter().collect(),
                clearance: CLEARANCE,
            },
        }
    }

    fn posture(random: &mut ChaCha8Rng, arm: &Arm) -> Joints {
        Joints::from_fn(|k, _| {
            let [least, most] = arm.limits.0[k].range;
            random.random_range(least + arm.margin..most - arm.margin)
        })
    }

    fn least(arm: &Arm, q: &Joints) -> f64 {
        let each = arm.distances(q).map(|(_, distance)| distance);
        each.fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn links_move_as_the_flange_does() {
        let (chain, q) = (Chain::FRANKA, Joints::from(READY));
        let moved = chain.moved_links(&q);
        let flange = moved[JOINTS] * chain.flange(&Joints::zeros());
        assert!((flange.to_homogeneous() - chain.flange(&q).to_homogeneous()).amax() < 1e-12);
        // A joint moves no link before it.
        for joint in 0..JOINTS {
            let mut other = q;
            other[joint] += 0.3;
            let all = chain.moved_links(&other);
            for (k, (now, before)) in all.iter().zip(&moved).enumerate() {
                assert_eq!(now != before, k > joint, "{joint}, {k}");
            }
        }
    }

    #[test]
    fn distances_have_the_derivatives_that_differences_have() {
        let (all, mut random) = (arm(), ChaCha8Rng::seed_from_u64(1));
        let mut seen = [0; 8];
        for _ in 0..2000 {
            let q = posture(&mut random, &all);
            let (camera, jacobian) = all.chain.at(&q);
            for (i, pair) in all.shapes.pairs.iter().enumerate() {
                let mut arm = all.clone();
                arm.shapes.pairs = [*pair].into_iter().collect();
                let rows = arm.rows_of_pairs(&q, &camera, &jacobian);
                let axes = arm.shapes.axes(&arm.chain.moved_links(&q));
                let gap = arm.shapes.gap(*pair, &axes, &arm.walls).unwrap();
                let [first, second] = rows.as_slice() else {
                    continue;
                };
                if gap.normal.norm() == 0.0 {
                    continue;
                }
                // Of the nearest point: it is so far along the axis.
                let axis = &axes[usize::from(pair.shape)];
                let share = match pair.other {
                    Other::Wall(_) => f64::from(second.left < first.left),
                    _ => {
                        let at = gap.point + gap.normal * (gap.distance + gap.radii);
                        (at - axis[0]).norm() / (axis[1] - axis[0]).norm()
                    }
                };
                let left = first.left * (1.0 - share) + second.left * share;
                assert!((left - (gap.distance - CLEARANCE)).abs() < 1e-9);
                let exact = first.gradient * (1.0 - share) + second.gradient * share;
                for joint in 0..JOINTS {
                    let mut step = Joints::zeros();
                    step[joint] = 1e-6;
                    let change = least(&arm, &(q + step)) - least(&arm, &(q - step));
                    let apart = exact[joint] - change / 2e-6;
                    assert!(apart.abs() < 1e-4, "{pair:?} {joint}: {apart}");
                }
                seen[i] += 1;
            }
        }
        assert!(seen.iter().all(|count| *count > 20), "{seen:?}");
    }

    #[test]
    fn only_the_nearest_pairs_have_rows() {
        let (mut arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(2));
        // The table lies under everything, so that more pairs are near than count.
        let (walls, boxes) = ([3, 2].map(|shape| (shape, Other::Wall(0))), [Other::Box(0)]);
        let more = walls.into_iter().chain(boxes.map(|other| (3, other)));
        let more: heapless::Vec<Pair, 3> =
            more.map(|(shape, other)| Pair { shape, other }).collect();
        arm.shapes.pairs.extend(more);
        let mut most = 0;
        for _ in 0..2000 {
            let q = posture(&mut random, &arm);
            let (camera, jacobian) = arm.chain.at(&q);
            let rows = arm.rows_of_pairs(&q, &camera, &jacobian);
            let mut all: Vec<f64> = arm.distances(&q).map(|(_, distance)| distance).collect();
            all.sort_by(f64::total_cmp);
            let farthest = all[NEAREST - 1].max(all[0]);
            most = most.max(rows.len());
            for pair in rows.iter().map(|row| row.pair) {
                let distance = arm.distances(&q).find(|(of, _)| *of == pair).unwrap().1;
                assert!(distance <= farthest && distance <= CLEARANCE + REACH);
            }
            let near = all.iter().take(NEAREST);
            let near = near
                .filter(|distance| **distance <= CLEARANCE + REACH)
                .count();
            assert!(
                (near..=2 * near).contains(&rows.len()),
                "{near}, {}",
                rows.len()
            );
        }
        assert!(most > 10, "{most}");
    }

    #[test]
    fn a_motion_within_all_bounds_keeps_every_pair_apart() {
        let (arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(3));
        let period = 1.0 / 30.0;
        let (mut nearest, mut bound) = (f64::INFINITY, [0; 3]);
        for _ in 0..150 {
            let mut q = loop {
                let q = posture(&mut random, &arm);
                if least(&arm, &q) > CLEARANCE {
                    break q;
                }
            };
            let wanted: [f64; 6] = core::array::from_fn(|k| {
                random.random_range(-1.0..1.0) * if k < 3 { 0.3 } else { 1.0 }
            });
            for _ in 0..200 {
                let dampers = Dampers::at(&arm, &q, &[f64::INFINITY; 6], period);
                let share = dampers.share(&wanted);
                for Bound { most, cause, .. } in &dampers.bounds {
                    if let (Cause::Near(pair), true) = (cause, *most < 1e-3) {
                        bound[match pair.other {
                            Other::Link(_) => 0,
                            Other::Box(_) => 1,
                            Other::Wall(_) => 2,
                        }] += 1;
                    }
                }
                q = arm.moved(
                    &q,
                    &wanted.map(|v| share * v),
                    dampers.elbow(&wanted),
                    period,
                );
                nearest = nearest.min(least(&arm, &q));
            }
        }
        assert!(nearest > 0.95 * CLEARANCE, "{nearest}");
        // The bounds were needed.
        assert!(bound.iter().all(|count| *count > 50), "{bound:?}");
    }
}
