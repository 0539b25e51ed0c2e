//! Tags on the plane of the pattern.

use markers::Family;
use scene::Scene;

use crate::homography::Point;

/// A tag on the plane z = 0 of the object, upright along its axes: x to the right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family.
    pub number: usize,
    /// Its centre, m.
    pub center: [f64; 2],
    /// Side of its black square, m; the white border around it is one module wide.
    pub size: f64,
}

impl Tag {
    /// A tag at each point of a scene's pattern: number i at point i.
    pub fn of_pattern(scene: &Scene, size: f64) -> Vec<Self> {
        let tag = |(number, point): (usize, &[f64; 3])| Self {
            number,
            center: [point[0], point[1]],
            size,
        };
        scene.pattern.iter().enumerate().map(tag).collect()
    }

    /// A board: tags 0, 1, ... row by row from the upper left, `pitch` (m) apart, about the origin.
    pub fn board(columns: usize, rows: usize, size: f64, pitch: f64) -> Vec<Self> {
        let at = |i: usize, count: usize| (i as f64 - 0.5 * (count as f64 - 1.0)) * pitch;
        let tag = |number: usize| Self {
            number,
            center: [at(number % columns, columns), at(number / columns, rows)],
            size,
        };
        (0..columns * rows).map(tag).collect()
    }

    /// Corners of the black square on the plane, m: upper left, upper right, lower right, lower
    /// left.
    pub fn corners(&self) -> [[f64; 2]; 4] {
        self.square(0.5 * self.size)
    }

    /// Corners with the white border, m.
    pub(crate) fn rim(&self, family: Family) -> [Point; 4] {
        self.square(0.5 * self.size / family.black_share())
    }

    fn square(&self, half: f64) -> [Point; 4] {
        let [x, y] = self.center;
        [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(a, b)| [x + a, y + b])
    }

    /// Side of a module, m.
    pub(crate) fn module(&self, family: Family) -> f64 {
        self.size / family.black() as f64
    }

    /// Each row of modules, white border and all, its bits set where they are white, the leftmost
    /// the least significant. A number beyond the family is a tag without a code.
    pub(crate) fn rows(&self, family: Family) -> Vec<u16> {
        let side = family.side();
        let is_white = |at: [usize; 2]| {
            let is_rim = at.iter().any(|k| *k == 0 || *k == side - 1);
            is_rim || family.is_white(self.number as u32, at.map(|k| k - 1))
        };
        let row = |row: usize| {
            (0..side).fold(0, |bits, column| {
                bits | u16::from(is_white([column, row])) << column
            })
        };
        (0..side).map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_centred_and_numbered_row_by_row() {
        let board = Tag::board(6, 4, 0.02, 0.026);
        let center = |i: usize| board[i].center.map(|x| (x * 1e4).round() / 1e4);
        assert_eq!((board.len(), board[7].number), (24, 7));
        assert_eq!((center(0), center(5)), ([-0.065, -0.039], [0.065, -0.039]));
        assert_eq!((center(6), center(23)), ([-0.065, -0.013], [0.065, 0.039]));
    }
}
