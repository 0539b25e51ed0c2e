//! AprilTags of family 36h11 in a grey image.

use kornia_apriltag::errors::AprilTagError;
use kornia_apriltag::family::{TagFamily, TagFamilyKind};
use kornia_apriltag::{AprilTagDecoder, DecodeTagsConfig};
use kornia_image::{Image, ImageSize};
use nalgebra::Matrix3;

use crate::grey::Grey;
use crate::registration::{project, register};
use crate::template::Template;

/// A tag that is seen whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family.
    pub number: u32,
    /// Corners of the black square, px: upper left, upper right, lower right, lower left of the
    /// upright tag.
    pub corners: [[f64; 2]; 4],
    /// Where the diagonals meet, px.
    pub centre: [f64; 2],
}

impl Tag {
    /// The tag in an image of which this one is the part that begins there, px.
    pub fn shifted(&self, [u, v]: [f64; 2]) -> Self {
        let shift = |p: [f64; 2]| [p[0] + u, p[1] + v];
        Self {
            number: self.number,
            corners: self.corners.map(shift),
            centre: shift(self.centre),
        }
    }
}

/// Finds tags in images of one size.
pub struct TagFinder {
    decoder: AprilTagDecoder,
    /// The decoder takes images that own their pixels.
    image: Image<u8, 1>,
    templates: std::sync::Arc<[Template]>,
}

impl std::fmt::Debug for TagFinder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TagFinder")
            .field("size", &self.image.size())
            .finish_non_exhaustive()
    }
}

/// The templates of all tags, which finders share.
#[derive(Clone, Debug)]
pub struct Templates(std::sync::Arc<[Template]>);

/// A finder cannot be made, or an image has another size than its finder.
#[derive(Debug, thiserror::Error)]
#[error("AprilTags: {0}")]
pub struct TagError(#[from] AprilTagError);

impl Templates {
    /// Draws them.
    ///
    /// # Errors
    /// Never, unless the library is broken.
    pub fn new() -> Result<Self, TagError> {
        Ok(Self(Template::of(&TagFamily::tag36_h11()?).into()))
    }
}

impl TagFinder {
    /// A finder for images of this size, px. Quads are looked for in every `coarse`-th pixel of
    /// every `coarse`-th row, 1 or 2; a module must be about 1.5 of them wide.
    ///
    /// # Errors
    /// The size is 0, or too large.
    pub fn new(
        templates: &Templates,
        width: usize,
        height: usize,
        coarse: usize,
    ) -> Result<Self, TagError> {
        let size = ImageSize { width, height };
        // One that misreads a bit is not reported: what is hidden begins with a bit.
        let family = TagFamily::tag36_h11()?.with_max_hamming(2)?;
        let family = TagFamilyKind::Custom(std::sync::Arc::new(family));
        let mut config = DecodeTagsConfig::new(vec![family])?;
        config.downscale_factor = coarse;
        Ok(Self {
            decoder: AprilTagDecoder::new(config, size)?,
            image: Image::from_size_val(size, 0).map_err(AprilTagError::from)?,
            templates: templates.0.clone(),
        })
    }

    /// The tags that are seen whole, in no order. The same number may come twice, from two places.
    ///
    /// # Errors
    /// The image has another size than the finder.
    pub fn find(&mut self, image: &Grey) -> Result<Vec<Tag>, TagError> {
        let width = self.image.width();
        let rows = self.image.as_slice_mut().chunks_exact_mut(width);
        for (row, pixels) in rows.enumerate() {
            pixels.copy_from_slice(image.row(row));
        }
        let found = self.decoder.decode(&self.image)?;
        self.decoder.clear();
        let mut tags = Vec::with_capacity(found.len());
        for quad in found {
            let Some(template) = self.templates.get(usize::from(quad.id)) else {
                continue;
            };
            let rows = quad.quad.homography.to_cols_array();
            let mut start = Matrix3::from_column_slice(&rows.map(f64::from));
            // The library's origin is the corner of the first pixel.
            let shift = Matrix3::new(1.0, 0.0, -0.5, 0.0, 1.0, -0.5, 0.0, 0.0, 1.0);
            start = shift * start;
            if let Some(h) = register(image, template, &start) {
                let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
                tags.push(Tag {
                    number: u32::from(quad.id),
                    corners: corners.map(|corner| project(&h, corner)),
                    centre: project(&h, [0.0, 0.0]),
                });
            }
        }
        Ok(tags)
    }
}
