//! The inner corners of a chessboard in an image: all of them, or none.

use std::collections::BTreeMap;

use calib_targets_chessboard::{
    ChessCorner, ChessboardCorner, ChessboardDetection, Detector as GridDetector, DetectorParams,
};
use calib_targets_core::AxisEstimate;
use chess_corners::{CornerDescriptor, Detector, DetectorConfig};
use tag_board::Board;
use vpc_camera::grey::Grey;

use crate::picture::Picture;
use crate::saddle;
use crate::target::Point;

/// Share of the way to the next corner that is looked at.
const REACH: f64 = 0.4;

/// The corners in the order of [`Board::corners`], px. A board that looks the same upside down
/// begins at the end that is nearer to the upper left of the image.
pub fn find(image: &Grey, board: &Board) -> Option<Vec<Point>> {
    // First the image as it is, then also smaller, for large squares out of focus.
    [DetectorConfig::chess(), DetectorConfig::chess_multiscale()]
        .into_iter()
        .find_map(|config| whole(image, board, config))
}

fn whole(image: &Grey, board: &Board, config: DetectorConfig) -> Option<Vec<Point>> {
    let Picture { size, pixels } = Picture::of(image);
    let mut detector = Detector::new(config).ok()?;
    let corners = detector.detect_u8(&pixels, size[0], size[1]).ok()?;
    let corners: Vec<ChessCorner> = corners.iter().map(corner).collect();
    let grids = GridDetector::new(DetectorParams::default()).ok()?;
    let grids = grids.detect_all(&corners);
    let mut grids = grids.iter().filter_map(|grid| Grid::of(grid, image, board));
    grids.find_map(|grid| grid.refined(image))
}

fn corner(found: &CornerDescriptor) -> ChessCorner {
    let axis = |k: usize| AxisEstimate {
        angle: found.axes[k].angle,
        sigma: found.axes[k].sigma,
    };
    ChessCorner {
        position: [found.x, found.y].into(),
        axes: [axis(0), axis(1)],
        contrast: found.contrast,
        fit_rms: found.fit_rms,
        strength: found.response,
    }
}

/// The corners of a board, row by row.
struct Grid {
    columns: usize,
    rows: usize,
    points: Vec<Point>,
}

impl Grid {
    /// The detected corners, if they are as many as the board's, in its order.
    fn of(found: &ChessboardDetection, image: &Grey, board: &Board) -> Option<Self> {
        let place = |corner: &ChessboardCorner| {
            let at = [corner.position.x, corner.position.y].map(f64::from);
            ([corner.grid.u, corner.grid.v], at)
        };
        let places: BTreeMap<[i32; 2], Point> = found.corners.iter().map(place).collect();
        let last = [0, 1].map(|k| places.keys().map(|grid| grid[k]).max().unwrap_or(0));
        let [columns, rows] = [board.columns, board.rows].map(|count| count as usize);
        // The four turns, and how each takes column and row of the board to those of the detector.
        type Turn = fn([i32; 2], [i32; 2]) -> [i32; 2];
        let turns: [Turn; 4] = [
            |[c, r], _| [c, r],
            |[c, r], [_, v]| [r, v - c],
            |[c, r], [u, v]| [u - c, v - r],
            |[c, r], [u, _]| [u - r, c],
        ];
        let mut turned = turns.into_iter().filter_map(|turn| {
            let order = (0..columns * rows).map(|k| [k % columns, k / columns]);
            let points = order.map(|place| places.get(&turn(place.map(|k| k as i32), last)));
            let points: Option<Vec<Point>> = points.map(|point| point.copied()).collect();
            let grid = Self {
                columns,
                rows,
                points: points.filter(|points| points.len() == places.len())?,
            };
            Some(if grid.is_mirrored() {
                grid.mirrored()
            } else {
                grid
            })
        });
        if board.is_symmetric() {
            let first = |grid: &Self| grid.points[0][0] + grid.points[0][1];
            return turned.min_by(|a, b| first(a).total_cmp(&first(b)));
        }
        turned.find(|grid| grid.begins_black(image))
    }

    fn at(&self, column: usize, row: usize) -> Point {
        self.points[row * self.columns + column]
    }

    /// The corners of each square between them.
    fn squares(&self) -> impl Iterator<Item = ([usize; 2], [Point; 4])> + '_ {
        let rows = 0..self.rows - 1;
        let order = rows.flat_map(|row| (0..self.columns - 1).map(move |column| [column, row]));
        order.map(|[c, r]| {
            let corners = [[c, r], [c + 1, r], [c + 1, r + 1], [c, r + 1]];
            ([c, r], corners.map(|[c, r]| self.at(c, r)))
        })
    }

    /// Whether rows go up where columns go to the right.
    fn is_mirrored(&self) -> bool {
        let area = |[a, b, _, d]: [Point; 4]| {
            (b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0])
        };
        self.squares()
            .map(|(_, corners)| area(corners))
            .sum::<f64>()
            < 0.0
    }

    fn mirrored(self) -> Self {
        let rows = self.points.chunks_exact(self.columns);
        Self {
            points: rows.flat_map(|row| row.iter().rev().copied()).collect(),
            ..self
        }
    }

    /// Whether the square beyond the first corner is black: the one within has its colour.
    fn begins_black(&self, image: &Grey) -> bool {
        let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
        for ([column, row], corners) in self.squares() {
            let middle = [0, 1].map(|k| 0.25 * corners.iter().map(|p| p[k]).sum::<f64>());
            let colour = (column + row) % 2;
            sums[colour] += image.level(middle).unwrap_or(0.0);
            counts[colour] += 1.0;
        }
        sums[0] * counts[1] < sums[1] * counts[0]
    }

    fn refined(&self, image: &Grey) -> Option<Vec<Point>> {
        let apart = |a: Point, b: Point| (a[0] - b[0]).hypot(a[1] - b[1]);
        let mut reach = vec![f64::INFINITY; self.points.len()];
        for ([column, row], corners) in self.squares() {
            let first = row * self.columns + column;
            let places = [
                first,
                first + 1,
                first + self.columns + 1,
                first + self.columns,
            ];
            for k in 0..4 {
                let next = (k + 1) % 4;
                let side = REACH * apart(corners[k], corners[next]);
                for place in [places[k], places[next]] {
                    reach[place] = reach[place].min(side);
                }
            }
        }
        let each = self.points.iter().zip(reach);
        each.map(|(point, reach)| saddle::refine(image, *point, reach))
            .collect()
    }
}
