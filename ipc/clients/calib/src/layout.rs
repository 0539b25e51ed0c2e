//! Whether the points of images lie as on the board, and how else if not.
//!
//! A plane is seen by a homography (and some distortion), under which only the right order fits. It
//! keeps cross ratios, which tell the gap.

use vision_calibration_core::Pt2;
use vision_calibration_linear::prelude::dlt_homography;

use crate::target::{Point, Target};
use crate::view::View;
use tag_board::{Board, Kind};

/// A layout that fits so much better is the right one.
const BETTER: f64 = 4.0;
/// Of the side of a tag in the image: no lens shifts tags by more against a homography.
const MOST: f64 = 0.25;
/// Fewest points of a view that says something.
const POINTS: usize = 12;
/// Views that are looked at.
const VIEWS: usize = 8;
/// The gap may differ by this share.
const GAP: f64 = 0.1;

/// The tags lie otherwise.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LayoutError {
    /// Another layout fits.
    #[error(
        "the tags do not lie as the board says ({found:.1} px off); they do, {fits:.1} px, if {how}"
    )]
    #[allow(missing_docs)]
    Otherwise { found: f64, fits: f64, how: String },
    /// The gap is another one.
    #[error(
        "the gap between tags is {found:.3} of a tag's side in the images, {expected:.3} by the file; measure tag_size and gap on the paper"
    )]
    #[allow(missing_docs)]
    Gap { found: f64, expected: f64 },
    /// None that is known fits.
    #[error(
        "the corners do not lie as the board says: {found:.1} px off, with squares of {side:.0} px; is the board flat, and this the board of the file?"
    )]
    #[allow(missing_docs)]
    Unknown { found: f64, side: f64 },
    /// Other numbers are seen.
    #[error(
        "most tags in the images are not on the board: {seen:?} are seen, it has {first} to {last}"
    )]
    #[allow(missing_docs)]
    Numbers {
        seen: [u32; 2],
        first: u32,
        last: u32,
    },
}

/// Refuses views of another board; views of fewer than twelve points say nothing.
///
/// # Errors
/// [`LayoutError`] says how the tags lie.
pub fn check(views: &[View], board: &Board) -> Result<(), LayoutError> {
    let target = Target::from(board);
    if !board.is_chess() {
        numbers(views, &target)?;
    }
    let mut known: Vec<View> = views.to_vec();
    for view in &mut known {
        view.keep_known(&target);
    }
    known.retain(|view| view.points.len() >= POINTS);
    // The views that see most say most.
    known.sort_by_key(|view| std::cmp::Reverse(view.points.len()));
    known.truncate(VIEWS);
    let Some(found) = misfit(&known, &target) else {
        return Ok(());
    };
    let side = side(&known, &target, board);
    let others = match board.kind {
        Kind::Tags => others(board),
        _ => Vec::new(),
    };
    let others = others.into_iter().filter_map(|(how, other)| {
        let fits = misfit(&known, &other)?;
        fits.is_finite().then_some((fits, how))
    });
    let best = others.min_by(|a, b| a.0.total_cmp(&b.0));
    match best {
        _ if found <= MOST * side => (),
        Some((fits, how)) if BETTER * fits < found && fits < MOST * side => {
            return Err(LayoutError::Otherwise { found, fits, how });
        }
        _ => return Err(LayoutError::Unknown { found, side }),
    }
    if board.is_chess() {
        return Ok(());
    }
    let expected = board.gap / board.tag_size;
    match gap(&known, board) {
        Some(found) if (found / expected - 1.0).abs() > GAP => {
            Err(LayoutError::Gap { found, expected })
        }
        _ => Ok(()),
    }
}

