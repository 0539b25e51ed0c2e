//! A printed board and its file: tags in rows, an AprilGrid, a ChArUco board or a chessboard.
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::path::Path;

use markers::Family;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml_schema::{Document, FileError};

/// What is printed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(inline)]
pub enum Kind {
    /// Numbered from the upper left.
    #[default]
    Tags,
    /// Kalibr's: from the lower left.
    Aprilgrid,
    /// OpenCV's.
    Charuco,
    /// From a black square on.
    Chessboard,
}

/// Measure all lengths: printers scale.
#[derive(Clone, Copy, Debug, PartialEq, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "board of vpc-calib")]
pub struct Board {
    /// What is printed.
    pub kind: Kind,
    /// Tags in a row; of ChArUco, squares; of a chessboard, inner corners.
    #[default = 7]
    #[schemars(range(min = 1, max = 40))]
    pub columns: u32,
    /// Rows.
    #[default = 5]
    #[schemars(range(min = 1, max = 40))]
    pub rows: u32,
    /// Family of tags.
    #[schemars(extend("x-allowed" = "DICT_4X4_50 and so on, as vpc-camera's"))]
    pub family: Family,
    /// Side of a tag's black square.
    #[default = 0.030]
    #[schemars(range(min = 0.002, max = 2), extend("x-unit" = "m"))]
    pub tag_size: f64,
    /// Gap between two tags; two modules or more.
    #[default = 0.0075]
    #[schemars(range(min = 0.0005, max = 2), extend("x-unit" = "m"))]
    pub gap: f64,
    /// Side of a chessboard's square.
    #[schemars(range(min = 0.002, max = 2), extend("x-unit" = "m", "x-default" = "none"))]
    pub square_size: Option<f64>,
    /// First tag's number.
    #[schemars(range(min = 0, max = 586))]
    pub first: u32,
    /// ChArUco before OpenCV 4.6.
    pub legacy: bool,
}

