//! Tags of a family in a grey image.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock};

use kornia_apriltag::decoder::{QuickDecode, SharpeningBuffer};
use kornia_apriltag::errors::AprilTagError;
use kornia_apriltag::family::{TagFamily, TagFamilyKind};
use kornia_apriltag::{AprilTagDecoder, DecodeTagsConfig};
use kornia_image::{Image, ImageSize};
use kornia_imgproc::filter::gaussian_blur_u8;
use markers::Family;
use nalgebra::Matrix3;

use crate::grey::Grey;
use crate::registration::{project, register};
use crate::template::Template;

/// Unsharp mask: its gain, and the standard deviation of its Gaussian, px. Chosen on renderings of
/// the laboratory's starts at a blur of 2.1 px.
const SHARPER: i32 = 3;
const SHARPENED_PX: f32 = 2.0;
/// Most misread bits of a tag that is not taken for another thing.
const MISREAD: u8 = 2;
/// The threshold between black and white, as a share from the darkest to the brightest pixel
/// nearby: of the first search, and of the search for missing tags. A high one finds tags with
/// glossy ink, a low one separates tags of a Kalibr board from its squares.
const SPLITS: [f32; 2] = [0.5, 0.33];

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
    /// By [`SPLITS`].
    decoders: [AprilTagDecoder; 2],
    coarse: usize,
    /// The decoder takes images that own their pixels.
    image: Image<u8, 1>,
    blurred: Image<u8, 1>,
    templates: Templates,
    refused: Vec<u32>,
}

impl std::fmt::Debug for TagFinder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TagFinder")
            .field("size", &self.image.size())
            .finish_non_exhaustive()
    }
}

/// The templates of a family's tags, alone and with the squares of a Kalibr board, which finders
/// share: each is drawn when its tag is first seen.
#[derive(Clone, Debug)]
pub struct Templates {
    family: Family,
    library: Arc<TagFamily>,
    drawn: Arc<[[OnceLock<Template>; 2]]>,
}

