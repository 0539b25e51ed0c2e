//! The corners of a ChArUco board in an image: those between two tags that were read.

use nalgebra::{Matrix3, Vector3};
use tag_board::Board;
use vision_calibration_core::Pt2;
use vision_calibration_linear::prelude::dlt_homography;
use vpc_camera::grey::Grey;

use crate::saddle;
use crate::target::{Corners, Point, corners_of};
use crate::view::Tag;

/// Share of the white about a tag that is looked at.
const REACH: f64 = 0.9;
/// What a lens bends two neighbours by at most, px; tags of another board are farther off.
const FLAT_PX: f64 = 2.0;

/// The corners with their numbers in [`Board::corners`], px. The homography of its two tags says
/// where to look for a corner; it lies where the squares meet.
pub fn find<'a>(
    image: &'a Grey,
    board: &'a Board,
    tags: &'a [Tag],
) -> impl Iterator<Item = (u32, Point)> + 'a {
    let square = board.pitch();
    let white = 0.5 * (square - board.tag_size);
    (0..)
        .zip(board.corners())
        .filter_map(move |(number, corner)| {
            let is_beside = |at: Point| {
                let off = [0, 1].map(|k| (at[k] + 0.5 * board.tag_size - corner[k]).abs());
                off.iter().all(|off| *off < 0.75 * square)
            };
            let beside = board.tags().filter(|(_, at)| is_beside(*at));
            let (mut places, mut pixels) = (Vec::new(), Vec::new());
            for (number, at) in beside {
                let mut same = tags.iter().filter(|tag| tag.number == number);
                let tag = same.next().filter(|_| same.next().is_none())?;
                places.extend(corners_of(at, board.tag_size).map(|[x, y]| Pt2::new(x, y)));
                pixels.extend(seen(board, tag).map(|[u, v]| Pt2::new(u, v)));
            }
            let found = dlt_homography(&places, &pixels).ok()?;
            let h = Matrix3::from_fn(|row, column| found[(row, column)]);
            let mut pairs = places.iter().zip(&pixels);
            let is_flat = pairs.all(|(place, pixel)| {
                let [u, v] = project(&h, [place.x, place.y]);
                (u - pixel.x).hypot(v - pixel.y) < FLAT_PX
            });
            if !is_flat {
                return None;
            }
            let around = [[-white, 0.0], [white, 0.0], [0.0, -white], [0.0, white]];
            let start = project(&h, corner);
            let reach = around.map(|off| {
                let at = project(&h, [0, 1].map(|k| corner[k] + off[k]));
                (at[0] - start[0]).hypot(at[1] - start[1])
            });
            let reach = REACH * reach.into_iter().fold(f64::INFINITY, f64::min);
            Some((number, saddle::refine(image, start, reach)?))
        })
}

/// Corners of a tag, the upper left on the board first.
fn seen(board: &Board, tag: &Tag) -> Corners {
    let mut corners = tag.corners;
    // OpenCV draws those of AprilTag upside down.
    if board.family.is_upside_down() {
        corners.rotate_left(2);
    }
    corners
}

fn project(h: &Matrix3<f64>, [x, y]: Point) -> Point {
    let p = h * Vector3::new(x, y, 1.0);
    [p.x / p.z, p.y / p.z]
}