impl Board {
    /// Reads a file.
    ///
    /// # Errors
    /// [`FileError`] names the file, the key, its value and what is allowed.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        Self::checked(&Document::read(Some(path))?)
    }

    fn checked(document: &Document) -> Result<Self, FileError> {
        let board: Self = document.check()?;
        let (is_chess, has_tags) = (board.is_chess(), board.kind != Kind::Chessboard);
        for (key, is_known) in [
            ("family", has_tags),
            ("tag_size", has_tags),
            ("first", has_tags),
            ("gap", !is_chess),
            ("square_size", is_chess),
            ("legacy", board.kind == Kind::Charuco),
        ] {
            if document.has(key) && !is_known {
                let allowed = "not for a board of this kind";
                return Err(document.refuse(key, "given", allowed));
            }
        }
        let least = 2.0 * board.module();
        if !is_chess && board.gap < least * (1.0 - 1e-9) {
            let allowed = format!("{least} m or more: each tag has a white border of a module");
            return Err(document.refuse("gap", board.gap, allowed));
        }
        match board.square_size {
            None if is_chess => {
                return Err(document.missing("square_size", "the side of a square, m"));
            }
            Some(square) if board.kind == Kind::Charuco && board.tag_size >= 0.95 * square => {
                let allowed = format!("below {} m: tags lie in white squares", 0.95 * square);
                return Err(document.refuse("tag_size", board.tag_size, allowed));
            }
            _ => (),
        }
        let least = if has_tags { 2 } else { 3 };
        if is_chess && board.columns.min(board.rows) < least {
            let shown = format!("{} x {}", board.columns, board.rows);
            let allowed = format!("{least} or more columns and rows");
            return Err(document.refuse("columns", shown, allowed));
        }
        let (count, most) = (board.tags().count() as u32, board.family.count());
        if board.first + count > most {
            let allowed =
                format!("first + the tags of the board up to {most}, those of the family");
            return Err(document.refuse("columns", board.columns, allowed));
        }
        if has_tags && count < 2 {
            return Err(document.refuse("columns", board.columns, "two tags or more on a board"));
        }
        Ok(board)
    }

    /// Whether it has squares with corners that count.
    pub fn is_chess(&self) -> bool {
        matches!(self.kind, Kind::Charuco | Kind::Chessboard)
    }

    /// Whether it looks the same upside down.
    pub fn is_symmetric(&self) -> bool {
        self.kind == Kind::Chessboard && (self.columns + self.rows).is_multiple_of(2)
    }

    /// Side of a module of a tag, m.
    pub fn module(&self) -> f64 {
        self.tag_size / self.family.black() as f64
    }

    /// From one tag to the next, or from one square to the next, m.
    pub fn pitch(&self) -> f64 {
        match self.square_size {
            Some(square) if self.is_chess() => square,
            _ => self.tag_size + self.gap,
        }
    }

    /// Squares in a row and in a column, or tags.
    fn cells(&self) -> [u32; 2] {
        let more = u32::from(self.kind == Kind::Chessboard);
        [self.columns + more, self.rows + more]
    }

    /// Width and height from the first tag or square to the end of the last, m.
    pub fn extent(&self) -> [f64; 2] {
        let gap = if self.is_chess() { 0.0 } else { self.gap };
        self.cells()
            .map(|count| f64::from(count) * self.pitch() - gap)
    }

    /// Upper left corner of a cell, m, from the centre of the board; x to the right, y down.
    fn cell(&self, column: u32, row: u32) -> [f64; 2] {
        let extent = self.extent();
        let place = [column, row].map(f64::from);
        [0, 1].map(|k| place[k] * self.pitch() - 0.5 * extent[k])
    }

    /// Whether a square of a chessboard is black.
    fn is_black(&self, column: u32, row: u32) -> bool {
        let is_turned = self.legacy && self.rows.is_multiple_of(2);
        (column + row).is_multiple_of(2) != is_turned
    }

    /// Each tag: its number, and the upper left corner of its black square, m, from the centre of
    /// the board; x to the right, y down.
    pub fn tags(&self) -> impl Iterator<Item = (u32, [f64; 2])> + '_ {
        let [columns, rows] = self.cells();
        let is_free = move |column: u32, row: u32| match self.kind {
            Kind::Tags | Kind::Aprilgrid => true,
            Kind::Charuco => !self.is_black(column, row),
            Kind::Chessboard => false,
        };
        let order = (0..columns * rows).map(move |index| {
            let (column, row) = (index % columns, index / columns);
            match self.kind {
                Kind::Aprilgrid => (column, rows - 1 - row),
                _ => (column, row),
            }
        });
        let inset = match self.kind {
            Kind::Charuco => 0.5 * (self.pitch() - self.tag_size),
            _ => 0.0,
        };
        let free = order.filter(move |(column, row)| is_free(*column, *row));
        let tags = (self.first..).zip(free);
        tags.map(move |(number, (column, row))| (number, self.cell(column, row).map(|x| x + inset)))
    }

    /// Each inner corner of the squares, row by row from the upper left, m, as [`Self::tags`].
    pub fn corners(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let [columns, rows] = match self.is_chess() {
            true => self.cells().map(|count| count - 1),
            false => [0; 2],
        };
        let order = (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row)));
        order.map(|(column, row)| self.cell(column + 1, row + 1))
    }

    /// Each black square that is no tag: its upper left corner, m, as [`Self::tags`], and its side.
    pub fn squares(&self) -> impl Iterator<Item = ([f64; 2], f64)> + '_ {
        let [columns, rows] = self.cells();
        // One more than cells, for those of an AprilGrid.
        let order = (0..=rows).flat_map(move |row| (0..=columns).map(move |column| (column, row)));
        order.filter_map(move |(column, row)| match self.kind {
            Kind::Tags => None,
            Kind::Aprilgrid => Some((self.cell(column, row).map(|x| x - self.gap), self.gap)),
            Kind::Charuco | Kind::Chessboard => {
                let is_cell = column < columns && row < rows;
                let is_black = is_cell && self.is_black(column, row);
                is_black.then(|| (self.cell(column, row), self.pitch()))
            }
        })
    }
}

