//! Masks as PNG files.

use std::fs::File;
use std::io::{BufWriter, Cursor};
use std::path::Path;

use png::{BitDepth, ColorType, Decoder, Encoder, Transformations};

use super::area::AreaError;
use crate::mask::Mask;

/// Why a file is no mask.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MaskError {
    #[error("cannot read it: {0}")]
    Read(std::io::Error),
    #[error("not a PNG image: {0}")]
    Decode(png::DecodingError),
    #[error("the image is {0}x{1} px; allowed: {2}x{3}, the size of the camera's image")]
    Size(u32, u32, u32, u32),
    #[error("pixel ({0}, {1}) is coloured, {2:?}; allowed: white, black and greys between")]
    Coloured(usize, usize, [u8; 3]),
    #[error("pixel ({0}, {1}) is transparent; allowed: opaque pixels")]
    Transparent(usize, usize),
    #[error(transparent)]
    Areas(AreaError),
}

/// The mask of the size `width` x `height` in a PNG file: white is forbidden, black free, the threshold at half.
pub(crate) fn decode(bytes: &[u8], width: u32, height: u32) -> Result<Mask, MaskError> {
    let mut decoder = Decoder::new(Cursor::new(bytes));
    // Palettes and 1, 2, 4 and 16 bits become 8 bits a channel.
    decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(MaskError::Decode)?;
    let (w, h) = reader.info().size();
    if (w, h) != (width, height) {
        return Err(MaskError::Size(w, h, width, height));
    }
    let channels = reader.output_color_type().0.samples();
    let mut bytes = vec![0; channels * w as usize * h as usize];
    reader.next_frame(&mut bytes).map_err(MaskError::Decode)?;
    let pixels = bytes
        .chunks_exact(channels)
        .enumerate()
        .map(|(n, pixel)| {
            let (i, j) = (n % w as usize, n / w as usize);
            let (grey, alpha) = match *pixel {
                [grey] => (grey, 255),
                [grey, alpha] => (grey, alpha),
                [r, g, b] | [r, g, b, _] if r != g || g != b => {
                    return Err(MaskError::Coloured(i, j, [r, g, b]));
                }
                [grey, _, _] => (grey, 255),
                [grey, _, _, alpha] => (grey, alpha),
                _ => (0, 0),
            };
            if alpha == 255 {
                Ok(u8::from(grey >= 128))
            } else {
                Err(MaskError::Transparent(i, j))
            }
        })
        .collect::<Result<Vec<u8>, MaskError>>()?;
    Mask::of(w as usize, h as usize, &pixels).map_err(MaskError::Areas)
}

/// Writes a mask that a scene may name: `is_forbidden` tells of each pixel, by column and row, whether it is white.
///
/// # Errors
/// The operating system's, where the file cannot be written.
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