/// The gap per side of a tag, as neighbours show it; `None` without neighbours.
fn gap(views: &[View], board: &Board) -> Option<f64> {
    let mut gaps = Vec::new();
    for view in views {
        for tag in view.tags() {
            let index = tag.number - board.first;
            let beside = (index % board.columns + 1 < board.columns).then_some(tag.number + 1);
            let below = match board.kind {
                Kind::Aprilgrid => tag.number.checked_sub(board.columns),
                _ => Some(tag.number + board.columns),
            };
            for (number, edges) in [(beside, [[0, 1], [3, 2]]), (below, [[0, 3], [1, 2]])] {
                let Some(next) = view.tags().find(|tag| Some(tag.number) == number) else {
                    continue;
                };
                for [from, to] in edges {
                    let ends =
                        [tag.corners, next.corners].map(|corners| [corners[from], corners[to]]);
                    gaps.extend(gap_of(ends));
                }
            }
        }
    }
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied()
}

/// The gap between two edges of length one on a line, from their ends in the image: their cross
/// ratio is 1 + 1 / (g (2 + g)) there and here.
fn gap_of([[a, b], [c, d]]: [[[f64; 2]; 2]; 2]) -> Option<f64> {
    let along = |p: [f64; 2]| (p[0] - a[0]) * (d[0] - a[0]) + (p[1] - a[1]) * (d[1] - a[1]);
    let [a, b, c, d] = [a, b, c, d].map(along);
    let ratio = (c - a) * (d - b) / ((c - b) * (d - a));
    let gap = (1.0 + 1.0 / (ratio - 1.0)).sqrt() - 1.0;
    gap.is_finite().then_some(gap)
}

fn numbers(views: &[View], target: &Target) -> Result<(), LayoutError> {
    let seen = || {
        views
            .iter()
            .flat_map(|view| view.tags())
            .map(|tag| tag.number)
    };
    let strangers = seen().filter(|number| target.corners(*number).is_none());
    if 2 * strangers.count() <= seen().count() {
        return Ok(());
    }
    let [first, last] = target.range();
    let seen = [seen().min().unwrap_or(0), seen().max().unwrap_or(0)];
    Err(LayoutError::Numbers { seen, first, last })
}

/// Other boards with the same tags, and what they are called.
fn others(board: &Board) -> Vec<(String, Target)> {
    let [columns, rows] = [board.columns, board.rows];
    let renumbered = |order: &dyn Fn(u32, u32) -> u32| {
        let mut target = Target::default();
        for (number, corner) in board.tags() {
            let index = number - board.first;
            let number = board.first + order(index % columns, index / columns);
            target.place(number, corner, board.tag_size);
        }
        target
    };
    let mut others = vec![
        (
            "numbers begin at the lower left and rows go up (as on a board of Kalibr)".to_owned(),
            renumbered(&|column, row| (rows - 1 - row) * columns + column),
        ),
        (
            "numbers begin at the upper right and go to the left".to_owned(),
            renumbered(&|column, row| row * columns + columns - 1 - column),
        ),
        (
            "numbers begin at the lower right and go to the left".to_owned(),
            renumbered(&|column, row| (rows - 1 - row) * columns + columns - 1 - column),
        ),
        (
            "numbers go down each column".to_owned(),
            renumbered(&|column, row| column * rows + row),
        ),
    ];
    for other in (1..=columns * rows).filter(|other| *other != columns) {
        let board = Board {
            columns: other,
            rows: (columns * rows).div_ceil(other),
            ..*board
        };
        others.push((format!("columns = {other}"), Target::from(&board)));
    }
    others
}

/// The median over the views of how far tags are from a homography of the target, RMS, px; `None`
/// without views.
fn misfit(views: &[View], target: &Target) -> Option<f64> {
    let mut each: Vec<f64> = views.iter().map(|view| misfit_of(view, target)).collect();
    each.sort_by(f64::total_cmp);
    each.get(each.len() / 2).copied()
}

