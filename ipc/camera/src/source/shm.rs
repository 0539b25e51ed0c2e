//! Images from `vpc/image`.

use std::time::Duration;

use ipc::{Domain, ImageSubscriber, Order, ReceiveError};

use super::{Frame, Next, Source, SourceError};

/// Looks before the caller is told that there is nothing.
const LOOKS: u32 = 50;

/// Images that another process publishes in a domain.
#[derive(Debug)]
pub struct SharedMemory {
    images: ImageSubscriber,
    /// Between two looks: there is no event to wait for.
    pause: Duration,
}

impl SharedMemory {
    /// Subscribes, to look this often.
    ///
    /// # Errors
    /// The service has all the subscribers that it takes.
    pub fn open(domain: &Domain, pause: Duration) -> Result<Self, SourceError> {
        let images = domain.image_subscriber()?;
        Ok(Self { images, pause })
    }
}

impl Source for SharedMemory {
    fn next(&mut self, frame: &mut Frame) -> Result<Next, SourceError> {
        for _ in 0..LOOKS {
            let image = match self.images.latest() {
                Ok(image) => image,
                Err(ReceiveError::Invalid { invalid, .. }) => {
                    tracing::warn!("an image is refused: {invalid}");
                    None
                }
                Err(error) => return Err(error.into()),
            };
            if let Some(image) = image.filter(|image| image.order() != Order::Repeated)
                && let Some(encoding) = image.header().encoding()
            {
                let header = image.header();
                frame.sequence = header.stamp.sequence;
                frame.published_ns = header.stamp.published_ns;
                frame.data_ns = header.stamp.data_ns;
                frame.exposure_ns = header.exposure_ns;
                let size = [header.width as usize, header.height as usize];
                frame.fill(size, encoding, image.rows());
                return Ok(Next::Image);
            }
            std::thread::sleep(self.pause);
        }
        Ok(Next::Nothing)
    }
}
