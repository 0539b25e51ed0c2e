//! Images: slices of bytes in shared memory under a header. Both ends work on the memory itself.

use std::ops::{Deref, DerefMut};

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::ipc::Service;

use crate::codes::codes;
use crate::domain::Domain;
use crate::error::{LoanError, OpenError, PublishError, ReceiveError};
use crate::field::{Field, Kind, Meaning, Stamp, Wire};
use crate::guard::Place;
use crate::message::{self, Invalid, Message, Payload, Qos, message};
use crate::port::{Order, Sent, no_connection, no_subscriber, not_delivered, refused};
use crate::service::SliceFactory;

/// Most pixels in a row, and most rows.
const MOST_SIDE: usize = 8192;

/// Most bytes of an image that a publisher can be opened for.
pub const MOST_IMAGE_BYTES: usize = 4 * MOST_SIDE * MOST_SIDE;

codes! {
    /// How a pixel is stored.
    Encoding {
        /// One byte: grey.
        Mono8 = 0 => "mono8",
        /// Three bytes: blue, green, red.
        Bgr8 = 1 => "bgr8",
        /// Three bytes: red, green, blue.
        Rgb8 = 2 => "rgb8",
        /// Two bytes: luma of each pixel, then one chroma of both of a pair (Y0 U Y1 V; YUY2).
        Yuyv = 3 => "yuyv",
    }
}

impl Encoding {
    /// Bytes of one pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Mono8 => 1,
            Self::Yuyv => 2,
            Self::Bgr8 | Self::Rgb8 => 3,
        }
    }
}

message! {
    /// Header of an image. The image itself is a slice of `stride * height` bytes, top row first.
    ImageHeader: "vpc/ImageHeader/1" {
        /// Head; `sequence` counts the camera's frames, lost ones too; `data_ns` is the middle of
        /// the exposure.
        stamp: Stamp,
        /// Begin of the exposure; 0 if unknown.
        exposure_begin_ns: u64 ["ns"],
        /// Length of the exposure; 0 if unknown.
        exposure_ns: u64 ["ns"],
        /// Pixels in a row.
        width: u32 ["px" range(1, MOST_SIDE)],
        /// Rows.
        height: u32 ["px" range(1, MOST_SIDE)],
        /// Bytes from one row to the next; no fewer than a row has.
        stride: u32,
        /// How a pixel is stored.
        encoding: u32 [code(Encoding)],
    }
    // A history of one: who finds the features may come after the image that a lockstep camera waits
    // on. The first byte is aligned for vector instructions.
    "vpc/image" [Payload::Bytes { alignment: 64 }] from "camera":
        Qos { history: 1, buffer: 2, subscribers: 8, publishers: 1 }
}

/// Stands for the slice in errors.
static BYTES: Field = Field {
    name: "bytes",
    doc: "Bytes of the image.",
    unit: "",
    kind: Kind::U64,
    count: 1,
    offset: 0,
    size: 0,
    meaning: Meaning::Any,
};

impl ImageHeader {
    /// An image whose rows follow each other without a gap, exposed at `data_ns` (middle of the
    /// exposure; its begin and length are unknown).
    pub fn new(width: u32, height: u32, encoding: Encoding, data_ns: u64) -> Self {
        let mut header = Self {
            width,
            height,
            stride: width.saturating_mul(encoding.bytes_per_pixel() as u32),
            encoding: encoding.code(),
            ..Self::default()
        };
        header.stamp.data_ns = data_ns;
        header
    }

    /// How a pixel is stored; `None` if the contract does not know the code.
    pub fn encoding(&self) -> Option<Encoding> {
        Encoding::from_code(self.encoding)
    }

    /// Checks size, encoding and stride. Returns the bytes of the image.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    pub fn bytes(&self) -> Result<usize, Invalid> {
        message::check_fields(self, false)?;
        let row = self.row_bytes();
        if (self.stride as usize) < row {
            let limits = (row as f64, f64::INFINITY);
            return Err(refuse("stride", f64::from(self.stride), limits));
        }
        Ok(self.stride as usize * self.height as usize)
    }

    /// Bytes of a row without what follows it.
    fn row_bytes(&self) -> usize {
        let pixel = self.encoding().map_or(1, Encoding::bytes_per_pixel);
        self.width as usize * pixel
    }

    /// Checks the header of an image of so many bytes, as its subscribers do.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    pub fn check_image(&self, bytes: usize) -> Result<(), Invalid> {
        self.check()?;
        let expected = self.bytes()?;
        if bytes != expected {
            let limits = (expected as f64, expected as f64);
            return Err(refuse("bytes", bytes as f64, limits));
        }
        let (begin, at) = (self.exposure_begin_ns, self.stamp.data_ns);
        let end = begin.saturating_add(self.exposure_ns);
        if begin != 0 && !(begin..=end).contains(&at) {
            let limits = (begin as f64, end as f64);
            return Err(refuse("data_ns", at as f64, limits));
        }
        Ok(())
    }
}

