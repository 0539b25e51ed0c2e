//! From images to views.

use tag_board::{Board, Kind};
use vpc_camera::grey::Grey;
use vpc_camera::tags::{TagError, TagFinder, Templates};

use crate::view::{Tag, View};
use crate::{charuco, chessboard};

/// Finds a board in images, of one size after another.
#[derive(Debug)]
pub struct Detector {
    board: Board,
    templates: Templates,
    finder: Option<([usize; 2], TagFinder)>,
}

impl Detector {
    /// A detector of boards of this kind: only where a tag lies among squares, and how many they
    /// are, does the layout matter.
    ///
    /// # Errors
    /// [`TagError`]: the library is broken.
    pub fn new(board: &Board) -> Result<Self, TagError> {
        Ok(Self {
            board: *board,
            templates: Templates::new(board.family)?,
            finder: None,
        })
    }

    /// What an image shows of the board.
    ///
    /// # Errors
    /// [`TagError`]: the image is too large.
    pub fn view(&mut self, name: &str, image: &Grey) -> Result<View, TagError> {
        let points = match self.board.kind {
            Kind::Tags | Kind::Aprilgrid => return Ok(View::of_tags(name, &self.tags(image)?)),
            Kind::Charuco => {
                let tags = self.tags(image)?;
                charuco::find(image, &self.board, &tags).collect()
            }
            Kind::Chessboard => {
                let corners = chessboard::find(image, &self.board);
                (0..).zip(corners.into_iter().flatten()).collect()
            }
        };
        let name = name.to_owned();
        Ok(View { name, points })
    }

    fn tags(&mut self, image: &Grey) -> Result<Vec<Tag>, TagError> {
        let size = [image.width(), image.height()];
        let finder = match self.finder.take() {
            Some((known, finder)) if known == size => finder,
            _ => TagFinder::new(&self.templates, size[0], size[1], 1)?,
        };
        let (_, finder) = self.finder.insert((size, finder));
        let tag = |tag: vpc_camera::tags::Tag| Tag {
            number: tag.number,
            corners: tag.corners,
        };
        let mut found = finder.find(image)?;
        let is_missing = |number| found.iter().all(|tag| tag.number != number);
        let more = finder.find_missing(image, is_missing)?;
        found.extend(more);
        Ok(found.into_iter().map(tag).collect())
    }
}
