//! A printed board: a grid of AprilTags of the family 36h11, and its file.
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml_schema::{Document, FileError};

/// Tags of the family.
pub const FAMILY: u32 = 587;
/// Side of a tag's black square, in modules.
const MODULES: f64 = 8.0;

/// Tags are numbered row by row from the upper left. Measure all lengths on the print: printers
/// scale.
#[derive(Clone, Copy, Debug, PartialEq, SmartDefault, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "board of vpc-calib")]
pub struct Board {
    /// Tags in a row.
    #[default = 7]
    #[schemars(range(min = 1, max = 40))]
    pub columns: u32,
    /// Rows.
    #[default = 5]
    #[schemars(range(min = 1, max = 40))]
    pub rows: u32,
    /// Side of a tag's black square.
    #[default = 0.030]
    #[schemars(range(min = 0.002, max = 2), extend("x-unit" = "m"))]
    pub tag_size: f64,
    /// Gap between two black squares; at least a quarter of `tag_size`.
    #[default = 0.0075]
    #[schemars(range(min = 0.0005, max = 2), extend("x-unit" = "m"))]
    pub gap: f64,
    /// Number of the upper left tag.
    #[schemars(range(min = 0, max = 586))]
    pub first: u32,
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
        let least = 2.0 * board.module();
        if board.gap < least * (1.0 - 1e-9) {
            let allowed = format!("{least} m or more: each tag has a white border of a module");
            return Err(document.refuse("gap", board.gap, allowed));
        }
        let (last, most) = (board.first + board.columns * board.rows, FAMILY);
        if last > most {
            let allowed = format!("first + columns * rows up to {most}, the tags of the family");
            return Err(document.refuse("columns", board.columns, allowed));
        }
        if last - board.first < 2 {
            return Err(document.refuse("columns", board.columns, "two tags or more on a board"));
        }
        Ok(board)
    }

    /// Side of a module, m: an eighth of a black square.
    pub fn module(&self) -> f64 {
        self.tag_size / MODULES
    }

    /// From one tag to the next, m.
    pub fn pitch(&self) -> f64 {
        self.tag_size + self.gap
    }

    /// Width and height from the first black square to the end of the last, m.
    pub fn extent(&self) -> [f64; 2] {
        [self.columns, self.rows].map(|count| f64::from(count) * self.pitch() - self.gap)
    }

    /// Each tag: its number, and the upper left corner of its black square, m, from the centre of
    /// the board; x to the right, y down.
    pub fn tags(&self) -> impl Iterator<Item = (u32, [f64; 2])> + '_ {
        let [width, height] = self.extent();
        (0..self.columns * self.rows).map(move |index| {
            let [column, row] = [index % self.columns, index / self.columns].map(f64::from);
            let corner = [
                column * self.pitch() - 0.5 * width,
                row * self.pitch() - 0.5 * height,
            ];
            (self.first + index, corner)
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

    #[test]
    fn the_example_is_the_default_and_fits_a4() {
        let example = include_str!("../board.toml");
        assert_eq!(parse(example).unwrap(), Board::default());
        let [width, height] = Board::default().extent();
        assert!(width < 0.297 - 0.029 && height < 0.210 - 0.029);
    }

    #[test]
    fn tags_are_numbered_row_by_row_about_the_centre() {
        let board = parse("columns = 3\nrows = 2\ntag_size = 0.02\ngap = 0.01\nfirst = 5").unwrap();
        let tags: Vec<_> = board.tags().collect();
        assert_eq!(tags.len(), 6);
        let round = |(number, at): (u32, [f64; 2])| (number, at.map(|x| (x * 1e6).round() / 1e6));
        assert_eq!(round(tags[0]), (5, [-0.04, -0.025]));
        assert_eq!(round(tags[5]), (10, [0.02, 0.005]));
    }

    #[test]
    fn what_cannot_be_printed_is_refused_by_name() {
        for (text, said) in [
            ("gap = 0.005", "gap = 0.005; allowed: 0.0075 m or more"),
            (
                "columns = 30\nrows = 30",
                "columns = 30; allowed: first + columns * rows up to 587",
            ),
            ("columns = 1\nrows = 1", "two tags or more"),
            ("tag_size = 30", "tag_size = 30; allowed: 0.002 to 2 m"),
            ("tag_size = nan", "tag_size = NaN"),
            ("size = 3", "size"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
