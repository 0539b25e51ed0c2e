//! A photo, over which a drawing can lie.

use resvg::tiny_skia::{Pixmap, PremultipliedColorU8};

/// Levels that one shade of the drawing stands for: the noise of a camera takes fewer bytes so.
const SHADE: u8 = 8;

/// An image in grey.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Photo {
    /// Pixels in a row.
    pub width: usize,
    /// Levels, row by row.
    pub levels: Vec<u8>,
}

impl Photo {
    /// Fills a picture: each of its pixels gets the mean of those of the photo that it covers.
    pub(crate) fn fill(&self, picture: &mut Pixmap) {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let rows = self.levels.len() / self.width.max(1);
        let covered = |at: usize, count: usize, side: usize| {
            let from = (at * side / count).min(side.saturating_sub(1));
            from..((at + 1) * side / count).clamp(from + 1, side.max(1))
        };
        for (k, pixel) in picture.pixels_mut().iter_mut().enumerate() {
            let columns = covered(k % width, width, self.width);
            let rows = covered(k / width, height, rows);
            let near = rows.flat_map(|row| columns.clone().map(move |c| row * self.width + c));
            let (mut sum, mut count) = (0, 0);
            for level in near.filter_map(|k| self.levels.get(k)) {
                (sum, count) = (sum + u32::from(*level), count + 1);
            }
            let mean = (sum / count.max(1)) as u8;
            let shade = mean / SHADE * SHADE + SHADE / 2;
            if let Some(grey) = PremultipliedColorU8::from_rgba(shade, shade, shade, u8::MAX) {
                *pixel = grey;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_photo_shrinks_by_its_means() {
        let photo = Photo {
            width: 4,
            levels: vec![10, 30, 200, 200, 10, 30, 200, 216],
        };
        let mut picture = Pixmap::new(2, 1).unwrap();
        photo.fill(&mut picture);
        let shades: Vec<u8> = picture.pixels().iter().map(|pixel| pixel.red()).collect();
        assert_eq!(shades, [20, 204]);
    }
}