fn misfit_of(view: &View, target: &Target) -> f64 {
    let pairs = view.pairs(target);
    let (places, pixels): (Vec<_>, Vec<_>) = pairs
        .map(|([x, y], [u, v])| (Pt2::new(x, y), Pt2::new(u, v)))
        .unzip();
    let Ok(h) = dlt_homography(&places, &pixels) else {
        return f64::INFINITY;
    };
    let squares = places.iter().zip(&pixels).map(|(place, pixel)| {
        let seen = h * place.to_homogeneous();
        (seen.x / seen.z - pixel.x).powi(2) + (seen.y / seen.z - pixel.y).powi(2)
    });
    (squares.sum::<f64>() / places.len() as f64).sqrt()
}

/// The mean side of a tag, or of a square of a chessboard, in the images, px.
fn side(views: &[View], target: &Target, board: &Board) -> f64 {
    let length = board.square_size.unwrap_or(board.tag_size);
    let apart = |a: Point, b: Point| (a[0] - b[0]).hypot(a[1] - b[1]);
    let sides = views.iter().flat_map(|view| {
        let pairs: Vec<_> = view.pairs(target).collect();
        let next = pairs.windows(2).map(|pair| {
            let [(a, p), (b, q)] = [pair[0], pair[1]];
            length * apart(p, q) / apart(a, b)
        });
        next.collect::<Vec<_>>()
    });
    let sides: Vec<f64> = sides.collect();
    sides.iter().sum::<f64>() / sides.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::view::Tag;
    use vision_calibration_core::{Iso3, Vec3};

    /// What a camera with a strongly distorting lens sees of a board.
    fn views(board: &Board) -> Vec<View> {
        let camera = Camera {
            size: [640, 480],
            focal: [500.0; 2],
            center: [320.0, 240.0],
            distortion: [-0.3, 0.1, 0.0, 0.0, 0.0],
        };
        let look = |tilt: f64| {
            let pose = Iso3::new(Vec3::new(0.0, 0.01, 0.3), Vec3::new(tilt, 0.3 - tilt, 0.2));
            let square = |(number, [x, y]): (u32, [f64; 2])| {
                let s = board.tag_size;
                let corners = [[x, y], [x + s, y], [x + s, y + s], [x, y + s]];
                let corners = corners.map(|at| camera.project(&pose, at).unwrap());
                Tag { number, corners }
            };
            View::of_tags("", &board.tags().map(square).collect::<Vec<_>>())
        };
        [-0.3, 0.0, 0.3].map(look).to_vec()
    }

    #[test]
    fn a_distorting_lens_is_no_other_board() {
        let board = Board::default();
        assert_eq!(check(&views(&board), &board), Ok(()));
    }

    #[test]
    fn another_layout_is_named() {
        let board = Board::default();
        let seen = views(&board);
        let said = |board: Board| check(&seen, &board).unwrap_err().to_string();
        let columns = said(Board {
            columns: 5,
            rows: 7,
            ..board
        });
        assert!(columns.contains("columns = 7"), "{columns}");
        let gap = said(Board {
            gap: 0.012,
            ..board
        });
        assert!(
            gap.contains("is 0.25") && gap.contains("of a tag's side in the images, 0.400"),
            "{gap}"
        );
        let first = said(Board {
            first: 100,
            ..board
        });
        assert!(
            first.contains("[0, 34] are seen, it has 100 to 134"),
            "{first}"
        );
        let renumbered = |number: fn(u32) -> u32| {
            let tag = |tag: Tag| Tag {
                number: number(tag.number),
                ..tag
            };
            let views = seen
                .iter()
                .map(|view| view.tags().map(tag).collect::<Vec<_>>());
            views
                .map(|tags| View::of_tags("", &tags))
                .collect::<Vec<_>>()
        };
        let upward = renumbered(|number| (4 - number / 7) * 7 + number % 7);
        let said = check(&upward, &board).unwrap_err().to_string();
        assert!(said.contains("Kalibr"), "{said}");
        let mixed = renumbered(|number| number * 11 % 35);
        let said = check(&mixed, &board).unwrap_err().to_string();
        assert!(said.contains("is the board flat"), "{said}");
    }
}
