//! What is looked at: points at known places on a plane.

use std::collections::BTreeMap;

use scene::Scene;

use tag_board::Board;

/// A place on the board, m, or in an image, px.
pub type Point = [f64; 2];
/// Corners of a tag's black square: upper left, upper right, lower right, lower left.
pub type Corners = [Point; 4];

/// Points on the plane z = 0: x to the right, y down, z away from the viewer. Tag n has the numbers
/// 4 n to 4 n + 3 for its corners; those of a chessboard count row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Target {
    /// Each point, m, by its number.
    points: BTreeMap<u32, Point>,
}

/// Corners of a square, from its upper left one and its side.
pub(crate) fn corners_of([x, y]: Point, side: f64) -> Corners {
    [[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
}

impl From<&Board> for Target {
    /// The origin is the centre of the board.
    fn from(board: &Board) -> Self {
        if board.is_chess() {
            let points = (0..).zip(board.corners()).collect();
            return Self { points };
        }
        let mut target = Self::default();
        for (number, corner) in board.tags() {
            target.place(number, corner, board.tag_size);
        }
        target
    }
}

impl Target {
    /// Tag i at point i of a scene's pattern; `tag_size` is the side of the black squares, m.
    pub fn of_scene(scene: &Scene, tag_size: f64) -> Self {
        let mut target = Self::default();
        for (number, [x, y, _]) in (0..).zip(&scene.pattern) {
            let half = 0.5 * tag_size;
            target.place(number, [x - half, y - half], tag_size);
        }
        target
    }

    /// Adds a tag whose upper left corner and side are these, m.
    pub(crate) fn place(&mut self, number: u32, corner: Point, side: f64) {
        self.points
            .extend((4 * number..).zip(corners_of(corner, side)));
    }

    /// A point, m, if there is one of this number.
    pub fn point(&self, number: u32) -> Option<Point> {
        self.points.get(&number).copied()
    }

    /// Corners of a tag, m, if it has a place on the target.
    pub fn corners(&self, number: u32) -> Option<Corners> {
        tag(&self.points, number)
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether it has no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Lowest and highest number of a tag.
    pub fn range(&self) -> [u32; 2] {
        let ends = [self.points.first_key_value(), self.points.last_key_value()];
        ends.map(|end| end.map_or(0, |(number, _)| number / 4))
    }
}

/// The corners of tag `number` among points.
pub(crate) fn tag(points: &BTreeMap<u32, Point>, number: u32) -> Option<Corners> {
    let corner = |k: u32| points.get(&number.checked_mul(4)?.checked_add(k)?).copied();
    Some([corner(0)?, corner(1)?, corner(2)?, corner(3)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_and_a_scene_place_the_centres_where_they_say() {
        let centre = |corners: Corners| [0, 1].map(|k| 0.5 * (corners[0][k] + corners[2][k]));
        let board = Target::from(&Board::default());
        assert_eq!((board.len(), board.range()), (4 * 35, [0, 34]));
        let middle = centre(board.corners(17).unwrap());
        assert!(middle[0].abs() < 1e-12 && middle[1].abs() < 1e-12);
        let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
        let pattern = Target::of_scene(&scene, 0.024);
        for (number, point) in scene.pattern.iter().enumerate() {
            let corners = pattern.corners(number as u32).unwrap();
            let at = centre(corners);
            assert!((at[0] - point[0]).hypot(at[1] - point[1]) < 1e-12);
            assert!((corners[1][0] - corners[0][0] - 0.024).abs() < 1e-12);
        }
    }
}
