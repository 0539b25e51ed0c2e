//! Why nothing was learned, and the bounds of what is.

use std::fmt;

use super::region::StillArea;

/// Fewest images.
pub const LEAST_IMAGES: usize = 30;
/// Most of the image that may be still.
pub(super) const MOST_STILL: f64 = 0.6;
/// Least share of the fine structure's mean square that must be variance, at half of the pixels
/// that are not still: else the background moved by less than its grain.
pub(super) const LEAST_CHANGE: f32 = 0.7;
/// Structure is seen beside an area where at least this share of the images has it.
pub(super) const MOST_TIMES: f64 = 0.4;

/// Why nothing was learned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum LearnError {
    #[error("an image of {width}x{height} px; allowed: at least 32x32")]
    Small { width: usize, height: usize },
    #[error(
        "image {image} is of {width}x{height} px; allowed: {}x{}, the size of the first one",
        expected[0], expected[1]
    )]
    Size {
        image: usize,
        width: usize,
        height: usize,
        expected: [usize; 2],
    },
    #[error("{0} images; allowed: at least {LEAST_IMAGES}")]
    Few(usize),
    #[error(
        "no area of at least {least_px} px keeps still while the rest moves: nothing hides the view"
    )]
    Nothing { least_px: usize },
    #[error(
        "{:.0} % of the image never changed; allowed: at most {:.0} %: move the camera, over a background with \
         texture. Motion was never seen in {}",
        100.0 * share, 100.0 * MOST_STILL, Areas(areas)
    )]
    Motionless { share: f64, areas: Vec<StillArea> },
    #[error(
        "the background moved too little: half of the moving pixels saw at most {:.0} % of its fine structure \
         change; allowed: {:.0} % or more: move the camera further",
        100.0 * change, 100.0 * LEAST_CHANGE
    )]
    Slight { change: f32 },
    #[error(
        "nothing tells whether these areas hide the view, or show background without texture that was never \
         moved away: {}; allowed: texture in {:.0} % of the images along half of an area's border: move the \
         camera further, or lay something with texture there",
        Areas(areas), 100.0 * MOST_TIMES
    )]
    Doubtful { areas: Vec<StillArea> },
}

/// Areas, for messages: the largest ones.
struct Areas<'a>(&'a [StillArea]);

impl fmt::Display for Areas<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const MOST: usize = 5;
        let mut areas: Vec<&StillArea> = self.0.iter().collect();
        areas.sort_by_key(|area| std::cmp::Reverse(area.pixels));
        for (k, area) in areas.iter().take(MOST).enumerate() {
            let between = if k == 0 { "" } else { ", " };
            write!(f, "{between}{area}")?;
        }
        match areas.len().saturating_sub(MOST) {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}
