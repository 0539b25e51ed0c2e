//! AprilTags of the family 36h11.

use scene::Scene;

use crate::homography::Point;

/// Modules along a side with the white border: 6 of the code, 2 of the black border, 2 of the
/// white one.
pub(crate) const SIDE: usize = 10;
/// Modules along a side of the black square.
const BLACK: f64 = 8.0;

/// The codes of tags 0 to 35: 6 x 6 bits, row by row from the upper left, the most significant
/// first; 1 is white.
///
/// Source: AprilTag 3, `tag36h11.c` (BSD-2-Clause), whose bits are in another order. OpenCV has the
/// same tags turned by half a turn: the first corner that it finds is the lower right one here.
const CODES: [u64; 36] = [
    0xd5d628584,
    0xd97f18b49,
    0xdd280910e,
    0xe479e9c98,
    0xebcbca822,
    0xf31dab3ac,
    0x056a5d085,
    0x10652e1d4,
    0x22b1dfead,
    0x265ad0472,
    0x34fe91b86,
    0x3ff962cd5,
    0x43a25329a,
    0x474b4385f,
    0x4e9d243e9,
    0x5246149ae,
    0x5997f5538,
    0x683bb6c4c,
    0x6be4a7211,
    0x7e3158eea,
    0x81da494af,
    0x858339a74,
    0x8cd51a5fe,
    0x9f21cc2d7,
    0xa2cabc89c,
    0xadc58d9eb,
    0xb16e7dfb0,
    0xb8c05eb3a,
    0xd25ef139d,
    0xd607e1962,
    0xe4aba3076,
    0x2dde6a3da,
    0x43d40c678,
    0x5620be351,
    0x64c47fa65,
    0x686d7002a,
];

/// A tag on the plane z = 0 of the object, upright along its axes: x to the right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family.
    pub number: usize,
    /// Its centre, m.
    pub center: [f64; 2],
    /// Side of its black square, m; the white border around it adds an eighth on each side.
    pub size: f64,
}

impl Tag {
    /// Tags 0, 1, ... that can be drawn.
    pub const COUNT: usize = CODES.len();
    /// Share of its side, with the white border, that the black square has.
    pub const BLACK_SHARE: f64 = BLACK / SIDE as f64;

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
    pub(crate) fn rim(&self) -> [Point; 4] {
        self.square(0.5 * self.size / Self::BLACK_SHARE)
    }

    fn square(&self, half: f64) -> [Point; 4] {
        let [x, y] = self.center;
        [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(a, b)| [x + a, y + b])
    }

    /// Side of a module, m.
    pub(crate) fn module(&self) -> f64 {
        self.size / BLACK
    }

    /// Each row of modules, white border and all, its bits set where they are white, the leftmost
    /// the least significant. A number beyond the table is a tag without a code.
    pub(crate) fn rows(&self) -> [u16; SIDE] {
        let code = CODES.get(self.number).copied().unwrap_or(0);
        let white = (1u16 << SIDE) - 1;
        std::array::from_fn(|row| match row {
            0 | 9 => white,
            1 | 8 => 1 | 1 << 9,
            _ => (0..6).fold(1 | 1 << 9, |bits, column| {
                let bit = code >> (35 - (6 * (row - 2) + column)) & 1;
                bits | (bit as u16) << (column + 2)
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_differ_in_eleven_bits_at_least_however_they_are_turned() {
        let turned = |code: u64| {
            (0..36).fold(0, |turned, i| {
                let (row, column) = (i / 6, i % 6);
                turned | (code >> i & 1) << (6 * column + 5 - row)
            })
        };
        for (i, &a) in CODES.iter().enumerate() {
            for (j, &b) in CODES.iter().enumerate() {
                let mut b = b;
                for turns in 0..4 {
                    let apart = (a ^ b).count_ones();
                    assert!(
                        (i == j && turns == 0) || apart >= 11,
                        "{i} {j} {turns}: {apart}"
                    );
                    b = turned(b);
                }
            }
        }
    }

    #[test]
    fn a_board_is_centred_and_numbered_row_by_row() {
        let board = Tag::board(6, 4, 0.02, 0.026);
        let center = |i: usize| board[i].center.map(|x| (x * 1e4).round() / 1e4);
        assert_eq!((board.len(), board[7].number), (24, 7));
        assert_eq!((center(0), center(5)), ([-0.065, -0.039], [0.065, -0.039]));
        assert_eq!((center(6), center(23)), ([-0.065, -0.013], [0.065, 0.039]));
    }
}
