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
            if std::env::var_os("DBG").is_some() {
                println!("quad {} {}", quad.id, quad.decision_margin);
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawn::{Drawing, placed};
    use rand::RngExt;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    fn finder(width: usize, height: usize, coarse: usize) -> TagFinder {
        TagFinder::new(&Templates::new().unwrap(), width, height, coarse).unwrap()
    }

    fn found(finder: &mut TagFinder, pixels: &[u8], width: usize, height: usize) -> Vec<Tag> {
        let image = Grey::new(pixels, width, height, width).unwrap();
        finder.find(&image).unwrap()
    }

    #[test]
    fn experiment() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for coarse in [1, 2] {
            for (side, blur) in [
                (16.0, 0.6),
                (20.0, 0.6),
                (24.0, 0.6),
                (27.0, 0.6),
                (27.0, 1.0),
                (27.0, 1.5),
                (42.0, 0.6),
                (42.0, 1.5),
                (42.0, 2.5),
                (80.0, 0.6),
            ] {
                let mut finder = finder(160, 160, coarse);
                let (mut n, mut sum, mut corner, mut worst) = (0, 0.0, 0.0, 0.0f64);
                for k in 0..100 {
                    let mut unit = || random.random::<f64>();
                    let at = [70.0 + 20.0 * unit(), 70.0 + 20.0 * unit()];
                    let turn = 6.3 * unit();
                    let tilt = [0.3 * unit() - 0.15, 0.3 * unit() - 0.15];
                    let h = placed(at, side, turn, tilt);
                    let mut drawing = Drawing::new(160, 160, 120.0);
                    drawing.tag(k, &h);
                    drawing.blur(blur);
                    let pixels = drawing.pixels(3.0, k as u64);
                    for tag in super::tests::found(&mut finder, &pixels, 160, 160) {
                        assert_eq!(tag.number, k as u32);
                        n += 1;
                        let e = (tag.centre[0] - at[0]).hypot(tag.centre[1] - at[1]);
                        sum += e * e;
                        worst = worst.max(e);
                        for (c, xy) in tag.corners.iter().zip([
                            [-1.0, -1.0],
                            [1.0, -1.0],
                            [1.0, 1.0],
                            [-1.0, 1.0],
                        ]) {
                            let p = project(&h, xy);
                            corner += (c[0] - p[0]).powi(2) + (c[1] - p[1]).powi(2);
                        }
                    }
                }
                println!(
                    "coarse {coarse} side {side} blur {blur}: {n} found, centre {:.3} px, worst {worst:.3}, corner {:.3}",
                    (sum / n as f64).sqrt(),
                    (corner / n as f64 / 4.0).sqrt()
                );
            }
        }
    }
}
#[cfg(test)]
mod timing {
    use super::*;
    use crate::drawn::{Drawing, placed};
    #[test]
    fn timing() {
        for threads in [0, 1] {
            std::thread::spawn(move || {
                let _pool = (threads == 1).then(|| {
                    rayon::ThreadPoolBuilder::new()
                        .num_threads(1)
                        .use_current_thread()
                        .build()
                        .unwrap()
                });
                let t = Templates::new().unwrap();
                let mut drawing = Drawing::new(640, 480, 120.0);
                for (n, at) in [
                    [200.0, 150.0],
                    [400.0, 160.0],
                    [390.0, 300.0],
                    [210.0, 310.0],
                ]
                .into_iter()
                .enumerate()
                {
                    drawing.tag(n, &placed(at, 42.0, 0.3, [0.1, -0.1]));
                }
                drawing.blur(0.7);
                let pixels = drawing.pixels(2.0, 1);
                let image = Grey::new(&pixels, 640, 480, 640).unwrap();
                for (c, w) in [(1, 640), (2, 640), (1, 128), (2, 128)] {
                    let image = if w == 640 {
                        image
                    } else {
                        image.part(136..264, 86..214)
                    };
                    let mut f = TagFinder::new(&t, image.width(), image.height(), c).unwrap();
                    let mut times = Vec::new();
                    for _ in 0..200 {
                        let t = std::time::Instant::now();
                        let n = f.find(&image).unwrap().len();
                        assert_eq!(n, if w == 640 { 4 } else { 1 });
                        times.push(t.elapsed().as_micros());
                    }
                    times.sort();
                    println!(
                        "threads {threads} coarse {c} width {w}: p50 {} p99 {} us",
                        times[100], times[198]
                    );
                }
                let (_, us) = {
                    let mut f = TagFinder::new(&t, 640, 480, 1).unwrap();
                    f.image = Image::new(f.image.size(), pixels.clone()).unwrap();
                    f.decoder.decode_timed(&f.image).unwrap()
                };
                println!("{us:?}");
                // registration alone
                let h = placed([200.0, 150.0], 42.3, 0.301, [0.1, -0.1]);
                let t0 = std::time::Instant::now();
                for _ in 0..200 {
                    std::hint::black_box(register(&image, &t.0[0], &h).unwrap());
                }
                println!("register {} us", t0.elapsed().as_micros() as f64 / 200.0);
            })
            .join()
            .unwrap();
        }
    }
}
#[cfg(test)]
mod slide {
    use super::*;
    use crate::drawn::{Drawing, placed};
    use rand::RngExt;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn slide() {
        let t = Templates::new().unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(5);
        const W: usize = 128;
        let mut finder = TagFinder::new(&t, W, W, 1).unwrap();
        for side in [20.0, 27.0, 42.0, 70.0] {
            for shape in ["edge", "aligned", "bar", "disc"] {
                for level in [200.0, 255.0, 30.0, 0.0, 60.0, 115.0, 160.0] {
                    let (mut worst, mut shown, mut n, mut wc) = (0.0f64, 0, 0, 0.0f64);
                    let mut touched = 0;
                    for k in 0..6 {
                        let mut unit = || random.random::<f64>();
                        let at = [60.0 + 5.0 * unit(), 60.0 + 5.0 * unit()];
                        let turn = 6.3 * unit();
                        let h = placed(at, side, turn, [0.2 * unit() - 0.1, 0.2 * unit() - 0.1]);
                        let number = (587.0 * unit()) as usize;
                        let (s, c) = if shape == "aligned" {
                            turn
                        } else {
                            6.3 * unit()
                        }
                        .sin_cos();
                        let width = 2.0 + 8.0 * unit();
                        let lateral = (unit() - 0.5) * side;
                        let mut clean = Drawing::new(W, W, 110.0);
                        clean.tag(number, &h);
                        let reach = 0.5 * side * 1.25 + 3.0;
                        let mut x = -reach * 1.3;
                        while x < reach * 1.3 {
                            let mut d = Drawing {
                                width: W,
                                height: W,
                                levels: clean.levels.clone(),
                            };
                            let covers = |u: f64, v: f64| {
                                let (a, b) = (
                                    (u - at[0]) * c + (v - at[1]) * s,
                                    -(u - at[0]) * s + (v - at[1]) * c - lateral,
                                );
                                match shape {
                                    "bar" => (a - x).abs() < width / 2.0,
                                    "disc" => (a - x).hypot(b) < width,
                                    _ => a < x,
                                }
                            };
                            d.paint(|u, v| covers(u, v).then_some(level));
                            d.blur(0.6);
                            let pixels = d.pixels(2.0, k);
                            n += 1;
                            for tag in finder.find(&Grey::new(&pixels, W, W, W).unwrap()).unwrap() {
                                assert_eq!(tag.number, number as u32);
                                shown += 1;
                                worst =
                                    worst.max((tag.centre[0] - at[0]).hypot(tag.centre[1] - at[1]));
                                for (p, q) in tag.corners.iter().zip([
                                    [-1.0, -1.0],
                                    [1.0, -1.0],
                                    [1.0, 1.0],
                                    [-1.0, 1.0],
                                ]) {
                                    let q = project(&h, q);
                                    wc = wc.max((p[0] - q[0]).hypot(p[1] - q[1]));
                                }
                                // Black square touched?
                                let mut any = false;
                                for i in 0..41 {
                                    for j in 0..41 {
                                        let p = project(
                                            &h,
                                            [i as f64 / 20.0 - 1.0, j as f64 / 20.0 - 1.0],
                                        );
                                        any |= covers(p[0], p[1]);
                                    }
                                }
                                touched += any as u32;
                            }
                            x += 0.5;
                        }
                    }
                    println!(
                        "side {side} {shape} level {level}: {shown} of {n} reported, {touched} of them covered a bit, centre worst {worst:.3} corner worst {wc:.3}"
                    );
                }
            }
        }
    }
}
