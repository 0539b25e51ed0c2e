//! The gate: refuses features that cannot be those of the pattern.
//!
//! A detector may confuse points or take another spot for one. Such features are finite, inside the
//! image and new, but the law would steer in a wrong direction.

use heapless::Vec;

use crate::measurement::{Measurement, Refusal};
use crate::task::Task;
use crate::{MAX_POINTS, Points, constraint};

/// Least height of a triangle of points that noise does not turn over, px.
const LEAST_HEIGHT_PX: f64 = 4.0;
/// Points nearer to each other than this coincide, and points nearer to a line than this lie on it,
/// px.
const LEAST_PX: f64 = 0.5;
/// A point counts as another one if that one's expected place is this many times nearer.
const NEARER: f64 = 2.0;
/// A point leaps if it lies this share of the image's larger side from where it is expected, plus
/// [`LEAP_RATIO`] times as far as the nearer half of the points: no camera moves one point within a
/// frame and not the rest. 40 px of 1024 are twice what the velocity limits allow.
const LEAP: f64 = 0.04;
const LEAP_RATIO: f64 = 4.0;
/// Sampling times after the last measurement in which a leap is refused; then the point is
/// believed.
pub const LEAP_PERIODS: f64 = 3.5;

/// Lets a measurement pass that has the pattern's count of finite points, none further outside the
/// image than `tolerance` px, none in one place, not all on a line, and in the pattern's sense of
/// rotation.
///
/// # Errors
/// [`Refusal`] names the first point that is wrong.
pub fn pass<'a>(
    task: &Task,
    measurement: &'a Measurement,
    tolerance: f64,
) -> Result<&'a Points, Refusal> {
    let points = &measurement.points;
    if points.len() != task.goal.len() {
        return Err(Refusal::Count {
            found: points.len(),
            expected: task.goal.len(),
        });
    }
    for (point, &pixel) in points.iter().enumerate() {
        if !pixel.iter().all(|x| x.is_finite()) {
            return Err(Refusal::NotFinite { point });
        }
        if constraint::border_clearance(task, pixel) < -tolerance {
            return Err(Refusal::OffImage { point, pixel });
        }
    }
    check_shape(task, points)?;
    check_sense(task, points)?;
    Ok(points)
}

/// Refuses points that turn the other way than in the pattern: it is plane and seen from its front,
/// from where any three of its points keep their sense of rotation.
///
/// # Errors
/// [`Refusal::Mixed`] names two points of such a triangle.
pub fn check_sense(task: &Task, points: &Points) -> Result<(), Refusal> {
    let turns = |&(_, [seen, goal]): &([usize; 2], [f64; 2])| {
        seen * goal < 0.0 && seen.abs().min(goal.abs()) > LEAST_HEIGHT_PX
    };
    match triangles(task, points).find(turns) {
        Some((points, _)) => Err(Refusal::Mixed { points }),
        None => Ok(()),
    }
}

/// Whether the pattern is clearly seen from its front: no three of its points are nearly on a line
/// that are not in the pattern. Beyond such a view [`check_sense`] refuses the features.
pub fn is_from_front(task: &Task, points: &Points) -> bool {
    triangles(task, points).all(|(_, [seen, goal])| {
        goal.abs() < LEAST_HEIGHT_PX || seen * goal.signum() > LEAST_HEIGHT_PX
    })
}

/// Refuses two points in one place, and points all on a line: those of a detector that found
/// nothing, not of any view of the pattern.
///
/// # Errors
/// [`Refusal::Coincident`] names two points, [`Refusal::Flat`] what is left of the pattern's
/// height.
pub fn check_shape(task: &Task, points: &Points) -> Result<(), Refusal> {
    let pairs = || points.iter().zip(&task.goal).enumerate();
    for (k, c) in pairs() {
        for (j, b) in pairs().take(k) {
            if distance(*b.0, *c.0) < LEAST_PX && distance(*b.1, *c.1) > LEAST_HEIGHT_PX {
                return Err(Refusal::Coincident { points: [j, k] });
            }
        }
    }
    let greatest = |most: [f64; 2], (_, [seen, goal]): (_, [f64; 2])| {
        [most[0].max(seen.abs()), most[1].max(goal.abs())]
    };
    let [seen_px, goal_px] = triangles(task, points).fold([0.0; 2], greatest);
    match seen_px < LEAST_PX && goal_px > LEAST_HEIGHT_PX {
        true => Err(Refusal::Flat { height_px: seen_px }),
        false => Ok(()),
    }
}

/// The triangles of any three points: the indices of two, and the heights as seen and in the
/// pattern at the goal, px.
fn triangles(task: &Task, points: &Points) -> impl Iterator<Item = ([usize; 2], [f64; 2])> {
    let pairs = move || points.iter().zip(&task.goal).enumerate();
    pairs().flat_map(move |(k, c)| {
        pairs().take(k).flat_map(move |(j, b)| {
            pairs().take(j).map(move |(_, a)| {
                let heights = [height(*a.0, *b.0, *c.0), height(*a.1, *b.1, *c.1)];
                ([j, k], heights)
            })
        })
    })
}

