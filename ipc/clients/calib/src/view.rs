//! What an image shows of the target.

use std::collections::BTreeMap;

use vision_calibration_core::{CorrespondenceView, Pt2, Pt3};
use vpc_camera::lens::Lens;

use crate::target::{self, Corners, Point, Target};

/// A tag in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family.
    pub number: u32,
    /// Corners of its black square, px; the centre of the upper left pixel is (0, 0).
    pub corners: Corners,
}

/// The points of the target that were seen in an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// The name of the image, for messages.
    pub name: String,
    /// What was seen, px, by the target's numbers.
    pub points: BTreeMap<u32, Point>,
}

impl View {
    /// The corners of tags; a number that was seen twice is left out.
    pub fn of_tags(name: &str, tags: &[Tag]) -> Self {
        let is_one = |tag: &&Tag| tags.iter().filter(|t| t.number == tag.number).count() == 1;
        let corners = |tag: &Tag| (4 * tag.number..).zip(tag.corners);
        Self {
            name: name.to_owned(),
            points: tags.iter().filter(is_one).flat_map(corners).collect(),
        }
    }

    /// The tags that were seen whole.
    pub fn tags(&self) -> impl Iterator<Item = Tag> + '_ {
        let first = self.points.keys().filter(|number| number.is_multiple_of(4));
        first.filter_map(|first| {
            let number = first / 4;
            let corners = target::tag(&self.points, number)?;
            Some(Tag { number, corners })
        })
    }

    /// Drops points that have no place on the target.
    pub fn keep_known(&mut self, target: &Target) {
        self.points
            .retain(|number, _| target.point(*number).is_some());
    }

    /// Moves points to where a pinhole with the lens's focal lengths and principal point sees them;
    /// drops those that it does not see.
    pub fn straighten(&mut self, lens: &Lens) {
        let pixel = |[x, y]: Point| {
            let ([fx, fy], [cx, cy]) = (lens.focal, lens.centre);
            [fx * x + cx, fy * y + cy]
        };
        self.points.retain(|_, point| {
            let straight = lens.normalize(*point).map(pixel);
            straight.inspect(|straight| *point = *straight).is_some()
        });
    }

    /// Points of the target, m, with those in the image, px.
    pub fn pairs<'a>(&'a self, target: &'a Target) -> impl Iterator<Item = (Point, Point)> + 'a {
        let known = self.points.iter();
        known.filter_map(|(number, seen)| Some((target.point(*number)?, *seen)))
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
        let mut view = View::of_tags("a", &[3, 4, 4, 99].map(tag));
        view.keep_known(&target);
        assert_eq!(view.tags().collect::<Vec<_>>(), [tag(3)]);
        assert_eq!(view.pairs(&target).count(), 4);
        assert!(view.correspondences(&target).is_some());
        view.points.clear();
        assert!(view.correspondences(&target).is_none());
    }
}
