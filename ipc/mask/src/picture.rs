//! Masks as PNG files.

use std::fs::File;
use std::io::{BufWriter, Cursor};
use std::path::Path;

use png::{BitDepth, ColorType, Decoder, Encoder, Transformations};

use crate::{MAX_AREAS, Mask};

/// Most pixels of a mask: more would take a second and hundreds of megabytes.
pub const MOST_PIXELS: usize = 4096 * 4096;

/// Why an image cannot be a mask.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum MaskError {
    #[error("cannot read it: {0}")]
    Read(std::io::Error),
    #[error("not a PNG image: {0}")]
    Decode(#[from] png::DecodingError),
    #[error("the image is {0}x{1} px; allowed: {2}x{3}, the size of the camera's image")]
    Size(u32, u32, u32, u32),
    #[error("the image is {0}x{1} px; allowed: up to {MOST_PIXELS} px, for instance 4096x4096")]
    Large(u32, u32),
    #[error("pixel ({0}, {1}) is coloured, {2:?}; allowed: white, black and greys between")]
    Coloured(usize, usize, [u8; 3]),
    #[error("pixel ({0}, {1}) is transparent; allowed: opaque pixels")]
    Transparent(usize, usize),
    #[error("every pixel is black; allowed: white where no feature may be, black elsewhere")]
    AllFree,
    #[error("every pixel is white; allowed: white where no feature may be, black elsewhere")]
    AllForbidden,
    #[error(
        "{0} separate white areas, the smallest of {1} px; allowed: at most {MAX_AREAS} in a scene: paint over the \
         specks, or join areas that lie close together"
    )]
    Separate(usize, usize),
}

impl Mask {
    /// Decodes a PNG image of the camera's size: white is forbidden, black free, the threshold at
    /// half.
    ///
    /// # Errors
    /// [`MaskError`] names what was found in the image and what is allowed.
    pub fn decode(bytes: &[u8], width: u32, height: u32) -> Result<Self, MaskError> {
        let mut decoder = Decoder::new(Cursor::new(bytes));
        // Palettes and 1, 2, 4 and 16 bits become 8 bits a channel.
        decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
        let mut reader = decoder.read_info()?;
        let (w, h) = reader.info().size();
        if (w, h) != (width, height) {
            return Err(MaskError::Size(w, h, width, height));
        }
        if w as usize * h as usize > MOST_PIXELS {
            return Err(MaskError::Large(w, h));
        }
        let channels = reader.output_color_type().0.samples();
        let mut bytes = vec![0; channels * w as usize * h as usize];
        reader.next_frame(&mut bytes)?;
        let pixel = |(n, pixel): (usize, &[u8])| {
            let (i, j) = (n % w as usize, n / w as usize);
            match *pixel {
                [r, g, b, ..] if r != g || g != b => Err(MaskError::Coloured(i, j, [r, g, b])),
                [_, alpha] | [_, _, _, alpha] if alpha < 255 => Err(MaskError::Transparent(i, j)),
                _ => Ok(u8::from(pixel[0] >= 128)),
            }
        };
        let pixels: Result<Vec<u8>, _> = bytes
            .chunks_exact(channels)
            .enumerate()
            .map(pixel)
            .collect();
        Self::of(w as usize, h as usize, pixels?)
    }
}

/// Writes a mask as a PNG file: white where `is_forbidden(column, row)`, black elsewhere.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_mask(
    path: &Path,
    width: u32,
    height: u32,
    is_forbidden: impl Fn(u32, u32) -> bool,
) -> std::io::Result<()> {
    let pixels: Vec<u8> = (0..height)
        .flat_map(|row| (0..width).map(move |column| (column, row)))
        .map(|(column, row)| if is_forbidden(column, row) { 255 } else { 0 })
        .collect();
    let mut encoder = Encoder::new(BufWriter::new(File::create(path)?), width, height);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_huge_mask_is_refused_before_it_is_decoded() {
        // A head alone: reading on would fail in other words.
        let mut png = Vec::new();
        let mut encoder = Encoder::new(&mut png, 16384, 16384);
        encoder.set_color(ColorType::Grayscale);
        let writer = encoder.write_header().unwrap();
        std::mem::forget(writer);
        // The decoder wants to see data begin.
        png.extend([0, 0, 0, 16, b'I', b'D', b'A', b'T']);
        let refused = Mask::decode(&png, 16384, 16384).unwrap_err().to_string();
        let words = "16384x16384 px; allowed: up to 16777216 px, for instance 4096x4096";
        assert!(refused.contains(words), "{refused}");
    }
}
