//! From images to views.

use markers::Family;
use vpc_camera::grey::Grey;
use vpc_camera::tags::{TagError, TagFinder, Templates};

use crate::view::{Tag, View};

/// Finds the tags of images, of one size after another.
#[derive(Debug)]
pub struct Detector {
    templates: Templates,
    finder: Option<([usize; 2], TagFinder)>,
}

impl Detector {
    /// A detector.
    ///
    /// # Errors
    /// [`TagError`]: the library is broken.
    pub fn new() -> Result<Self, TagError> {
        Ok(Self {
            templates: Templates::new(Family::default())?,
            finder: None,
        })
    }

    /// The tags of an image.
    ///
    /// # Errors
    /// [`TagError`]: the image is too large.
    pub fn view(&mut self, name: &str, image: &Grey) -> Result<View, TagError> {
        let size = [image.width(), image.height()];
        let finder = match self.finder.take() {
            Some((known, finder)) if known == size => finder,
            _ => TagFinder::new(&self.templates, size[0], size[1], 1)?,
        };
        let (_, finder) = self.finder.insert((size, finder));
        let tags = finder.find(image)?;
        let tag = |tag: vpc_camera::tags::Tag| Tag {
            number: tag.number,
            corners: tag.corners,
        };
        Ok(View {
            name: name.to_owned(),
            tags: tags.into_iter().map(tag).collect(),
        })
    }
}
