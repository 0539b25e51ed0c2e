//! Grey images and their files (PNG).

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use png::{BitDepth, ColorType, Transformations};
use vpc_camera::grey::Grey;

/// A grey image, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width and height, px.
    pub size: [u32; 2],
    /// Its pixels.
    pub pixels: Vec<u8>,
}

/// A file or a folder of images that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct PictureError {
    /// The file or folder.
    pub path: String,
    /// Why.
    pub reason: String,
}

impl PictureError {
    fn new(path: &Path, reason: impl ToString) -> Self {
        Self {
            path: path.display().to_string(),
            reason: reason.to_string(),
        }
    }
}

impl Picture {
    /// A copy of an image.
    pub fn of(image: &Grey) -> Self {
        let rows = (0..image.height()).map(|row| image.row(row));
        Self {
            size: [image.width(), image.height()].map(|side| side as u32),
            pixels: rows.collect::<Vec<_>>().concat(),
        }
    }

    /// As the finder of tags takes it; `None` if it is empty.
    pub fn grey(&self) -> Option<Grey<'_>> {
        let [width, height] = self.size.map(|side| side as usize);
        Grey::new(&self.pixels, width, height, width)
    }

    /// Reads a PNG of 8 or 16 bits, grey or colour.
    ///
    /// # Errors
    /// [`PictureError`]: the file cannot be read, or is no such image.
    pub fn read(path: &Path) -> Result<Self, PictureError> {
        let refuse = |reason: &dyn ToString| PictureError::new(path, reason.to_string());
        let file = toml_schema::open_file(path).map_err(|error| refuse(&error))?;
        let mut decoder = png::Decoder::new(BufReader::new(file));
        decoder.set_transformations(Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().map_err(|error| refuse(&error))?;
        let bytes = reader.output_buffer_size();
        let mut buffer = vec![0; bytes.ok_or_else(|| refuse(&"too large"))?];
        let info = reader
            .next_frame(&mut buffer)
            .map_err(|error| refuse(&error))?;
        let buffer = &buffer[..info.buffer_size()];
        let luma = |p: &[u8]| {
            // ITU-R BT.601, as OpenCV.
            let sum = 77 * u32::from(p[0]) + 150 * u32::from(p[1]) + 29 * u32::from(p[2]);
            ((sum + 128) >> 8) as u8
        };
        let pixels = match info.color_type {
            ColorType::Grayscale => buffer.to_vec(),
            ColorType::GrayscaleAlpha => buffer.iter().step_by(2).copied().collect(),
            ColorType::Rgb => buffer.chunks_exact(3).map(luma).collect(),
            ColorType::Rgba => buffer.chunks_exact(4).map(luma).collect(),
            ColorType::Indexed => return Err(refuse(&"indexed colours; allowed: grey or RGB")),
        };
        Ok(Self {
            size: [info.width, info.height],
            pixels,
        })
    }

    /// Writes a new PNG.
    ///
    /// # Errors
    /// [`PictureError`]: the file exists, or cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), PictureError> {
        let refuse = |reason: &dyn ToString| PictureError::new(path, reason.to_string());
        let file = File::create_new(path).map_err(|error| refuse(&error))?;
        let mut encoder = png::Encoder::new(file, self.size[0], self.size[1]);
        encoder.set_color(ColorType::Grayscale);
        encoder.set_depth(BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(|error| refuse(&error))?;
        writer
            .write_image_data(&self.pixels)
            .and_then(|()| writer.finish())
            .map_err(|error| refuse(&error))
    }
}

/// The images (`.png`) of a folder, by their names.
///
/// # Errors
/// [`PictureError`]: the folder cannot be read, or has none.
pub fn folder(path: &Path) -> Result<Vec<PathBuf>, PictureError> {
    let refuse = |reason: &dyn ToString| PictureError::new(path, reason.to_string());
    let entries = std::fs::read_dir(path).map_err(|error| refuse(&error))?;
    let files: Result<Vec<PathBuf>, _> = entries
        .map(|entry| entry.map(|entry| entry.path()))
        .collect();
    let mut files = files.map_err(|error| refuse(&error))?;
    let is_image = |file: &PathBuf| {
        file.extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("png"))
    };
    files.retain(is_image);
    files.sort();
    match files.is_empty() {
        true => Err(refuse(
            &"no images; allowed: a folder with files that end in .png",
        )),
        false => Ok(files),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_and_nothing_is_overwritten() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.png");
        let picture = Picture {
            size: [3, 2],
            pixels: vec![0, 50, 100, 150, 200, 255],
        };
        picture.write(&path).unwrap();
        assert_eq!(Picture::read(&path).unwrap(), picture);
        assert_eq!(folder(place.path()).unwrap(), std::slice::from_ref(&path));
        let error = picture.write(&path).unwrap_err().to_string();
        assert!(error.contains("a.png: File exists"), "{error}");
    }

    #[test]
    fn colours_become_grey() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.png");
        let mut encoder = png::Encoder::new(File::create(&path).unwrap(), 3, 1);
        encoder.set_color(ColorType::Rgb);
        let mut writer = encoder.write_header().unwrap();
        writer
            .write_image_data(&[255, 0, 0, 0, 255, 0, 255, 255, 255])
            .unwrap();
        writer.finish().unwrap();
        assert_eq!(Picture::read(&path).unwrap().pixels, [77, 149, 255]);
    }

    #[test]
    fn what_is_no_image_is_refused_by_name() {
        let place = tempfile::tempdir().unwrap();
        let said = |error: PictureError| error.to_string();
        assert!(said(folder(place.path()).unwrap_err()).contains("no images"));
        assert!(said(folder(&place.path().join("none")).unwrap_err()).contains("No such file"));
        let path = place.path().join("a.png");
        std::fs::write(&path, "no image").unwrap();
        assert!(said(Picture::read(&path).unwrap_err()).starts_with(&path.display().to_string()));
    }
}