fn refuse(field: &str, found: f64, limits: (f64, f64)) -> Invalid {
    let mut fields = Stamp::FIELDS.iter().chain(ImageHeader::FIELDS);
    Invalid {
        service: ImageHeader::SERVICE,
        field: fields.find(|known| known.name == field).unwrap_or(&BYTES),
        index: 0,
        found,
        limits: Some(limits),
    }
}

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
    port: iceoryx2::port::publisher::Publisher<Service, [u8], ImageHeader>,
    most: usize,
    sequence: u64,
    _place: Place,
    _domain: Domain,
}

/// Shared memory for an image that is not sent yet. Its bytes are those of an older image, or zero.
#[derive(Debug)]
pub struct LoanedImage {
    sample: SampleMut<Service, [u8], ImageHeader>,
    _domain: Domain,
}

impl LoanedImage {
    /// The header.
    pub fn header(&self) -> &ImageHeader {
        self.sample.user_header()
    }

    /// The header, for times that are known after the exposure. Subscribers refuse an image whose
    /// size no longer is that of the loan.
    pub fn header_mut(&mut self) -> &mut ImageHeader {
        self.sample.user_header_mut()
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
        *sample.user_header_mut() = *header;
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
        stamp.published_ns = crate::now_ns();
        self.publish_verbatim(image)
    }

    /// Sends a loaned image with its own stamp: for simulated time, replay and fault injection.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn publish_verbatim(&mut self, image: LoanedImage) -> Result<Sent, PublishError> {
        let Stamp {
            sequence,
            published_ns,
            ..
        } = image.header().stamp;
        let receivers = image.sample.send().map_err(not_delivered::<ImageHeader>)?;
        Ok(Sent {
            sequence,
            published_ns,
            receivers,
        })
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
    sample: Sample<Service, [u8], ImageHeader>,
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
    port: iceoryx2::port::subscriber::Subscriber<Service, [u8], ImageHeader>,
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
        let mut newest = None;
        // Bounded: a publisher may be faster than this loop.
        for _ in 0..=ImageHeader::QOS.buffer {
            match self.port.receive().map_err(no_connection::<ImageHeader>)? {
                Some(sample) => newest = Some(sample),
                None => break,
            }
        }
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
        sample: Sample<Service, [u8], ImageHeader>,
    ) -> Result<Image, ReceiveError> {
        let header = *sample.user_header();
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

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> ImageHeader {
        let mut header = ImageHeader::new(640, 480, Encoding::Bgr8, 1_500);
        header.stamp.sequence = 1;
        header
    }

    #[test]
    fn a_good_header_tells_the_bytes() {
        let mut header = header();
        assert_eq!(header.bytes(), Ok(640 * 3 * 480));
        assert_eq!(header.check_image(640 * 3 * 480), Ok(()));
        header.stride = 2048;
        assert_eq!(header.check_image(2048 * 480), Ok(()));
        (header.exposure_begin_ns, header.exposure_ns) = (1_000, 1_000);
        assert_eq!(header.check_image(2048 * 480), Ok(()));
    }

    #[test]
    fn each_fault_is_named_with_what_is_allowed() {
        let refused = |change: fn(&mut ImageHeader), bytes| {
            let mut header = header();
            change(&mut header);
            header.check_image(bytes).unwrap_err().to_string()
        };
        let whole = 640 * 3 * 480;
        for (change, bytes, words) in [
            (
                (|h| h.width = 0) as fn(&mut ImageHeader),
                whole,
                "width = 0; allowed: 1 to 8192",
            ),
            (
                |h| h.height = 8193,
                whole,
                "height = 8193; allowed: 1 to 8192",
            ),
            (
                |h| h.encoding = 4,
                whole,
                "encoding = 4; allowed: 0 mono8, 1 bgr8, 2 rgb8, 3 yuyv",
            ),
            (
                |h| h.stride = 1919,
                whole,
                "stride = 1919; allowed: 1920 or more",
            ),
            (|_| (), whole - 1, "bytes = 921599; allowed: 921600"),
            (
                |h| h.exposure_begin_ns = 1_501,
                whole,
                "data_ns = 1500; allowed: 1501",
            ),
            (
                |h| (h.exposure_begin_ns, h.exposure_ns) = (1_000, 499),
                whole,
                "data_ns = 1500; allowed: 1000 to 1499",
            ),
            (
                |h| h.stamp.sequence = 0,
                whole,
                "sequence = 0; allowed: 1 and more",
            ),
        ] {
            assert_eq!(refused(change, bytes), format!("vpc/image: {words}"));
        }
    }
}
