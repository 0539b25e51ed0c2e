//! Where images come from.

use std::time::Duration;

use ipc::{Domain, Encoding, Image, ImageSubscriber, Order, ReceiveError};

use crate::grey::Grey;

/// A frame of a source.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Counts the camera's frames, lost ones too.
    pub number: u64,
    /// When the source sent it, CLOCK_MONOTONIC, or simulated, ns.
    pub published_ns: u64,
    /// Middle of the exposure, ns on the same clock.
    pub data_ns: u64,
    /// Length of the exposure, ns; 0 if unknown.
    pub exposure_ns: u64,
    /// Whether the source started again.
    pub is_restarted: bool,
    /// The image.
    pub grey: Grey<'a>,
}

/// Between two looks for an image.
const LOOK: Duration = Duration::from_micros(100);

/// Images of another process, by `vpc/image`.
#[derive(Debug)]
pub struct SharedMemory {
    images: ImageSubscriber,
    /// Of colour images, the grey.
    grey: Vec<u8>,
}

impl SharedMemory {
    /// Opens the subscriber.
    ///
    /// # Errors
    /// [`ipc::OpenError`].
    pub fn open(domain: &Domain) -> Result<Self, ipc::OpenError> {
        Ok(Self {
            images: domain.image_subscriber()?,
            grey: Vec::new(),
        })
    }

    /// Waits for the next image, at most `patience`, and hands it on; whether one came. The same
    /// image again, by the history of the service, is none.
    ///
    /// # Errors
    /// [`ReceiveError::Invalid`] where an image is refused; others where the shared memory fails.
    pub fn next(
        &mut self,
        patience: Duration,
        take: &mut dyn FnMut(&Frame<'_>),
    ) -> Result<bool, ReceiveError> {
        let end = std::time::Instant::now() + patience;
        loop {
            if let Some(image) = self.images.latest()? {
                if image.order() == Order::Repeated {
                    continue;
                }
                take(&self.frame(&image));
                return Ok(true);
            }
            if std::time::Instant::now() >= end {
                return Ok(false);
            }
            std::thread::sleep(LOOK);
        }
    }

    fn frame<'a>(&'a mut self, image: &'a Image) -> Frame<'a> {
        let header = image.header();
        let (width, height) = (header.width as usize, header.height as usize);
        let (pixels, stride): (&[u8], usize) = match header.encoding() {
            Some(Encoding::Mono8) | None => (image, header.stride as usize),
            Some(encoding) => {
                self.grey.clear();
                image
                    .rows()
                    .for_each(|row| add_grey(&mut self.grey, row, encoding));
                (&self.grey, width)
            }
        };
        Frame {
            number: header.stamp.sequence,
            published_ns: header.stamp.published_ns,
            data_ns: header.stamp.data_ns,
            exposure_ns: header.exposure_ns,
            is_restarted: image.order() == Order::Restarted,
            // The port has checked sizes and stride.
            grey: Grey::new(pixels, width, height, stride).unwrap_or(Grey::NONE),
        }
    }
}

/// Adds the grey of a row: luma, or BT.601 of colours.
fn add_grey(grey: &mut Vec<u8>, row: &[u8], encoding: Encoding) {
    let luma = |red: u8, green: u8, blue: u8| {
        let sum = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
        ((sum + 500) / 1000) as u8
    };
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
    fn grey_is_luma_whatever_the_order_of_colours() {
        let of = |row: &[u8], encoding| {
            let mut grey = Vec::new();
            add_grey(&mut grey, row, encoding);
            grey
        };
        assert_eq!(of(&[255, 0, 0, 9, 9, 9], Encoding::Rgb8), [76, 9]);
        assert_eq!(of(&[255, 0, 0, 9, 9, 9], Encoding::Bgr8), [29, 9]);
        assert_eq!(of(&[7, 128, 8, 128], Encoding::Yuyv), [7, 8]);
        assert_eq!(of(&[1, 2, 3], Encoding::Mono8), [1, 2, 3]);
    }
}
