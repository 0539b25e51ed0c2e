//! Which disc is which marker, from the arrangement of the pattern alone.
//!
//! Discs look alike. An assignment is possible if it turns the pattern by less than `turn_max`
//! against the reference, does not mirror it, and does not squeeze it more than a tilted view
//! could. It is used only if it is the only possible one.

use scene::MAX_POINTS;

use crate::homography::{Homography, Point, distance, mean};
use crate::search::Discs;

/// Least ratio of an affine view's singular values: the cosine of the greatest tilt, 41 deg.
const SQUEEZE: f64 = 0.75;
/// Same, where identity is known by continuity and only has to be confirmed.
pub(crate) const SQUEEZE_TRACKED: f64 = 0.6;
/// Points are where an affine view through three others says to this share of the pattern's size.
const NEAR: f64 = 0.2;

/// The disc of each marker, if any.
pub(crate) type Assignment = [Option<usize>; MAX_POINTS];

/// The turn of an affine view, rad, and the ratio of its singular values; none if it mirrors.
pub(crate) fn view(map: &Homography) -> Option<(f64, f64)> {
    let [a, b, c, d] = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|at| map.0[at]);
    let determinant = a * d - b * c;
    if determinant <= 0.0 {
        return None;
    }
    let turn = (c - b).atan2(a + d);
    let sum = (a + d).hypot(c - b);
    let difference = (a - d).hypot(b + c);
    Some((turn, (sum - difference) / (sum + difference)))
}

/// The difference of two turns, 0 to pi rad.
pub(crate) fn turn_between(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(std::f64::consts::TAU);
    turn.min(std::f64::consts::TAU - turn)
}

/// The only possible assignment of discs to the points of a pattern, from three discs on; none
/// where there is none or more than one. `reference` is the turn to measure from, rad.
pub(crate) fn assign(
    discs: &Discs,
    pattern: &[Point],
    reference: f64,
    turn_max: f64,
) -> Option<Assignment> {
    let mut best: Option<Assignment> = None;
    let (mut best_count, mut unique) = (2, true);
    let n = discs.len();
    for three in triples(pattern.len(), false) {
        for discs_of in triples(n, true) {
            let pairs = [0, 1, 2].map(|k| (pattern[three[k]], discs[discs_of[k]].center));
            let Some(map) = Homography::affine(&pairs) else {
                continue;
            };
            let possible = view(&map).is_some_and(|(turn, squeeze)| {
                squeeze > SQUEEZE && turn_between(turn, reference) < turn_max
            });
            if !possible {
                continue;
            }
            let assignment = complete(discs, pattern, &map, three, discs_of);
            let count = assignment.iter().flatten().count();
            if count > best_count {
                (best, best_count, unique) = (Some(assignment), count, true);
            } else if count == best_count && best != Some(assignment) {
                unique = false;
            }
        }
    }
    best.filter(|_| unique)
}

/// Adds to three assigned discs those that lie where their view says.
fn complete(
    discs: &Discs,
    pattern: &[Point],
    map: &Homography,
    three: [usize; 3],
    discs_of: [usize; 3],
) -> Assignment {
    let mut assignment: Assignment = [None; MAX_POINTS];
    for k in 0..3 {
        assignment[three[k]] = Some(discs_of[k]);
    }
    let images = || pattern.iter().filter_map(|point| map.apply(*point));
    let center = mean(images());
    let size = images().map(|x| distance(x, center)).fold(0.0, f64::max);
    for (i, point) in pattern.iter().enumerate() {
        let Some(image) = map.apply(*point) else {
            continue;
        };
        if assignment[i].is_some() {
            continue;
        }
        let free = (0..discs.len()).filter(|k| !assignment.contains(&Some(*k)));
        assignment[i] = free
            .map(|k| (k, distance(discs[k].center, image)))
            .filter(|(_, off)| *off < NEAR * size)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(k, _)| k);
    }
    assignment
}

/// Three different numbers below `n`, in every order or only ascending.
fn triples(n: usize, every_order: bool) -> impl Iterator<Item = [usize; 3]> {
    (0..n * n * n)
        .map(move |k| [k / (n * n), k / n % n, k % n])
        .filter(move |[a, b, c]| {
            if every_order {
                a != b && b != c && a != c
            } else {
                a < b && b < c
            }
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disc::Disc;
    use scene::{Pose, Scene};

    const PATTERN: [Point; 4] = [
        [-0.06, -0.045],
        [0.06, -0.045],
        [0.06, 0.045],
        [-0.06, 0.045],
    ];

    /// Discs where a tilted and turned pattern is seen, in the given order.
    fn discs(order: &[usize], pattern: &[Point], roll: f64) -> Discs {
        let camera = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap().camera;
        let pose = Pose {
            translation: [0.01, 0.02, 0.4],
            rotation: [0.2, -0.15, roll],
        };
        let map = Homography::of_pose(&camera, &pose);
        let disc = |&i: &usize| Disc {
            center: map.apply(pattern[i]).unwrap(),
            radius: 10.0,
            levels: [200.0, 90.0],
        };
        order.iter().map(disc).collect()
    }

    #[test]
    fn four_or_three_discs_of_the_rectangle_are_told_apart() {
        for roll in [-1.0, -0.6, 0.0, 0.6, 1.0] {
            let all = assign(&discs(&[2, 0, 3, 1], &PATTERN, roll), &PATTERN, 0.0, 1.4).unwrap();
            assert_eq!(all[..4], [Some(1), Some(3), Some(0), Some(2)]);
            let three = assign(&discs(&[3, 1, 0], &PATTERN, roll), &PATTERN, 0.0, 1.4).unwrap();
            assert_eq!(three[..4], [Some(2), Some(1), None, Some(0)]);
        }
    }

    #[test]
    fn two_discs_could_be_any() {
        assert_eq!(
            assign(&discs(&[0, 1], &PATTERN, 0.0), &PATTERN, 0.0, 1.4),
            None
        );
    }

    #[test]
    fn upside_down_cannot_be_told_where_any_turn_is_allowed() {
        let all = discs(&[0, 1, 2, 3], &PATTERN, 0.3);
        assert!(assign(&all, &PATTERN, 0.0, 1.4).is_some());
        assert_eq!(assign(&all, &PATTERN, 0.0, 3.2), None);
    }

    #[test]
    fn a_square_is_told_only_within_an_eighth_of_a_turn() {
        let square = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]];
        let all = discs(&[0, 1, 2, 3], &square, 0.5);
        assert_eq!(assign(&all, &square, 0.0, 1.4), None);
        let upright = assign(&all, &square, 0.0, 0.75).unwrap();
        assert_eq!(upright[..4], [Some(0), Some(1), Some(2), Some(3)]);
    }

    #[test]
    fn a_disc_that_belongs_to_nothing_is_left_out() {
        let mut all = discs(&[0, 1, 2, 3], &PATTERN, 0.3);
        let mut other = all[0];
        other.center = [50.0, 400.0];
        all.push(other).unwrap();
        let found = assign(&all, &PATTERN, 0.0, 1.4).unwrap();
        assert_eq!(found[..4], [Some(0), Some(1), Some(2), Some(3)]);
    }
}
