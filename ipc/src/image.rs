//! Images: slices of bytes in shared memory under a header. Both ends work on the memory itself.

use std::ops::{Deref, DerefMut};

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::ipc::Service;

use messages::{ImageHeader, MOST_IMAGE_BYTES, Message, Order, Stamp};

use crate::clock::now_ns;
use crate::domain::Domain;
use crate::error::{LoanError, OpenError, PublishError, ReceiveError};
use crate::guard::Place;
use crate::port::{Sent, newest, no_connection, no_subscriber, not_delivered, refused};
use crate::service::{Carried, SliceFactory};

impl Domain {
    /// Opens the publisher of images of at most `most` bytes (stride times height). Shared memory
    /// holds as many images as are under way or borrowed, about three and those that subscribers
    /// keep.
    ///
    /// # Errors
    /// [`OpenError::Taken`] if another camera sends images; [`OpenError::Port`] if `most` is not 1
    /// to [`MOST_IMAGE_BYTES`].
    pub fn image_publisher(&self, most: usize) -> Result<ImagePublisher, OpenError> {
        const SERVICE: &str = ImageHeader::SERVICE;
        if !(1..=MOST_IMAGE_BYTES).contains(&most) {
            let reason = format!("images of {most} bytes; allowed: 1 to {MOST_IMAGE_BYTES}");
            return Err(refused(SERVICE, reason));
        }
        let shared = &self.shared;
        let startup = shared.startup()?;
        let place = shared.place::<ImageHeader>(&startup)?;
        let create = |factory: &SliceFactory<ImageHeader>| {
            let port = factory.publisher_builder().max_loaned_samples(1);
            let port = port.initial_max_slice_len(most).create();
            port.map_err(|error| refused(SERVICE, error))
        };
        Ok(ImagePublisher {
            port: shared.open::<ImageHeader, _, _>(&startup, create)?,
            most,
            sequence: 0,
            _place: place,
            _domain: self.clone(),
        })
    }

    /// Opens a subscriber of images.
    ///
    /// # Errors
    /// [`OpenError::Full`] if the service has all the subscribers that it takes.
    pub fn image_subscriber(&self) -> Result<ImageSubscriber, OpenError> {
        let startup = self.shared.startup()?;
        let create = |factory: &SliceFactory<ImageHeader>| {
            let port = factory.subscriber_builder();
            let port = port.buffer_size(ImageHeader::QOS.buffer).create();
            port.map_err(no_subscriber::<ImageHeader>)
        };
        Ok(ImageSubscriber {
            port: self.shared.open::<ImageHeader, _, _>(&startup, create)?,
            last: None,
            domain: self.clone(),
        })
    }
}

/// The publisher of images.
#[derive(Debug)]
pub struct ImagePublisher {
    // Ports before the place and the domain: fields are dropped in this order.
    port: iceoryx2::port::publisher::Publisher<Service, [u8], Carried<ImageHeader>>,
    most: usize,
    sequence: u64,
    _place: Place,
    _domain: Domain,
}

/// Shared memory for an image that is not sent yet. Its bytes are those of an older image, or zero.
#[derive(Debug)]
pub struct LoanedImage {
    sample: SampleMut<Service, [u8], Carried<ImageHeader>>,
    _domain: Domain,
}

impl LoanedImage {
    /// The header.
    pub fn header(&self) -> &ImageHeader {
        &self.sample.user_header().0
    }

    /// The header, for times that are known after the exposure. Subscribers refuse an image whose
    /// size no longer is that of the loan.
    pub fn header_mut(&mut self) -> &mut ImageHeader {
        &mut self.sample.user_header_mut().0
    }
}

impl Deref for LoanedImage {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.sample.payload()
    }
}

impl DerefMut for LoanedImage {
    fn deref_mut(&mut self) -> &mut [u8] {
        self.sample.payload_mut()
    }
}

impl ImagePublisher {
    /// Loans memory for the image that `header` describes. One image may be loaned at a time.
    ///
    /// # Errors
    /// [`LoanError`] if the header describes no image, or one that is larger than the port was
    /// opened for.
    pub fn loan(&mut self, header: &ImageHeader) -> Result<LoanedImage, LoanError> {
        let (service, most) = (ImageHeader::SERVICE, self.most);
        let bytes = header.bytes()?;
        if bytes > most {
            return Err(LoanError::TooLarge {
                service,
                bytes,
                most,
            });
        }
        let sample = self.port.loan_slice_uninit(bytes);
        let sample = sample.map_err(|reason| LoanError::Transport { service, reason })?;
        // SAFETY: every byte of shared memory has a value, which the kernel (zero) or an older image
        // gave it, and every value is a valid u8.
        #[allow(unsafe_code)]
        let mut sample = unsafe { sample.assume_init() };
        sample.user_header_mut().0 = *header;
        Ok(LoanedImage {
            sample,
            _domain: self._domain.clone(),
        })
    }

