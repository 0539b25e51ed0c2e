//! Where images come from.

mod shm;

pub use shm::SharedMemory;

use ipc::Encoding;

use crate::grey::Grey;

/// An image, grey, with its times on CLOCK_MONOTONIC.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Number of the frame; lost ones leave gaps.
    pub sequence: u64,
    /// When it was published, ns.
    pub published_ns: u64,
    /// Middle of the exposure, ns.
    pub data_ns: u64,
    /// Length of the exposure, ns; 0 if unknown.
    pub exposure_ns: u64,
    /// Width and height, px.
    pub size: [usize; 2],
    /// The pixels, row by row from the top.
    pub pixels: Vec<u8>,
}

impl Frame {
    /// The image; `None` if there are fewer pixels than its size says.
    pub fn grey(&self) -> Option<Grey<'_>> {
        let [width, height] = self.size;
        Grey::new(&self.pixels, width, height, width)
    }

    /// Takes over an image of this size by its rows.
    pub fn fill<'a>(
        &mut self,
        size: [usize; 2],
        encoding: Encoding,
        rows: impl Iterator<Item = &'a [u8]>,
    ) {
        self.size = size;
        self.pixels.clear();
        for row in rows.take(size[1]) {
            match encoding {
                Encoding::Mono8 => self.pixels.extend_from_slice(row),
                Encoding::Yuyv => self.pixels.extend(row.iter().step_by(2)),
                Encoding::Bgr8 => self.pixels.extend(row.chunks_exact(3).map(|p| luma(p[2], p[1], p[0]))),
                Encoding::Rgb8 => self.pixels.extend(row.chunks_exact(3).map(|p| luma(p[0], p[1], p[2]))),
            }
        }
    }
}

/// Grey of a colour, by the weights of ITU-R BT.601, as OpenCV does it.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let sum = 77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue);
    ((sum + 128) >> 8) as u8
}

/// What a source has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// A new image.
    Image,
    /// None yet.
    Nothing,
    /// There will be none any more.
    End,
}

/// Why there are no images.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum SourceError {
    #[error(transparent)]
    Join(#[from] ipc::JoinError),
    #[error(transparent)]
    Open(#[from] ipc::OpenError),
    #[error(transparent)]
    Receive(#[from] ipc::ReceiveError),
}

/// Something that gives images.
pub trait Source {
    /// Waits for the next image, for a few milliseconds at most.
    ///
    /// # Errors
    /// There will be no more images.
    fn next(&mut self, frame: &mut Frame) -> Result<Next, SourceError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_becomes_grey() {
        let mut frame = Frame::default();
        for (encoding, row, expected) in [
            (Encoding::Mono8, &[7, 200][..], [7, 200]),
            (Encoding::Yuyv, &[7, 1, 200, 2], [7, 200]),
            (Encoding::Bgr8, &[0, 0, 255, 255, 255, 255], [77, 255]),
            (Encoding::Rgb8, &[255, 0, 0, 0, 255, 0], [77, 149]),
        ] {
            frame.fill([2, 1], encoding, std::iter::once(row));
            assert_eq!(frame.pixels, expected, "{encoding:?}");
            assert_eq!(frame.grey().unwrap().row(0), expected);
        }
    }
}