fn distance(p: [f64; 2], q: [f64; 2]) -> f64 {
    libm::hypot(q[0] - p[0], q[1] - p[1])
}

/// Height of a triangle over its longest side, px, negative where it turns the other way round.
fn height(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let longest = distance(a, b).max(distance(b, c)).max(distance(c, a));
    let double_area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    // Three points in one place have no sense.
    if longest > 0.0 {
        double_area / longest
    } else {
        0.0
    }
}

/// Refuses points of which two or more lie where others are expected: they changed their names.
///
/// # Errors
/// [`Refusal::Mixed`] names a point and the one that it seems to be.
pub fn check_names(points: &Points, expected: &Points) -> Result<(), Refusal> {
    let mut strangers =
        points
            .iter()
            .zip(expected)
            .enumerate()
            .filter_map(|(point, (&seen, &own))| {
                let is_nearer =
                    |&other: &[f64; 2]| NEARER * distance(seen, other) < distance(seen, own);
                expected
                    .iter()
                    .position(is_nearer)
                    .map(|other| [point, other])
            });
    match (strangers.next(), strangers.next()) {
        (Some(points), Some(_)) => Err(Refusal::Mixed { points }),
        _ => Ok(()),
    }
}

/// Refuses points of which up to a half lie far from where they are expected while the rest does
/// not: another spot was taken for a point. A camera that is pushed moves all of them.
///
/// # Errors
/// [`Refusal::Leap`] names the point that is furthest away.
pub fn check_leaps(task: &Task, points: &Points, expected: &Points) -> Result<(), Refusal> {
    let away = sorted_distances(points, expected);
    let least_px = least_leap_px(task);
    match (away.get(away.len().saturating_sub(1) / 2), away.last()) {
        (Some(&(_, usual_px)), Some(&(point, by_px)))
            if by_px > least_px + LEAP_RATIO * usual_px =>
        {
            Err(Refusal::Leap { point, by_px })
        }
        _ => Ok(()),
    }
}

/// Refuses points of which more than half lie further than `most_px` and the margin from where they
/// are expected: another object, or a view from elsewhere.
///
/// # Errors
/// [`Refusal::Elsewhere`] says how far away they are.
pub fn check_place(
    task: &Task,
    points: &Points,
    expected: &Points,
    most_px: f64,
) -> Result<(), Refusal> {
    let most_px = most_px + least_leap_px(task);
    match usual_px(points, expected) {
        by_px if by_px > most_px => Err(Refusal::Elsewhere { by_px, most_px }),
        _ => Ok(()),
    }
}

/// Whether more than half of the points lie further than `most_px` and half of the margin of
/// [`check_place`] from where they are expected: camera or object was pushed.
pub fn is_push(task: &Task, points: &Points, expected: &Points, most_px: f64) -> bool {
    usual_px(points, expected) > most_px + 0.5 * least_leap_px(task)
}

/// Within what distance of where they are expected the nearer half of the points lie, px.
fn usual_px(points: &Points, expected: &Points) -> f64 {
    let away = sorted_distances(points, expected);
    let usual = away.get(points.len().saturating_sub(1) / 2);
    debug_assert!(usual.is_some(), "fewer points expected than seen");
    usual.map_or(0.0, |(_, by_px)| *by_px)
}

/// The points by their distance from where they are expected, px, the nearest first.
fn sorted_distances(points: &Points, expected: &Points) -> Vec<(usize, f64), MAX_POINTS> {
    let pairs = points.iter().zip(expected);
    let mut away: Vec<(usize, f64), MAX_POINTS> = pairs
        .map(|(&seen, &expected)| distance(seen, expected))
        .enumerate()
        .collect();
    away.sort_unstable_by(|a, b| a.1.total_cmp(&b.1));
    away
}

