//! Images of another process, by `vpc/image`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{Domain, Image, ImageSubscriber, ReceiveError};
use messages::{Encoding, Order};

use super::{Frame, Next, Source, SourceError, luma};
use crate::grey::Grey;

/// Looks before the caller is told that there is nothing.
const LOOKS: u32 = 50;

/// Images that another process publishes in a domain.
#[derive(Debug)]
pub struct SharedMemory {
    images: ImageSubscriber,
    /// Between two looks: there is no event to wait for.
    pause: Duration,
    /// The image that the last frame is in.
    held: Option<Image>,
    /// The grey levels of a colour image.
    grey: Vec<u8>,
}

impl SharedMemory {
    /// Subscribes, to look this often.
    ///
    /// # Errors
    /// The service has all the subscribers that it takes.
    pub fn open(domain: &Domain, pause: Duration) -> Result<Self, SourceError> {
        Ok(Self {
            images: domain.image_subscriber()?,
            pause,
            held: None,
            grey: Vec::new(),
        })
    }

    /// The newest image that was not seen before.
    fn newest(&mut self) -> Result<Option<Image>, SourceError> {
        match self.images.latest() {
            Ok(image) => Ok(image.filter(|image| image.order() != Order::Repeated)),
            Err(ReceiveError::Invalid { invalid, .. }) => {
                tracing::warn!("an image is refused: {invalid}");
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }
}

impl Source for SharedMemory {
    fn next(&mut self, stop: &AtomicBool) -> Result<Next<'_>, SourceError> {
        self.held = None;
        for _ in 0..LOOKS {
            if stop.load(Ordering::Relaxed) {
                return Ok(Next::End);
            }
            self.held = self.newest()?;
            if self.held.is_some() {
                break;
            }
            std::thread::sleep(self.pause);
        }
        let Some(image) = &self.held else {
            return Ok(Next::Nothing);
        };
        let header = image.header();
        let (width, height) = (header.width as usize, header.height as usize);
        let (pixels, stride): (&[u8], usize) = match header.encoding() {
            Some(Encoding::Mono8) | None => (image, header.stride as usize),
            Some(encoding) => {
                self.grey.clear();
                let rows = image.rows();
                rows.for_each(|row| add_grey(&mut self.grey, row, encoding));
                (&self.grey, width)
            }
        };
        let Some(grey) = Grey::new(pixels, width, height, stride) else {
            return Ok(Next::Nothing);
        };
        Ok(Next::Frame(Frame {
            sequence: header.stamp.sequence,
            data_ns: header.stamp.data_ns,
            exposure_ns: header.exposure_ns,
            published_ns: Some(header.stamp.published_ns),
            image: grey,
        }))
    }
}

/// Adds the grey levels of a row.
fn add_grey(grey: &mut Vec<u8>, row: &[u8], encoding: Encoding) {
    match encoding {
        Encoding::Mono8 => grey.extend_from_slice(row),
        Encoding::Yuyv => grey.extend(row.iter().step_by(2)),
        Encoding::Rgb8 => grey.extend(row.chunks_exact(3).map(|p| luma(p[0], p[1], p[2]))),
        Encoding::Bgr8 => grey.extend(row.chunks_exact(3).map(|p| luma(p[2], p[1], p[0]))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_becomes_grey() {
        for (encoding, row, expected) in [
            (Encoding::Mono8, &[7, 200][..], [7, 200]),
            (Encoding::Yuyv, &[7, 1, 200, 2], [7, 200]),
            (Encoding::Bgr8, &[0, 0, 255, 255, 255, 255], [76, 255]),
            (Encoding::Rgb8, &[255, 0, 0, 0, 255, 0], [76, 150]),
        ] {
            let mut grey = Vec::new();
            add_grey(&mut grey, row, encoding);
            assert_eq!(grey, expected, "{encoding:?}");
        }
    }
}