    /// Sends a loaned image with the next sequence number and the present time.
    ///
    /// # Errors
    /// [`PublishError`]; the sequence number is used up, so that subscribers see a gap.
    pub fn publish(&mut self, mut image: LoanedImage) -> Result<Sent, PublishError> {
        self.sequence += 1;
        let stamp = image.header_mut().stamp_mut();
        stamp.sequence = self.sequence;
        stamp.published_ns = now_ns();
        self.publish_verbatim(image)
    }

    /// Sends a loaned image with its own stamp: for simulated time, replay and fault injection.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn publish_verbatim(&mut self, image: LoanedImage) -> Result<Sent, PublishError> {
        let stamp = image.header().stamp;
        Sent::of::<ImageHeader>(&stamp, image.sample.send())
    }

    /// Skips a sequence number: a frame that the camera took and lost.
    pub fn skip(&mut self) {
        self.sequence += 1;
    }

    /// Connects to subscribers that came since the last image, and gives them that one. Publishing
    /// does it too; call this while waiting for an answer before publishing again.
    ///
    /// # Errors
    /// [`PublishError`] if a connection cannot be made.
    pub fn refresh(&mut self) -> Result<(), PublishError> {
        let done = self.port.update_connections();
        done.map_err(|reason| not_delivered::<ImageHeader>(reason.into()))
    }
}

/// A received image that passed its checks: its bytes are the slice. The memory is borrowed from
/// the publisher until this value is dropped.
#[derive(Debug)]
pub struct Image {
    sample: Sample<Service, [u8], Carried<ImageHeader>>,
    // A copy: a publisher cannot change what was checked.
    header: ImageHeader,
    order: Order,
    _domain: Domain,
}

impl Image {
    /// The header.
    pub fn header(&self) -> &ImageHeader {
        &self.header
    }

    /// Where it stands in the sequence of images.
    pub fn order(&self) -> Order {
        self.order
    }

    /// The rows, from the top, without what follows a row up to the stride.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        let row = self.header.row_bytes();
        let rows = self
            .sample
            .payload()
            .chunks_exact(self.header.stride as usize);
        rows.map(move |bytes| &bytes[..row])
    }
}

impl Deref for Image {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.sample.payload()
    }
}

/// A subscriber of images.
#[derive(Debug)]
pub struct ImageSubscriber {
    port: iceoryx2::port::subscriber::Subscriber<Service, [u8], Carried<ImageHeader>>,
    last: Option<Stamp>,
    domain: Domain,
}

impl ImageSubscriber {
    /// The newest image since the last call, without a copy. Older ones count as a gap. Hold one
    /// other image at most.
    ///
    /// # Errors
    /// [`ReceiveError::Invalid`] if the newest image is refused; [`ReceiveError::Transport`] if too
    /// many images are held.
    pub fn latest(&mut self) -> Result<Option<Image>, ReceiveError> {
        let take = || self.port.receive().map_err(no_connection::<ImageHeader>);
        let newest = newest(ImageHeader::QOS.buffer, take)?;
        newest.map(|sample| self.accept(sample)).transpose()
    }

    /// Connects to a publisher that came since the last call. Receiving does it too.
    ///
    /// # Errors
    /// [`ReceiveError::Transport`] if the connection cannot be made.
    pub fn refresh(&mut self) -> Result<(), ReceiveError> {
        let done = self.port.update_connections();
        done.map_err(|reason| no_connection::<ImageHeader>(reason.into()))
    }

    fn accept(
        &mut self,
        sample: Sample<Service, [u8], Carried<ImageHeader>>,
    ) -> Result<Image, ReceiveError> {
        let header = sample.user_header().0;
        let stamp = header.stamp;
        let order = Order::after(self.last.replace(stamp), &stamp);
        match header.check_image(sample.payload().len()) {
            Ok(()) => Ok(Image {
                sample,
                header,
                order,
                _domain: self.domain.clone(),
            }),
            Err(invalid) => Err(ReceiveError::Invalid { invalid, stamp }),
        }
    }
}