/// Returns the JSON Schema of a file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Board>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Board, String> {
        let document = Document::parse(text, "board.toml").unwrap();
        Board::checked(&document).map_err(|error| error.to_string())
    }

    fn mm(at: [f64; 2]) -> [f64; 2] {
        at.map(|x| (x * 1e6).round() / 1e3)
    }

    #[test]
    fn the_example_is_the_default_and_fits_a4() {
        let example = include_str!("../board.toml");
        assert_eq!(parse(example).unwrap(), Board::default());
        let [width, height] = Board::default().extent();
        assert!(width < 0.297 - 0.029 && height < 0.210 - 0.029);
    }

    #[test]
    fn tags_are_numbered_row_by_row_about_the_centre() {
        let keys = "columns = 3\nrows = 2\ntag_size = 0.02\ngap = 0.01\nfirst = 5";
        for (kind, first) in [("tags", -25.0), ("aprilgrid", 5.0)] {
            let board = parse(&format!("kind = \"{kind}\"\n{keys}")).unwrap();
            let tags: Vec<_> = board.tags().map(|(number, at)| (number, mm(at))).collect();
            assert_eq!(tags.len(), 6);
            assert_eq!(tags[0], (5, [-40.0, first]));
            assert_eq!(tags[5], (10, [20.0, -20.0 - first]));
            assert_eq!(board.corners().count(), 0);
        }
        let grid = parse(&format!("kind = \"aprilgrid\"\n{keys}")).unwrap();
        let squares: Vec<_> = grid.squares().collect();
        assert_eq!(squares.len(), 12);
        assert_eq!((mm(squares[0].0), squares[0].1), ([-50.0, -35.0], 0.01));
    }

    #[test]
    fn a_chessboard_begins_with_a_black_square_and_a_charuco_board_has_tags_in_the_white_ones() {
        let chess = parse("kind = \"chessboard\"\ncolumns = 3\nrows = 4\nsquare_size = 0.02");
        let chess = chess.unwrap();
        assert!(!chess.is_symmetric() && chess.tags().count() == 0);
        assert_eq!(chess.corners().map(mm).next(), Some([-20.0, -30.0]));
        assert_eq!((chess.corners().count(), chess.squares().count()), (12, 10));
        let charuco = |legacy: bool| {
            let sizes = "columns = 3\nrows = 4\nsquare_size = 0.02\ntag_size = 0.01";
            let family = "family = \"DICT_4X4_50\"";
            parse(&format!(
                "kind = \"charuco\"\n{sizes}\n{family}\nlegacy = {legacy}"
            ))
            .unwrap()
        };
        let tags = |board: &Board| board.tags().map(|(_, at)| mm(at)).collect::<Vec<_>>();
        assert_eq!(tags(&charuco(false))[..2], [[-5.0, -35.0], [-25.0, -15.0]]);
        assert_eq!(tags(&charuco(true))[..2], [[-25.0, -35.0], [15.0, -35.0]]);
        assert_eq!(
            charuco(false).corners().map(mm).next(),
            Some([-10.0, -20.0])
        );
    }

    #[test]
    fn what_cannot_be_printed_is_refused_by_name() {
        for (text, said) in [
            ("gap = 0.005", "gap = 0.005; allowed: 0.0075 m or more"),
            (
                "columns = 30\nrows = 30",
                "columns = 30; allowed: first + the tags of the board up to 587",
            ),
            ("columns = 1\nrows = 1", "two tags or more"),
            ("tag_size = 30", "tag_size = 30; allowed: 0.002 to 2 m"),
            ("tag_size = nan", "tag_size = NaN"),
            ("size = 3", "size"),
            (
                "square_size = 0.02",
                "square_size = given; allowed: not for",
            ),
            ("kind = \"chessboard\"", "square_size is missing"),
            (
                "kind = \"chessboard\"\nsquare_size = 0.02\ntag_size = 0.01",
                "tag_size = given",
            ),
            (
                "kind = \"chessboard\"\nsquare_size = 0.02\ncolumns = 2",
                "columns = 2 x 5; allowed: 3 or more",
            ),
            (
                "kind = \"charuco\"\nsquare_size = 0.02\ntag_size = 0.0195",
                "tag_size = 0.0195; allowed: below 0.019 m",
            ),
            (
                "family = \"36h11\"",
                "family = 36h11; allowed: DICT_4X4_50 and so on",
            ),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
