//! Files of single images: PNG and PGM.

use std::io::BufReader;
use std::path::Path;

use png::{ColorType, Decoder, Transformations};

use super::super::{SourceError, luma};
use super::is_named;

/// Most pixels in a row, and most rows: those of `vpc/image`.
pub(super) const MOST_SIDE: u32 = 8192;
/// Largest PGM file, bytes: its pixels and a head.
const MOST_PGM: u64 = (MOST_SIDE as u64).pow(2) + (64 << 10);

/// A grey image with its name; rows follow each other without a gap.
#[derive(Debug, Default)]
pub(super) struct Picture {
    pub name: String,
    pub size: [u32; 2],
    pub pixels: Vec<u8>,
}

impl Picture {
    /// Reads a file. Colours become the luma of Rec. 601, 16 bits their upper 8; alpha is left out.
    pub fn read(path: &Path) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        match is_named(path, &["pgm"]) {
            true => Self::read_pgm(path, name),
            false => Self::read_png(path, name),
        }
    }

    fn read_png(path: &Path, name: String) -> Result<Self, SourceError> {
        let refuse = |error: png::DecodingError| SourceError::value(&name, error, "a PNG file");
        let file =
            toml_schema::open_file(path).map_err(|error| SourceError::system(&name, error))?;
        let mut decoder = Decoder::new(BufReader::new(file));
        // Palettes and 16 bits become 8 bits a channel.
        decoder.set_transformations(Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().map_err(refuse)?;
        let (width, height) = (reader.info().width, reader.info().height);
        check_size(&name, [width, height])?;
        let Some(bytes) = reader.output_buffer_size() else {
            return Err(SourceError::value(&name, "too large", "8192x8192 px"));
        };
        let mut pixels = vec![0; bytes];
        let frame = reader.next_frame(&mut pixels).map_err(refuse)?;
        pixels.truncate(frame.buffer_size());
        let grey = |p: &[u8]| luma(p[0], p[1], p[2]);
        let pixels = match frame.color_type {
            ColorType::Grayscale => pixels,
            ColorType::GrayscaleAlpha => pixels.chunks_exact(2).map(|pixel| pixel[0]).collect(),
            ColorType::Rgb => pixels.chunks_exact(3).map(grey).collect(),
            ColorType::Rgba => pixels.chunks_exact(4).map(grey).collect(),
            ColorType::Indexed => {
                return Err(SourceError::value(&name, "a palette", "grey or colours"));
            }
        };
        Ok(Self {
            name,
            size: [width, height],
            pixels,
        })
    }

    fn read_pgm(path: &Path, name: String) -> Result<Self, SourceError> {
        let read = toml_schema::read_bytes(path, MOST_PGM);
        let bytes = read.map_err(|error| SourceError::system(&name, error))?;
        let refuse = |found: String, allowed: &str| SourceError::value(&name, found, allowed);
        let Some(([width, height, white], mut pixels)) = pgm_header(&bytes) else {
            let found = "no header of a PGM file".to_owned();
            return Err(refuse(found, "P5, width, height and 255"));
        };
        if white != 255 {
            let found = format!("levels of 0 to {white}");
            return Err(refuse(found, "0 to 255: 8 bits"));
        }
        let size = [width, height];
        check_size(&name, size)?;
        let needed = width as usize * height as usize;
        if pixels.len() < needed {
            let found = format!("{} bytes of pixels", pixels.len());
            return Err(refuse(found, &format!("{needed}: {width}x{height}")));
        }
        pixels = &pixels[..needed];
        let pixels = pixels.to_vec();
        Ok(Self { name, size, pixels })
    }
}

pub(super) fn check_size(name: &str, [width, height]: [u32; 2]) -> Result<(), SourceError> {
    let allowed = 1..=MOST_SIDE;
    if allowed.contains(&width) && allowed.contains(&height) {
        return Ok(());
    }
    let found = format!("an image of {width}x{height} px");
    let allowed = format!("1 to {MOST_SIDE} px a side");
    Err(SourceError::value(name, found, allowed))
}