/// A finder cannot be made, or an image has another size than its finder.
#[derive(Debug, thiserror::Error)]
#[error("tags: {0}")]
pub struct TagError(#[from] AprilTagError);

impl Templates {
    /// Those of a family.
    ///
    /// # Errors
    /// Never, unless the library is broken.
    pub fn new(family: Family) -> Result<Self, TagError> {
        Ok(Self {
            family,
            library: Arc::new(of_library(family)?),
            drawn: (0..family.count()).map(|_| Default::default()).collect(),
        })
    }

    /// That of the tag of this number which `start` takes into the image.
    fn get(&self, number: u32, image: &Grey, start: &Matrix3<f64>) -> Option<&Template> {
        let drawn = self.drawn.get(number as usize)?;
        let has_squares = has_squares(image, self.family, start);
        let drawn = &drawn[usize::from(has_squares)];
        Some(drawn.get_or_init(|| Template::new(self.family, number, has_squares)))
    }

    fn decoder(
        &self,
        size: ImageSize,
        coarse: usize,
        split: f32,
    ) -> Result<AprilTagDecoder, TagError> {
        let family = TagFamilyKind::Custom(self.library.clone());
        let mut config = DecodeTagsConfig::new(vec![family])?;
        config.downscale_factor = coarse;
        config.threshold_split = split;
        Ok(AprilTagDecoder::new(config, size)?)
    }
}

/// Whether black squares touch the corners of a tag, as on a board of Kalibr.
fn has_squares(image: &Grey, family: Family, start: &Matrix3<f64>) -> bool {
    let module = 2.0 / family.black() as f64;
    let level = |x: f64, y: f64| image.level(project(start, [x, y]));
    let (black, white) = (1.0 - 0.5 * module, 1.0 + 0.5 * module);
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
        .iter()
        .all(|[x, y]| {
            let beyond = level(x * white, y * white);
            let inside = level(x * black, y * black);
            let beside = level(x * black, y * white).zip(level(x * white, y * black));
            let known = beyond.zip(inside).zip(beside);
            known.is_some_and(|((beyond, inside), (a, b))| 2.0 * beyond < inside + 0.5 * (a + b))
        })
}

/// A family as the library reads it.
fn of_library(family: Family) -> Result<TagFamily, AprilTagError> {
    let (bits, last) = (family.bits(), family.black() - 1);
    // Bits in four quarters, each the one before it turned to the right; then the middle one.
    let ring = |y: usize| (y..last - y).map(move |x| [x, y]);
    let quarter: Vec<[usize; 2]> = (1..=bits / 2).flat_map(ring).collect();
    let mut places = quarter.clone();
    for turn in 1..4 {
        let turned = |k: &[usize; 2]| (0..turn).fold(*k, |[x, y], _| [last - y, x]);
        places.extend(quarter.iter().map(turned));
    }
    if bits % 2 == 1 {
        places.push([last / 2; 2]);
    }
    let code = |number| {
        let bits = places.iter().map(|at| family.is_white(number, *at));
        bits.fold(0, |code, bit| code << 1 | usize::from(bit))
    };
    let codes: Vec<usize> = (0..family.count()).map(code).collect();
    // One that misreads a bit is not reported: what is hidden begins with a bit.
    let misread = family.corrected().min(MISREAD);
    Ok(TagFamily {
        name: family.name().to_owned(),
        width_at_border: family.black(),
        reversed_border: false,
        total_width: family.side(),
        nbits: places.len(),
        bit_x: places.iter().map(|[x, _]| *x as i8).collect(),
        bit_y: places.iter().map(|[_, y]| *y as i8).collect(),
        quick_decode: QuickDecode::new(places.len(), &codes, misread)?,
        code_data: codes,
        min_hamming: 2 * family.corrected() + 1,
        sharpening_buffer: SharpeningBuffer::new(family.side() * family.side()),
    })
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
        let [first, second] = SPLITS.map(|split| templates.decoder(size, coarse, split));
        Ok(Self {
            decoders: [first?, second?],
            coarse,
            image: Image::from_size_val(size, 0).map_err(AprilTagError::from)?,
            blurred: Image::from_size_val(size, 0).map_err(AprilTagError::from)?,
            templates: templates.clone(),
            refused: Vec::new(),
        })
    }

    /// The tags that are seen whole, in no order. The same number may come twice, from two places.
    ///
    /// # Errors
    /// The image has another size than the finder.
    pub fn find(&mut self, image: &Grey) -> Result<Vec<Tag>, TagError> {
        self.find_those(image, |_| true)
    }

    /// Those of them with a wanted number: a fit costs as much as the search of a window.
    ///
    /// # Errors
    /// The image has another size than the finder.
    pub fn find_those(
        &mut self,
        image: &Grey,
        is_wanted: impl Fn(u32) -> bool,
    ) -> Result<Vec<Tag>, TagError> {
        self.take(image);
        self.decode(0, image, is_wanted)
    }

    /// Tags that the first search missed: by the other threshold, or else in a sharpened image, for
    /// tags out of focus. They are registered in the original.
    ///
    /// # Errors
    /// The image has another size than the finder.
    pub fn find_missing(
        &mut self,
        image: &Grey,
        is_wanted: impl Fn(u32) -> bool,
    ) -> Result<Vec<Tag>, TagError> {
        self.take(image);
        let found = self.decode(1, image, &is_wanted)?;
        if !(found.is_empty() && self.refused.is_empty()) {
            return Ok(found);
        }
        let sigma = (SHARPENED_PX, SHARPENED_PX);
        let blurred = gaussian_blur_u8(&self.image, &mut self.blurred, (0, 0), sigma);
        blurred.map_err(AprilTagError::from)?;
        let pixels = self.image.as_slice_mut().iter_mut();
        for (pixel, &mean) in pixels.zip(self.blurred.as_slice()) {
            let level = i32::from(*pixel);
            let sharp = level + SHARPER * (level - i32::from(mean));
            *pixel = sharp.clamp(0, 255) as u8;
        }
        self.decode(1, image, is_wanted)
    }

    /// Numbers of tags that were read in the last image, but are not seen whole.
    pub fn refused(&self) -> &[u32] {
        &self.refused
    }

    fn take(&mut self, image: &Grey) {
        let width = self.image.width();
        let rows = self.image.as_slice_mut().chunks_exact_mut(width);
        for (row, pixels) in rows.enumerate() {
            pixels.copy_from_slice(image.row(row));
        }
    }

    /// The tags that a decoder sees in the taken image, registered in the original.
    fn decode(
        &mut self,
        by: usize,
        image: &Grey,
        is_wanted: impl Fn(u32) -> bool,
    ) -> Result<Vec<Tag>, TagError> {
        self.refused.clear();
        // The library panics at a quad with a point at infinity among those that it samples: there
        // is no tag, and the next image has another one.
        let decoded = catch_unwind(AssertUnwindSafe(|| self.decoders[by].decode(&self.image)));
        let Ok(found) = decoded else {
            let size = self.image.size();
            self.decoders[by] = self.templates.decoder(size, self.coarse, SPLITS[by])?;
            return Ok(Vec::new());
        };
        let found = found?;
        self.decoders[by].clear();
        let mut tags = Vec::with_capacity(found.len());
        for quad in found {
            let number = u32::from(quad.id);
            if !is_wanted(number) {
                continue;
            }
            let rows = quad.quad.homography.to_cols_array();
            let mut start = Matrix3::from_column_slice(&rows.map(f64::from));
            // The library's origin is the corner of the first pixel.
            let shift = Matrix3::new(1.0, 0.0, -0.5, 0.0, 1.0, -0.5, 0.0, 0.0, 1.0);
            start = shift * start;
            let Some(template) = self.templates.get(number, image, &start) else {
                continue;
            };
            let Some(h) = register(image, template, &start) else {
                self.refused.push(number);
                continue;
            };
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            tags.push(Tag {
                number,
                corners: corners.map(|corner| project(&h, corner)),
                centre: project(&h, [0.0, 0.0]),
            });
        }
        Ok(tags)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::drawn::{BLACK, Drawing, WHITE, placed};

    /// Side of the images, px: the largest tag is inside it with its white border, however it is turned.
    const SIDE: usize = 160;

    fn finder(family: Family, coarse: usize) -> TagFinder {
        TagFinder::new(&Templates::new(family).unwrap(), SIDE, SIDE, coarse).unwrap()
    }

    fn found(finder: &mut TagFinder, drawing: &Drawing, seed: u64) -> Vec<Tag> {
        let pixels = drawing.pixels(2.0, seed);
        let image = Grey::new(&pixels, SIDE, SIDE, SIDE).unwrap();
        finder.find(&image).unwrap()
    }

    /// As a missing tag is looked for: once more.
    fn found_after_all(finder: &mut TagFinder, drawing: &Drawing, seed: u64) -> Vec<Tag> {
        let tags = found(finder, drawing, seed);
        if !tags.is_empty() {
            return tags;
        }
        let pixels = drawing.pixels(2.0, seed);
        let image = Grey::new(&pixels, SIDE, SIDE, SIDE).unwrap();
        finder.find_missing(&image, |_| true).unwrap()
    }

    /// A tag of 36h11 somewhere in the middle: its number, and from tag coordinates to px.
    fn placement(random: &mut ChaCha8Rng, side: f64, tilt: f64) -> (u32, Matrix3<f64>) {
        placement_of(Family::default(), random, side, tilt)
    }

    fn placement_of(
        family: Family,
        random: &mut ChaCha8Rng,
        side: f64,
        tilt: f64,
    ) -> (u32, Matrix3<f64>) {
        let mut unit = || random.random::<f64>();
        let number = (f64::from(family.count()) * unit()) as u32;
        let at = [76.0 + 8.0 * unit(), 76.0 + 8.0 * unit()];
        let tilt = [tilt * (2.0 * unit() - 1.0), tilt * (2.0 * unit() - 1.0)];
        (
            number,
            placed(at, side, std::f64::consts::TAU * unit(), tilt),
        )
    }

    fn corners(h: &Matrix3<f64>) -> [[f64; 2]; 4] {
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|p| project(h, p))
    }

    fn apart(a: [f64; 2], b: [f64; 2]) -> f64 {
        (a[0] - b[0]).hypot(a[1] - b[1])
    }

    /// Every number, turned and tilted at random, sharp and blurred: by how much centres and corners
    /// may miss (px RMS).
    #[test]
    fn a_tag_is_where_it_is_drawn() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (side, blur, coarse, centre_px, corner_px) in [
            (20.0, 0.6, 1, 0.03, 0.1),
            (27.0, 0.6, 1, 0.03, 0.06),
            (27.0, 1.0, 1, 0.04, 0.15),
            (27.0, 1.5, 1, 0.06, 0.3),
            (32.0, 2.1, 1, 0.08, 0.4),
            (42.0, 0.6, 2, 0.03, 0.06),
            (42.0, 1.5, 2, 0.05, 0.15),
            (68.0, 0.6, 2, 0.03, 0.06),
        ] {
            let mut finder = finder(Family::default(), coarse);
            let mut off = Off::default();
            for n in 0..40 {
                let (number, h) = placement(&mut random, side, 0.12);
                let mut drawing = Drawing::new(SIDE, SIDE, 110.0);
                drawing.tag(Family::default(), number, &h);
                drawing.blur(blur);
                let is_sharp = blur < side / 20.0;
                let look = if is_sharp { found } else { found_after_all };
                off.add(&look(&mut finder, &drawing, n), number, &h);
            }
            off.check(
                &format!("{side} px, blur {blur} px"),
                [centre_px, corner_px],
            );
        }
    }

    /// Squares of 2 modules, or of more than the fit takes them for.
    #[test]
    fn a_tag_of_a_kalibr_board_is_where_it_is_drawn() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for (side, gap, blur, centre_px, corner_px) in [
            (27.0, 0.25, 0.6, 0.03, 0.06),
            (27.0, 0.3, 1.0, 0.04, 0.15),
            (42.0, 0.3, 0.6, 0.03, 0.06),
            (60.0, 0.5, 1.0, 0.03, 0.06),
        ] {
            let mut finder = finder(Family::default(), 1);
            let mut off = Off::default();
            for n in 0..40 {
                let (number, h) = placement(&mut random, side, 0.12);
                let back = h.try_inverse().unwrap();
                let mut drawing = Drawing::new(SIDE, SIDE, 110.0);
                drawing.paint(|u, v| {
                    let at = project(&back, [u, v]).map(f64::abs);
                    let is_square = at.iter().all(|x| (1.0..1.0 + 2.0 * gap).contains(x));
                    let is_paper = at.iter().all(|x| *x < 1.0 + 2.0 * gap);
                    is_paper.then_some(if is_square { BLACK } else { WHITE })
                });
                drawing.tag_on(Family::default(), number, &h, 0.0);
                drawing.blur(blur);
                off.add(&found_after_all(&mut finder, &drawing, n), number, &h);
            }
            off.check(&format!("{side} px, gap {gap}"), [centre_px, corner_px]);
        }
    }

    /// How far 40 tags are from where they are drawn: sums of squares, px^2.
    #[derive(Default)]
    struct Off {
        centre: f64,
        corner: f64,
        count: u32,
    }

    impl Off {
        fn add(&mut self, found: &[Tag], number: u32, h: &Matrix3<f64>) {
            for tag in found {
                assert_eq!(tag.number, number);
                self.count += 1;
                self.centre += apart(tag.centre, project(h, [0.0; 2])).powi(2);
                let pairs = tag.corners.iter().zip(corners(h));
                self.corner += pairs.map(|(a, b)| apart(*a, b).powi(2) / 4.0).sum::<f64>();
            }
        }

        /// Checks that no more than one is missing, and the RMS of centres and corners, px.
        fn check(&self, what: &str, most: [f64; 2]) {
            let count = self.count;
            let rms = |sum: f64| (sum / f64::from(count)).sqrt();
            let [centre, corner] = [self.centre, self.corner].map(rms);
            println!("{what}: {count} of 40, centre {centre:.3}, corner {corner:.3} px");
            assert!(count >= 39, "{what}: {count} of 40");
            assert!(
                centre < most[0] && corner < most[1],
                "{what}: {centre} {corner}"
            );
        }
    }

    /// What slides over a tag: a half plane, a bar or a disc.
    struct Occluder {
        shape: &'static str,
        level: f64,
        /// Direction of the slide.
        along: [f64; 2],
        /// Half the width of the bar, radius of the disc, px.
        reach: f64,
    }

    impl Occluder {
        /// Paints it `x` px beyond the tag's centre.
        fn paint(&self, drawing: &mut Drawing, [u, v]: [f64; 2], x: f64) {
            let [c, s] = self.along;
            drawing.cover(self.level, |i, j| {
                let (a, b) = ((i - u) * c + (j - v) * s, (j - v) * c - (i - u) * s);
                match self.shape {
                    "bar" => (a - x).abs() - self.reach,
                    "disc" => (a - x).hypot(b - 5.0) - self.reach,
                    _ => a - x,
                }
            });
        }
    }

    /// Whatever slides over a tag, dark, grey or white as its paper, across or along an edge: the tag
    /// is refused before it seems to be 0.22 px elsewhere.
    #[test]
    fn a_tag_that_is_partly_hidden_is_refused_or_exact() {
        let step = if testkit::is_long() { 0.35 } else { 1.4 };
        slide(
            Family::default(),
            "through a lens",
            &|drawing| drawing.blur(0.6),
            step,
        );
    }

    /// What a camera does to its pictures, and light to a print.
    #[test]
    fn so_it_is_in_what_a_real_camera_makes_of_it() {
        let step = if testkit::is_long() { 0.7 } else { 6.3 };
        for (name, change) in CHANGES {
            slide(Family::default(), name, &change, step);
        }
    }

    fn families() -> impl Iterator<Item = Family> {
        testkit::FAMILIES
            .into_iter()
            .map(|name| name.parse().unwrap())
    }

    #[test]
    fn so_it_is_of_every_family() {
        let step = if testkit::is_long() { 0.7 } else { 6.3 };
        for family in families() {
            slide(family, family.name(), &|drawing| drawing.blur(0.6), step);
        }
    }

    #[test]
    fn a_tag_of_every_family_is_where_it_is_drawn() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for family in families() {
            // As wide a module as of 36h11 with 27 px.
            let side = 27.0 / 8.0 * family.black() as f64;
            let mut finder = finder(family, 1);
            let mut off = Off::default();
            for n in 0..40 {
                let (number, h) = placement_of(family, &mut random, side, 0.12);
                let mut drawing = Drawing::new(SIDE, SIDE, 110.0);
                drawing.tag(family, number, &h);
                drawing.blur(0.6);
                off.add(&found(&mut finder, &drawing, n), number, &h);
            }
            off.check(&format!("{family}, {side} px"), [0.04, 0.1]);
        }
    }

    /// The library has some of the families itself.
    #[test]
    fn a_family_is_that_of_the_library() {
        let white = |family: &TagFamily, number: usize| {
            let places = family.bit_x.iter().zip(&family.bit_y).rev();
            let code = family.code_data[number];
            let white = places.enumerate().filter(|(bit, _)| code >> bit & 1 == 1);
            let mut white: Vec<_> = white.map(|(_, place)| place).collect();
            white.sort_unstable();
            white.into_iter().map(|(x, y)| (*x, *y)).collect::<Vec<_>>()
        };
        for (name, known) in [
            ("DICT_APRILTAG_16h5", TagFamily::tag16_h5()),
            ("DICT_APRILTAG_25h9", TagFamily::tag25_h9()),
            ("DICT_APRILTAG_36h10", TagFamily::tag36_h10()),
            ("DICT_APRILTAG_36h11", TagFamily::tag36_h11()),
        ] {
            let (ours, known) = (of_library(name.parse().unwrap()).unwrap(), known.unwrap());
            assert_eq!(ours.code_data.len(), known.code_data.len(), "{name}");
            for number in 0..known.code_data.len() {
                assert_eq!(
                    white(&ours, number),
                    white(&known, number),
                    "{name} {number}"
                );
            }
        }
    }

    /// Makes of a drawing what a camera would.
    type Change = fn(&mut Drawing);

    /// Kinds of pictures by name.
    const CHANGES: [(&str, Change); 4] = [
        ("sharpened", |drawing| {
            drawing.blur(0.8);
            drawing.sharpen(0.8);
        }),
        ("smeared down", |drawing| {
            drawing.blur(0.6);
            drawing.smear(0.06, 3.0);
        }),
        ("from a mosaic", |drawing| {
            drawing.blur(0.6);
            drawing.demosaic();
        }),
        ("under gloss", |drawing| {
            drawing.blur(0.6);
            drawing.gloss([60.0, 90.0], 50.0, 60.0);
        }),
    ];

    #[test]
    fn a_whole_tag_is_exact_in_what_a_real_camera_makes_of_it() {
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let mut finder = finder(Family::default(), 1);
        for (name, change) in CHANGES {
            let (mut sum, mut squares, mut count) = ([0.0; 2], 0.0, 0.0);
            for n in 0..60 {
                let (number, h) = placement(&mut random, 50.0, 0.15);
                // Looked at from aside: its axes meet at angles of up to 37 degrees.
                let look = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0);
                let middle = Matrix3::new(1.0, 0.0, 80.0, 0.0, 1.0, 80.0, 0.0, 0.0, 1.0);
                let h = middle * look * middle.try_inverse().unwrap() * h;
                let mut drawing = Drawing::new(SIDE, SIDE, 110.0);
                drawing.tag(Family::default(), number, &h);
                change(&mut drawing);
                for tag in found(&mut finder, &drawing, n) {
                    let truth = project(&h, [0.0; 2]);
                    let off = [0, 1].map(|k| tag.centre[k] - truth[k]);
                    sum = [0, 1].map(|k| sum[k] + off[k]);
                    squares += off[0].powi(2) + off[1].powi(2);
                    count += 1.0;
                }
            }
            let (rms, bias) = ((squares / count).sqrt(), sum.map(|sum: f64| sum / count));
            println!("{name}: {count} of 60, {rms:.3} px RMS, {bias:.3?} px on the mean");
            assert!(count >= 54.0, "{name}: {count}");
            assert!(
                rms < 0.08 && bias.iter().all(|bias| bias.abs() < 0.05),
                "{name}"
            );
        }
    }

    /// A tag whose white border lies outside the image is seen, one of whose black square a part does
    /// is not.
    #[test]
    fn the_image_ends_in_the_white_border_at_the_earliest() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let mut finder = finder(Family::default(), 1);
        for (beyond, count) in [(2.5, 10), (-3.0, 0)] {
            let mut seen = 0;
            for n in 0..10 {
                let (number, _) = placement(&mut random, 56.0, 0.0);
                let h = placed([80.0, 28.0 + beyond], 56.0, 0.0, [0.0; 2]);
                let mut drawing = Drawing::new(SIDE, SIDE, 110.0);
                drawing.tag(Family::default(), number, &h);
                drawing.blur(0.6);
                for tag in found(&mut finder, &drawing, n) {
                    assert!(apart(tag.centre, project(&h, [0.0; 2])) < 0.1);
                    seen += 1;
                }
            }
            assert_eq!(seen, count, "{beyond} px");
        }
    }

    /// Slides things over tags, in pictures that `change` makes of the drawings.
    fn slide(family: Family, name: &str, change: &dyn Fn(&mut Drawing), step: f64) {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut finder = finder(family, 1);
        let (mut frames, mut reported, mut worst) = (0, 0, 0.0_f64);
        // Sides of 36h11's; a module is as wide in every family.
        for side in [20.0, 27.0, 60.0].map(|side| side * family.black() as f64 / 8.0) {
            for shape in ["aligned edge", "edge", "bar", "disc"] {
                for level in [BLACK, 60.0, 0.5 * (BLACK + WHITE), WHITE, 255.0] {
                    let (number, h) = placement_of(family, &mut random, side, 0.1);
                    let centre = project(&h, [0.0; 2]);
                    let turn = match shape {
                        "aligned edge" => h[(1, 0)].atan2(h[(0, 0)]),
                        _ => std::f64::consts::TAU * random.random::<f64>(),
                    };
                    let occluder = Occluder {
                        shape,
                        level,
                        along: [turn.cos(), turn.sin()],
                        reach: 2.0 + 6.0 * random.random::<f64>(),
                    };
                    let mut clean = Drawing::new(SIDE, SIDE, 110.0);
                    clean.tag(family, number, &h);
                    let end = side + 4.0;
                    let mut x = random.random::<f64>() - end;
                    while x < end {
                        let mut drawing = Drawing {
                            levels: clean.levels.clone(),
                            ..clean
                        };
                        occluder.paint(&mut drawing, centre, x);
                        change(&mut drawing);
                        frames += 1;
                        for tag in found_after_all(&mut finder, &drawing, frames) {
                            assert_eq!(tag.number, number);
                            reported += 1;
                            let off = apart(tag.centre, centre);
                            worst = worst.max(off);
                            assert!(
                                off < 0.22,
                                "{name}: {side} px, {shape}, level {level}, {x} px: {off}"
                            );
                        }
                        x += step;
                    }
                }
            }
        }
        println!("{name}: {reported} of {frames} reported, {worst:.3} px at most");
        // Before and after the slide it is seen.
        assert!(reported > frames / 10, "{reported} of {frames}");
    }

    #[test]
    fn a_tag_without_its_white_border_is_refused() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut finder = finder(Family::default(), 1);
        let (number, h) = placement(&mut random, 42.0, 0.0);
        let mut drawing = Drawing::new(SIDE, SIDE, 110.0);
        drawing.tag(Family::default(), number, &h);
        assert_eq!(found(&mut finder, &drawing, 1).len(), 1);
        // Dark up to a sixth of a module from the black square.
        let back = h.try_inverse().unwrap();
        drawing.paint(|u, v| {
            let p = back * nalgebra::Vector3::new(u, v, 1.0);
            let side = (p.x / p.z).abs().max((p.y / p.z).abs());
            (side > 1.04).then_some(60.0)
        });
        assert_eq!(found_after_all(&mut finder, &drawing, 1), []);
    }
}
