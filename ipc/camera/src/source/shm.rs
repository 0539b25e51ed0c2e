//! Images from `vpc/image`.

use std::time::Duration;

use ipc::{Domain, Encoding, Image, ImageSubscriber, Order, ReceiveError};

use super::{Frame, Next, Source, SourceError};
use crate::grey::Grey;

/// How long to look before the caller is told that there is nothing.
const PATIENCE: Duration = Duration::from_millis(20);

/// Images that another process publishes in a domain.
#[derive(Debug)]
pub struct SharedMemory {
    images: ImageSubscriber,
    /// Between two looks: there is no event to wait for.
    pause: Duration,
    /// Borrowed from the publisher until the next one.
    image: Option<Image>,
    /// The image in grey, where it is not.
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
            image: None,
            grey: Vec::new(),
        })
    }

    /// The newest image since the last call.
    fn take(&mut self) -> Result<Option<Image>, SourceError> {
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
    fn next(&mut self) -> Result<Next<'_>, SourceError> {
        let looks = PATIENCE.as_nanos() / self.pause.as_nanos().max(1);
        for _ in 0..looks {
            let Some(image) = self.take()? else {
                std::thread::sleep(self.pause);
                continue;
            };
            let image: &Image = self.image.insert(image);
            let header = image.header();
            let (width, height) = (header.width as usize, header.height as usize);
            let grey = match header.encoding() {
                Some(Encoding::Mono8) => Grey::new(image, width, height, header.stride as usize),
                Some(encoding) => {
                    self.grey.clear();
                    image
                        .rows()
                        .for_each(|row| to_grey(encoding, row, &mut self.grey));
                    Grey::new(&self.grey, width, height, width)
                }
                None => None,
            };
            // Headers are checked where they are received.
            let Some(image) = grey else { break };
            return Ok(Next::Frame(Frame {
                sequence: header.stamp.sequence,
                data_ns: header.stamp.data_ns,
                exposure_ns: header.exposure_ns,
                published_ns: Some(header.stamp.published_ns),
                image,
            }));
        }
        Ok(Next::Nothing)
    }
}

/// Appends a row of pixels in grey.
fn to_grey(encoding: Encoding, row: &[u8], grey: &mut Vec<u8>) {
    let colours = row.chunks_exact(3);
    match encoding {
        Encoding::Mono8 => grey.extend_from_slice(row),
        Encoding::Yuyv => grey.extend(row.iter().step_by(2)),
        Encoding::Bgr8 => grey.extend(colours.map(|p| luma(p[2], p[1], p[0]))),
        Encoding::Rgb8 => grey.extend(colours.map(|p| luma(p[0], p[1], p[2]))),
    }
}

/// Grey of a colour, by the weights of ITU-R BT.601, as OpenCV does it.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let sum = 77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue);
    // The weights sum to 256.
    ((sum + 128) >> 8) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::ImageHeader;

    #[test]
    fn every_encoding_becomes_grey() {
        for (encoding, row, expected) in [
            (Encoding::Mono8, &[7, 200][..], [7, 200]),
            (Encoding::Yuyv, &[7, 1, 200, 2], [7, 200]),
            (Encoding::Bgr8, &[0, 0, 255, 255, 255, 255], [77, 255]),
            (Encoding::Rgb8, &[255, 0, 0, 0, 255, 0], [77, 149]),
        ] {
            let mut grey = Vec::new();
            to_grey(encoding, row, &mut grey);
            assert_eq!(grey, expected, "{encoding:?}");
        }
    }

    #[test]
    fn an_image_comes_once_with_its_times() {
        let directory = tempfile::tempdir().unwrap();
        let domain = Domain::join(&directory.path().join("domain")).unwrap();
        let mut camera = domain.image_publisher(64).unwrap();
        let mut source = SharedMemory::open(&domain, Duration::from_millis(1)).unwrap();
        for (encoding, bytes) in [(Encoding::Mono8, 4), (Encoding::Yuyv, 8)] {
            let mut header = ImageHeader::new(2, 2, encoding, 1000);
            header.exposure_ns = 600;
            header.exposure_begin_ns = 700;
            let mut image = camera.loan(&header).unwrap();
            image.copy_from_slice(&[9; 8][..bytes]);
            let sent = camera.publish(image).unwrap();
            let Next::Frame(frame) = source.next().unwrap() else {
                panic!("no frame")
            };
            assert_eq!(
                (frame.sequence, frame.data_ns, frame.exposure_ns),
                (sent.sequence, 1000, 600)
            );
            assert_eq!(frame.published_ns, Some(sent.published_ns));
            assert_eq!([frame.image.row(0), frame.image.row(1)], [[9, 9]; 2]);
            assert!(matches!(source.next(), Ok(Next::Nothing)));
        }
    }
}