/// Distance below which no point leaps, px.
pub fn least_leap_px(task: &Task) -> f64 {
    LEAP * task.camera.width.max(task.camera.height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    /// The points under each other's names.
    fn renamed(points: &Points, order: [usize; 4]) -> Points {
        order.iter().map(|&i| points[i]).collect()
    }

    fn shifted(points: &Points, by: [f64; 2]) -> Points {
        points
            .iter()
            .map(|p| [p[0] + by[0], p[1] + by[1]])
            .collect()
    }

    #[test]
    fn two_points_in_each_others_place_turn_the_pattern_over() {
        let task = task();
        assert_eq!(check_sense(&task, &task.goal), Ok(()));
        for order in [[1, 0, 2, 3], [0, 2, 1, 3], [2, 1, 0, 3], [3, 2, 1, 0]] {
            let refusal = check_sense(&task, &renamed(&task.goal, order));
            assert!(matches!(refusal, Err(Refusal::Mixed { .. })), "{order:?}");
        }
        // A view from elsewhere may be turned like this.
        assert_eq!(
            check_sense(&task, &renamed(&task.goal, [1, 2, 3, 0])),
            Ok(())
        );
    }

    #[test]
    fn from_every_start_the_pattern_keeps_its_sense() {
        let task = task();
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
        for start in &starts {
            let points = task.features_at(start).unwrap();
            assert_eq!(check_sense(&task, &points), Ok(()));
        }
    }

    #[test]
    fn a_view_from_the_side_is_not_clearly_from_the_front() {
        let task = task();
        assert!(is_from_front(&task, &task.goal));
        let squeezed = |share: f64| {
            let points = task.goal.iter();
            points
                .map(|p| [p[0], 512.0 + share * (p[1] - 512.0)])
                .collect()
        };
        assert!(is_from_front(&task, &squeezed(0.1)));
        for share in [0.005, 0.0, -0.005, -1.0] {
            assert!(!is_from_front(&task, &squeezed(share)), "{share}");
        }
    }

    #[test]
    fn noise_turns_no_flat_pattern_over() {
        let task = task();
        let flat: Points = [[0.0, 1.0], [90.0, -1.0], [91.0, 2.0], [1.0, -2.0]].into();
        assert_eq!(check_sense(&task, &flat), Ok(()));
        assert_eq!(check_shape(&task, &flat), Ok(()));
        let one: Points = [[5.0, 5.0]; 4].into();
        assert_eq!(check_sense(&task, &one), Ok(()));
    }

    #[test]
    fn points_in_one_place_or_on_a_line_are_no_view_of_the_pattern() {
        let task = task();
        // From far away the pattern is small, and still one.
        let small: Points = task.goal.iter().map(|p| p.map(|x| 0.01 * x)).collect();
        assert_eq!(check_shape(&task, &small), Ok(()));
        // A detector's zeros, or one marker found twice.
        for (points, named) in [
            ([[0.0, 0.0]; 4], [0, 1]),
            ([[1.0, 2.0], [90.0, 0.0], [91.0, 90.0], [1.1, 2.2]], [0, 3]),
        ] {
            let refusal = check_shape(&task, &points.into());
            assert_eq!(refusal, Err(Refusal::Coincident { points: named }));
        }
        let line: Points = [[0.0, 0.0], [30.0, 60.1], [60.0, 120.0], [90.0, 180.2]].into();
        let refusal = check_shape(&task, &line);
        assert!(matches!(refusal, Err(Refusal::Flat { .. })), "{refusal:?}");
    }

    #[test]
    fn points_where_others_are_expected_changed_their_names() {
        let expected = task().goal;
        let noisy = shifted(&expected, [7.0, -9.0]);
        assert_eq!(check_names(&noisy, &expected), Ok(()));
        let turned = renamed(&noisy, [1, 2, 3, 0]);
        let refusal = check_names(&turned, &expected);
        assert_eq!(refusal, Err(Refusal::Mixed { points: [0, 1] }));
        // One point on another's place is a bad point, but no exchange.
        let mut one = expected.clone();
        one[0] = expected[1];
        assert_eq!(check_names(&one, &expected), Ok(()));
    }

    #[test]
    fn a_point_that_leaps_alone_is_another_spot() {
        let task = task();
        let expected = &task.goal;
        let leapt = |which: &[usize], by: f64| {
            let mut points = shifted(expected, [3.0, -2.0]);
            which.iter().for_each(|&i| points[i][0] -= by);
            check_leaps(&task, &points, expected)
        };
        assert_eq!(leapt(&[], 0.0), Ok(()));
        assert_eq!(leapt(&[2], 40.0), Ok(()));
        let refusal = leapt(&[2], 80.0);
        assert!(matches!(refusal, Err(Refusal::Leap { point: 2, .. })));
        assert!(leapt(&[0, 3], 80.0).is_err());
        // All of them: the camera was pushed, or the object was.
        assert_eq!(leapt(&[0, 1, 2, 3], 300.0), Ok(()));
    }

    #[test]
    fn points_that_are_all_away_are_elsewhere() {
        let task = task();
        let expected = &task.goal;
        let at = |by: f64| check_place(&task, &shifted(expected, [by, 0.0]), expected, 20.0);
        // 4 % of 1024 px, and the 20.
        assert_eq!(at(60.0), Ok(()));
        assert!(matches!(at(62.0), Err(Refusal::Elsewhere { .. })));
        // One that leaps alone is another matter.
        let mut one = expected.clone();
        one[0][0] += 300.0;
        assert_eq!(check_place(&task, &one, expected, 20.0), Ok(()));
    }
}
