//! Families of square markers: AprilTags and ArUco.
//!
//! A marker is a square of bits in a black border, one module wide, in a white one.
#![forbid(unsafe_code)]

mod codes;

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};

/// A family of markers, by OpenCV's name of it.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub struct Family(&'static Dictionary);

/// What OpenCV knows of a family.
struct Dictionary {
    name: &'static str,
    /// Bits along a side.
    bits: usize,
    /// Misread bits that OpenCV corrects.
    corrected: u8,
    /// A code for each marker.
    codes: &'static [u64],
}

/// Every family, in the order of its name.
static DICTIONARIES: [Dictionary; 22] = [
    dictionary("DICT_4X4_100", 4, 1, codes::ARUCO_4X4.split_at(100).0),
    dictionary("DICT_4X4_1000", 4, 0, &codes::ARUCO_4X4),
    dictionary("DICT_4X4_250", 4, 1, codes::ARUCO_4X4.split_at(250).0),
    dictionary("DICT_4X4_50", 4, 1, codes::ARUCO_4X4.split_at(50).0),
    dictionary("DICT_5X5_100", 5, 3, codes::ARUCO_5X5.split_at(100).0),
    dictionary("DICT_5X5_1000", 5, 2, &codes::ARUCO_5X5),
    dictionary("DICT_5X5_250", 5, 2, codes::ARUCO_5X5.split_at(250).0),
    dictionary("DICT_5X5_50", 5, 3, codes::ARUCO_5X5.split_at(50).0),
    dictionary("DICT_6X6_100", 6, 5, codes::ARUCO_6X6.split_at(100).0),
    dictionary("DICT_6X6_1000", 6, 4, &codes::ARUCO_6X6),
    dictionary("DICT_6X6_250", 6, 5, codes::ARUCO_6X6.split_at(250).0),
    dictionary("DICT_6X6_50", 6, 6, codes::ARUCO_6X6.split_at(50).0),
    dictionary("DICT_7X7_100", 7, 8, codes::ARUCO_7X7.split_at(100).0),
    dictionary("DICT_7X7_1000", 7, 6, &codes::ARUCO_7X7),
    dictionary("DICT_7X7_250", 7, 8, codes::ARUCO_7X7.split_at(250).0),
    dictionary("DICT_7X7_50", 7, 9, codes::ARUCO_7X7.split_at(50).0),
    dictionary("DICT_APRILTAG_16h5", 4, 0, &codes::APRILTAG_16H5),
    dictionary("DICT_APRILTAG_25h9", 5, 0, &codes::APRILTAG_25H9),
    dictionary("DICT_APRILTAG_36h10", 6, 0, &codes::APRILTAG_36H10),
    dictionary("DICT_APRILTAG_36h11", 6, 0, &codes::APRILTAG_36H11),
    dictionary("DICT_ARUCO_MIP_36h12", 6, 12, &codes::ARUCO_MIP_36H12),
    dictionary("DICT_ARUCO_ORIGINAL", 5, 0, &codes::ARUCO_ORIGINAL),
];

const fn dictionary(
    name: &'static str,
    bits: usize,
    corrected: u8,
    codes: &'static [u64],
) -> Dictionary {
    Dictionary {
        name,
        bits,
        corrected,
        codes,
    }
}

const NAMES: [&str; DICTIONARIES.len()] = {
    let mut names = [""; DICTIONARIES.len()];
    let mut k = 0;
    while k < names.len() {
        names[k] = DICTIONARIES[k].name;
        k += 1;
    }
    names
};

/// A name that no family has.
#[derive(Debug, thiserror::Error)]
#[error("{name}; allowed: {}", NAMES.join(", "))]
pub struct UnknownFamily {
    name: String,
}

impl Family {
    /// Every name.
    pub const NAMES: &[&str] = &NAMES;