/// Width, height and the level of white of a binary PGM, and its pixels.
fn pgm_header(bytes: &[u8]) -> Option<([u32; 3], &[u8])> {
    let mut rest = bytes.strip_prefix(b"P5")?;
    let mut numbers = [0; 3];
    for number in &mut numbers {
        rest = after_space(rest)?;
        let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let (text, others) = rest.split_at(digits);
        *number = std::str::from_utf8(text).ok()?.parse().ok()?;
        rest = others;
    }
    let (space, pixels) = rest.split_first()?;
    space.is_ascii_whitespace().then_some((numbers, pixels))
}

/// What follows white space and comments; `None` without any of them.
fn after_space(bytes: &[u8]) -> Option<&[u8]> {
    let mut rest = bytes;
    loop {
        match rest {
            [space, after @ ..] if space.is_ascii_whitespace() => rest = after,
            [b'#', after @ ..] => {
                let line = after.iter().take_while(|byte| **byte != b'\n').count();
                rest = &after[line..];
            }
            _ => return (rest.len() < bytes.len()).then_some(rest),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, bytes: &[u8]) -> Result<Picture, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        Picture::read(&path).map_err(|error| error.to_string())
    }

    fn png(color: ColorType, depth: png::BitDepth, data: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, 2, 1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(vec![0, 0, 0, 255, 0, 0]);
        }
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(data).unwrap();
        writer.finish().unwrap();
        file
    }

    #[test]
    fn every_kind_of_png_becomes_grey() {
        use png::BitDepth::{Eight, One, Sixteen};
        let red = (255.0_f64 * 0.299).round() as u8;
        for (color, depth, data, grey) in [
            (ColorType::Grayscale, Eight, vec![7, 200], [7, 200]),
            (ColorType::Grayscale, Sixteen, vec![7, 9, 200, 1], [7, 200]),
            (ColorType::Grayscale, One, vec![0b0100_0000], [0, 255]),
            (
                ColorType::GrayscaleAlpha,
                Eight,
                vec![7, 0, 200, 255],
                [7, 200],
            ),
            (ColorType::Rgb, Eight, vec![255, 0, 0, 9, 9, 9], [red, 9]),
            (
                ColorType::Rgba,
                Eight,
                vec![255, 0, 0, 0, 9, 9, 9, 1],
                [red, 9],
            ),
            (ColorType::Indexed, Eight, vec![1, 0], [red, 0]),
        ] {
            let picture = read("a.png", &png(color, depth, &data)).unwrap();
            assert_eq!(
                (picture.size, picture.pixels),
                ([2, 1], grey.to_vec()),
                "{color:?}"
            );
        }
    }

    #[test]
    fn pgm_is_read_with_comments_and_refused_by_name() {
        let picture = read("a.pgm", b"P5 # made\n# by hand\n2\t1\n255\n\x0a\x20").unwrap();
        assert_eq!((picture.size, picture.pixels), ([2, 1], vec![10, 32]));
        for (file, said) in [
            (
                b"P5 2 1 65535 \0\0\0\0".as_slice(),
                "levels of 0 to 65535; allowed: 0 to 255: 8 bits",
            ),
            (
                b"P2 2 1 255 1 2",
                "no header of a PGM file; allowed: P5, width, height and 255",
            ),
            (b"P5 2 1 255 \0", "1 bytes of pixels; allowed: 2: 2x1"),
            (
                b"P5 0 1 255 ",
                "an image of 0x1 px; allowed: 1 to 8192 px a side",
            ),
            (b"P5 9000 1 255 ", "an image of 9000x1 px"),
            (b"P5 2", "no header"),
            (b"", "no header"),
        ] {
            let error = read("a.pgm", file).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
        let error = read("a.png", b"P5 2 1 255 \0\0").unwrap_err();
        assert!(
            error.contains("a.png: ") && error.contains("a PNG file"),
            "{error}"
        );
    }
}
