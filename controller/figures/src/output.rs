//! A canvas as files.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

use crate::Canvas;

/// Pixels of the PNG for one px of the drawing.
const SCALE: f32 = 2.0;

/// Why a figure was not written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum FigureError {
    #[error("{path}: cannot write the figure: {source}")]
    Write {
        path: String,
        source: std::io::Error,
    },
    /// The drawing could not be made into pixels.
    #[error("{path}: cannot draw the figure: {reason}")]
    Draw { path: String, reason: String },
}

impl Canvas {
    /// Writes `path`.svg and `path`.png and returns both paths.
    ///
    /// # Errors
    /// [`FigureError`] names the file.
    pub fn write(&self, path: &Path) -> Result<[PathBuf; 2], FigureError> {
        let files = [with(path, ".svg"), with(path, ".png")];
        let svg = self.svg();
        save(&files[0], svg.as_bytes())?;
        let png = png(self).map_err(|reason| FigureError::Draw {
            path: files[1].display().to_string(),
            reason,
        })?;
        save(&files[1], &png)?;
        Ok(files)
    }
}

/// The path with an ending more: a point in its name is no ending.
pub(crate) fn with(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

fn png(canvas: &Canvas) -> Result<Vec<u8>, String> {
    pixels(canvas, SCALE)?
        .encode_png()
        .map_err(|e| e.to_string())
}

/// A drawing as pixels, `scale` of them for one px.
pub(crate) fn pixels(canvas: &Canvas, scale: f32) -> Result<Pixmap, String> {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    let options = Options {
        font_family: "DejaVu Sans".to_owned(),
        fontdb: Arc::new(fonts),
        ..Options::default()
    };
    let tree = Tree::from_str(&canvas.svg(), &options).map_err(|e| e.to_string())?;
    let size = tree.size().to_int_size().scale_by(scale).ok_or("no size")?;
    let mut pixels = Pixmap::new(size.width(), size.height()).ok_or("no pixels")?;
    if let Some(photo) = canvas.photo() {
        photo.fill(&mut pixels);
    }
    resvg::render(
        &tree,
        Transform::from_scale(scale, scale),
        &mut pixels.as_mut(),
    );
    Ok(pixels)
}

/// Writes a file, and makes its directory first.
pub(crate) fn save(file: &Path, bytes: &[u8]) -> Result<(), FigureError> {
    let directory = file.parent().map_or(Ok(()), fs::create_dir_all);
    directory
        .and_then(|()| fs::write(file, bytes))
        .map_err(|source| FigureError::Write {
            path: file.display().to_string(),
            source,
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_canvas_becomes_the_same_svg_and_png_each_time() {
        let mut canvas = Canvas::new(100.0, 50.0);
        canvas.text(50.0, 25.0, 10.0, "middle", "a < b & c");
        let directory = std::env::temp_dir().join(format!("figures-{}", std::process::id()));
        let [svg, image] = canvas.write(&directory.join("one")).unwrap();
        assert!(
            fs::read_to_string(svg)
                .unwrap()
                .contains("a &lt; b &amp; c")
        );
        let bytes = fs::read(image).unwrap();
        assert_eq!(&bytes[1..4], b"PNG");
        assert_eq!(bytes[16..24], [0, 0, 0, 200, 0, 0, 0, 100]);
        assert_eq!(bytes, png(&canvas).unwrap());
        // The font is there: without it the picture would be white.
        let blank = png(&Canvas::new(100.0, 50.0)).unwrap();
        assert_ne!(bytes, blank);
        fs::remove_dir_all(directory).unwrap();
    }
}
