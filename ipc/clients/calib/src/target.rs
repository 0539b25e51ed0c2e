//! What is looked at: tags at known places on a plane.

use std::collections::BTreeMap;

use scene::Scene;

use tag_board::Board;

/// Corners of a tag's black square: upper left, upper right, lower right, lower left.
pub type Corners = [[f64; 2]; 4];

/// Tags on the plane z = 0: x to the right, y down, z away from the viewer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Target {
    /// Corners of each tag, m, by its number.
    tags: BTreeMap<u32, Corners>,
}

impl From<&Board> for Target {
    /// The origin is the centre of the board.
    fn from(board: &Board) -> Self {
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
    pub(crate) fn place(&mut self, number: u32, [x, y]: [f64; 2], side: f64) {
        let corners = [[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
        self.tags.insert(number, corners);
    }

    /// Corners of a tag, m, if it has a place on the target.
    pub fn corners(&self, number: u32) -> Option<&Corners> {
        self.tags.get(&number)
    }

    /// The number of tags.
    pub fn len(&self) -> usize {
        self.tags.len()
    }

    /// Whether it has no tags.
    pub fn is_empty(&self) -> bool {
        self.tags.is_empty()
    }

    /// Lowest and highest number.
    pub fn range(&self) -> [u32; 2] {
        let ends = [self.tags.first_key_value(), self.tags.last_key_value()];
        ends.map(|end| end.map_or(0, |(number, _)| *number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_and_a_scene_place_the_centres_where_they_say() {
        let centre = |corners: &Corners| [0, 1].map(|k| 0.5 * (corners[0][k] + corners[2][k]));
        let board = Target::from(&Board::default());
        assert_eq!((board.len(), board.range()), (35, [0, 34]));
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
