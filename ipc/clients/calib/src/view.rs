//! The tags of an image.

use std::collections::BTreeMap;

use vision_calibration_core::{CorrespondenceView, Pt2, Pt3};
use vpc_camera::lens::Lens;

use crate::target::{Corners, Target};

/// A tag in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family.
    pub number: u32,
    /// Corners of its black square, px; the centre of the upper left pixel is (0, 0).
    pub corners: Corners,
}

/// The tags that were seen in an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// The name of the image, for messages.
    pub name: String,
    /// What was seen.
    pub tags: Vec<Tag>,
}

impl View {
    /// Drops tags that have no place on the target, and those whose number was seen twice.
    pub fn keep_known(&mut self, target: &Target) {
        let mut counts = BTreeMap::new();
        for tag in &self.tags {
            *counts.entry(tag.number).or_insert(0) += 1;
        }
        self.tags
            .retain(|tag| counts[&tag.number] == 1 && target.corners(tag.number).is_some());
    }

    /// Moves corners to where a pinhole with the lens's focal lengths and principal point sees them;
    /// drops tags of which it sees no corner.
    pub fn straighten(&mut self, lens: &Lens) {
        let pixel = |[x, y]: [f64; 2]| {
            let ([fx, fy], [cx, cy]) = (lens.focal, lens.centre);
            [fx * x + cx, fy * y + cy]
        };
        self.tags.retain_mut(|tag| {
            let straight = tag.corners.map(|corner| lens.normalize(corner).map(pixel));
            let [Some(a), Some(b), Some(c), Some(d)] = straight else {
                return false;
            };
            tag.corners = [a, b, c, d];
            true
        });
    }

    /// Corners on the target, m, with those in the image, px.
    pub fn pairs<'a>(
        &'a self,
        target: &'a Target,
    ) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + 'a {
        let known = self.tags.iter();
        known.flat_map(|tag| {
            let places = target.corners(tag.number).into_iter().flatten();
            places.copied().zip(tag.corners)
        })
    }

    /// The same, as the library takes it; `None` for fewer than four corners.
    pub(crate) fn correspondences(&self, target: &Target) -> Option<CorrespondenceView> {
        let (points, pixels): (Vec<_>, Vec<_>) = self
            .pairs(target)
            .map(|([x, y], [u, v])| (Pt3::new(x, y, 0.0), Pt2::new(u, v)))
            .unzip();
        let is_enough = points.len() >= 4;
        let made = is_enough.then(|| CorrespondenceView::new(points, pixels).ok());
        made.flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tag_board::Board;

    #[test]
    fn strangers_and_doubles_are_dropped() {
        let target = Target::from(&Board::default());
        let tag = |number| Tag {
            number,
            corners: [[0.0; 2]; 4],
        };
        let mut view = View {
            name: "a".into(),
            tags: [3, 4, 4, 99].map(tag).to_vec(),
        };
        view.keep_known(&target);
        assert_eq!(view.tags, [tag(3)]);
        assert_eq!(view.pairs(&target).count(), 4);
        assert!(view.correspondences(&target).is_some());
        view.tags.clear();
        assert!(view.correspondences(&target).is_none());
    }
}