    /// Its name, such as `DICT_APRILTAG_36h11` or `DICT_4X4_50`.
    pub fn name(&self) -> &'static str {
        self.0.name
    }

    /// How many markers it has: their numbers are below.
    pub fn count(&self) -> u32 {
        self.0.codes.len() as u32
    }

    /// Bits along a side.
    pub fn bits(&self) -> usize {
        self.0.bits
    }

    /// Modules along a side of the black square.
    pub fn black(&self) -> usize {
        self.bits() + 2
    }

    /// Modules along a side, with the white border.
    pub fn side(&self) -> usize {
        self.bits() + 4
    }

    /// Share of the side, with the white border, that is black.
    pub fn black_share(&self) -> f64 {
        self.black() as f64 / self.side() as f64
    }

    /// Misread bits that never make another marker of it, in whatever turn.
    pub fn corrected(&self) -> u8 {
        // Names such as 36h11 end in the least distance, which the table has not.
        let distance = self.name().rsplit_once('h').map(|(_, last)| last.parse());
        match distance {
            Some(Ok(distance)) => u8::saturating_sub(distance, 1) / 2,
            _ => self.0.corrected,
        }
    }

    /// Whether OpenCV has its markers upside down: those of AprilTag.
    pub fn is_upside_down(&self) -> bool {
        self.name().starts_with("DICT_APRILTAG")
    }

    /// Whether a module of the upright marker is white: by column and row from the upper left
    /// corner of the black square. A number beyond the family is a marker without white bits.
    pub fn is_white(&self, number: u32, [column, row]: [usize; 2]) -> bool {
        let bits = self.bits();
        let is_bit = |k: usize| (1..=bits).contains(&k);
        let Some(code) = self.0.codes.get(number as usize) else {
            return false;
        };
        if !is_bit(column) || !is_bit(row) {
            return false;
        }
        // The least significant bit is the upper left one; 1 is black.
        let bit = (row - 1) * bits + column - 1;
        let bit = if self.is_upside_down() {
            bits * bits - 1 - bit
        } else {
            bit
        };
        code >> bit & 1 == 0
    }
}

impl Default for Family {
    /// AprilTag 36h11.
    fn default() -> Self {
        "DICT_APRILTAG_36h11"
            .parse()
            .expect("a family of the table")
    }
}

impl FromStr for Family {
    type Err = UnknownFamily;

    fn from_str(name: &str) -> Result<Self, UnknownFamily> {
        let known = DICTIONARIES.iter().find(|it| it.name == name).map(Self);
        known.ok_or_else(|| UnknownFamily {
            name: name.to_owned(),
        })
    }
}

impl TryFrom<String> for Family {
    type Error = UnknownFamily;

    fn try_from(name: String) -> Result<Self, UnknownFamily> {
        name.parse()
    }
}

impl From<Family> for String {
    fn from(family: Family) -> Self {
        family.name().to_owned()
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Debug for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl PartialEq for Family {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Family {}

impl JsonSchema for Family {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Family".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        schemars::json_schema!({ "type": "string", "enum": Self::NAMES })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_a_tag_36h11() {
        assert_eq!(Family::default().name(), "DICT_APRILTAG_36h11");
    }

    /// The white modules of a marker, row by row, a bit each.
    fn white(family: Family, number: u32) -> u128 {
        let side = family.black();
        (0..side * side).fold(0, |white, k| {
            white << 1 | u128::from(family.is_white(number, [k % side, k / side]))
        })
    }

    fn turned(white: u128, side: usize) -> u128 {
        (0..side * side).fold(0, |turned, k| {
            let (row, column) = (k / side, k % side);
            turned | (white >> k & 1) << (side * column + side - 1 - row)
        })
    }

    #[test]
    fn misread_bits_never_make_another_marker() {
        for name in Family::NAMES {
            let family: Family = name.parse().unwrap();
            let all: Vec<u128> = (0..family.count()).map(|n| white(family, n)).collect();
            let some = all.len().min(100);
            let least = 2 * u32::from(family.corrected()) + 1;
            for (i, a) in all[..some].iter().enumerate() {
                for (j, b) in all.iter().enumerate() {
                    let mut b = *b;
                    for turns in 0..4 {
                        let apart = (a ^ b).count_ones();
                        let is_same = i == j && turns == 0;
                        assert!(is_same || apart >= least, "{name} {i} {j} {turns}: {apart}");
                        b = turned(b, family.black());
                    }
                }
            }
        }
    }

    #[test]
    fn a_name_is_opencvs_and_an_unknown_one_is_answered_with_all() {
        let family: Family = "DICT_4X4_50".parse().unwrap();
        assert_eq!((family.count(), family.side()), (50, 8));
        assert_eq!(String::from(family), "DICT_4X4_50");
        // As OpenCV draws its marker 0: white, black, white, white; ...
        let row = |row: usize| [1, 2, 3, 4].map(|column| family.is_white(0, [column, row]));
        assert_eq!(row(1), [true, false, true, true]);
        assert_eq!(row(4), [false, false, true, false]);
        let refused = "36h11".parse::<Family>().unwrap_err().to_string();
        assert!(refused.starts_with("36h11; allowed: DICT_4X4_100,"));
    }
}
