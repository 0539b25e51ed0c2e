use std::path::{Path, PathBuf};

use gif::{DisposalMethod, Encoder, Frame, Repeat};

use crate::output::{pixels, save, with};
use crate::{Canvas, FigureError};

/// Drawings of one size that follow each other, again and again.
#[derive(Clone, Debug)]
pub struct Animation {
    /// The drawings in their order, all of one size.
    pub frames: Vec<Canvas>,
    /// Time from one to the next, s.
    pub period_s: f64,
    /// How long the last one stands, s.
    pub last_s: f64,
}

impl Animation {
    /// Writes `path`.gif.
    ///
    /// # Errors
    /// [`FigureError`] names the file.
    pub fn write(&self, path: &Path) -> Result<PathBuf, FigureError> {
        let path = with(path, ".gif");
        let bytes = self.gif().map_err(|reason| FigureError::Draw {
            path: path.display().to_string(),
            reason,
        })?;
        save(&path, &bytes)?;
        Ok(path)
    }

    fn gif(&self) -> Result<Vec<u8>, String> {
        let (width, height) = self.frames.first().ok_or("no frames")?.size();
        let (width, height) = (width.ceil() as u16, height.ceil() as u16);
        let mut bytes = Vec::new();
        let mut gif = Encoder::new(&mut bytes, width, height, &[]).map_err(|e| e.to_string())?;
        let endless = gif.set_repeat(Repeat::Infinite);
        endless.map_err(|e| e.to_string())?;
        let mut before = Vec::new();
        for (index, canvas) in self.frames.iter().enumerate() {
            let now = pixels(canvas, 1.0)?;
            // What has not changed is left to the frame before, which compresses well.
            let mut changed = now.data().to_vec();
            let pairs = changed.chunks_exact_mut(4).zip(before.chunks_exact(4));
            pairs
                .filter(|(now, before)| now == before)
                .for_each(|(now, _)| now.fill(0));
            let (w, h) = (now.width() as u16, now.height() as u16);
            let mut frame = Frame::from_rgba_speed(w, h, &mut changed, 1);
            frame.dispose = DisposalMethod::Keep;
            let is_last = index + 1 == self.frames.len();
            let seconds = if is_last { self.last_s } else { self.period_s };
            // Hundredths of a second.
            frame.delay = (100.0 * seconds).round() as u16;
            gif.write_frame(&frame).map_err(|e| e.to_string())?;
            before = now.data().to_vec();
        }
        drop(gif);
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_holds_only_what_has_changed() {
        let frame = |x: f64| {
            let mut canvas = Canvas::new(60.0, 40.0);
            canvas.circle([x, 20.0], 5.0, "fill=\"#1f4fd8\"");
            canvas
        };
        let animation = Animation {
            frames: vec![frame(20.0), frame(40.0)],
            period_s: 0.1,
            last_s: 2.0,
        };
        let bytes = animation.gif().unwrap();
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&bytes[..]).unwrap();
        let first = decoder.read_next_frame().unwrap().unwrap().clone();
        let second = decoder.read_next_frame().unwrap().unwrap().clone();
        assert!(decoder.read_next_frame().unwrap().is_none());
        assert_eq!((first.delay, second.delay), (10, 200));
        let pixel = |frame: &Frame, x: usize| frame.buffer[4 * (20 * 60 + x)..][..4].to_vec();
        assert_eq!(pixel(&first, 20), [0x1f, 0x4f, 0xd8, 255]);
        assert_eq!(pixel(&second, 20), [255; 4]);
        assert_eq!(pixel(&second, 40), [0x1f, 0x4f, 0xd8, 255]);
        // Nothing was there, and nothing is.
        assert_eq!((pixel(&first, 5), pixel(&second, 5)[3]), (vec![255; 4], 0));
    }
}
