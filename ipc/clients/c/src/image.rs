//! Images: pointers into shared memory, at both ends.

use ipc::{Image, LoanedImage};
use messages::{ImageHeader, Order};

use crate::boundary::{self, Fault, Handle};
use crate::camera::Sent;
use crate::domain::Domain;
use crate::status::Status;

/// The port, the number of the last frame, and the image that is being filled in.
pub struct PublisherState {
    // Before the port: it goes back to it.
    loaned: Option<LoanedImage>,
    port: ipc::ImagePublisher,
    sequence: u64,
}

/// The port, and the image that the caller reads.
pub struct SubscriberState {
    held: Option<Image>,
    port: ipc::ImageSubscriber,
}

/// Publishes images.
pub type ImagePublisher = Handle<PublisherState>;

/// Receives images.
pub type ImageSubscriber = Handle<SubscriberState>;

/// Opens the publisher of images of at most `most` bytes (stride times height).
/// VPC_STATUS_TAKEN while another camera sends images.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_publisher_open(
    domain: *mut Domain,
    most: usize,
    out: *mut *mut ImagePublisher,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        let publisher = PublisherState {
            loaned: None,
            port: domain.image_publisher(most)?,
            sequence: 0,
        };
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, publisher) }
    })
}

/// Closes the publisher, also with an image that was loaned and not sent. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_publisher_close(publisher: *mut ImagePublisher) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(publisher, "publisher") })
}

/// Loans memory for the image that `header` describes (width, height, stride, encoding; the rest may
/// be zero). `pixels` gets its first byte; `stride * height` bytes may be written until it is sent.
/// An image that was loaned before and not sent is given up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_loan(
    publisher: *mut ImagePublisher,
    header: *const ImageHeader,
    pixels: *mut *mut u8,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let publisher = unsafe { boundary::handle(publisher, "publisher") }?;
        // SAFETY: the header asks for a header.
        let header = unsafe { boundary::get(header, "header") }?;
        publisher.loaned = None;
        let image = publisher.loaned.insert(publisher.port.loan(&header)?);
        // SAFETY: the header asks for a place.
        unsafe { boundary::put(pixels, "pixels", image.as_mut_ptr()) }
    })
}

/// Sends the loaned image under the next sequence number. `header` has the size of the loan.
/// `stamp.published_ns` 0 becomes the present time and `stamp.data_ns` 0 becomes `published_ns`;
/// other values are kept. `sent` may be NULL. If the header is refused, the image stays loaned.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_send(
    publisher: *mut ImagePublisher,
    header: *const ImageHeader,
    sent: *mut Sent,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let publisher = unsafe { boundary::handle(publisher, "publisher") }?;
        // SAFETY: the header asks for a header.
        let mut header = unsafe { boundary::get(header, "header") }?;
        let mut image = publisher.loaned.take().ok_or_else(|| {
            let words = "vpc/image: no image is loaned; allowed: after vpc_image_loan";
            Fault::new(Status::Argument, words)
        })?;
        header.stamp.sequence = publisher.sequence + 1;
        if header.stamp.published_ns == 0 {
            header.stamp.published_ns = ipc::now_ns();
        }
        if header.stamp.data_ns == 0 {
            header.stamp.data_ns = header.stamp.published_ns;
        }
        if let Err(error) = header.check_image(image.len()) {
            publisher.loaned = Some(image);
            return Err(error.into());
        }
        *image.header_mut() = header;
        publisher.sequence += 1;
        let done = publisher.port.publish_verbatim(image)?;
        let done = Sent {
            sequence: done.sequence,
            published_ns: done.published_ns,
        };
        // SAFETY: the header asks for NULL or a place.
        unsafe { boundary::put_if_asked(sent, done) };
        Ok(())
    })
}

/// Skips a sequence number: a frame that the camera took and lost.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_skip(publisher: *mut ImagePublisher) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        unsafe { boundary::handle(publisher, "publisher") }?.sequence += 1;
        Ok(())
    })
}

/// Opens a subscriber of images. VPC_STATUS_TAKEN if as many are at work as the service allows.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_subscriber_open(
    domain: *mut Domain,
    out: *mut *mut ImageSubscriber,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        let subscriber = SubscriberState {
            held: None,
            port: domain.image_subscriber()?,
        };
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, subscriber) }
    })
}

/// Closes the subscriber, and releases the image that it holds. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_subscriber_close(subscriber: *mut ImageSubscriber) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(subscriber, "subscriber") })
}

/// The newest image since the last call; VPC_STATUS_NOTHING if there is none, then the one before
/// stays. `pixels` gets its first byte: `stride * height` bytes in shared memory, which must not be
/// written, and are valid until the next image, vpc_image_release or the close. `missed` (may be
/// NULL) gets the number of images that were lost or dropped since the one before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_newest(
    subscriber: *mut ImageSubscriber,
    header: *mut ImageHeader,
    pixels: *mut *const u8,
    missed: *mut u64,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let subscriber = unsafe { boundary::handle(subscriber, "subscriber") }?;
        if header.is_null() {
            return Err(Fault::null("header"));
        }
        if pixels.is_null() {
            return Err(Fault::null("pixels"));
        }
        let newest = subscriber.port.latest()?;
        let newest =
            newest.ok_or_else(|| Fault::new(Status::Nothing, "vpc/image: no image is waiting"))?;
        let gap = match newest.order() {
            Order::Gap { missed } => missed,
            _ => 0,
        };
        let image = subscriber.held.insert(newest);
        // SAFETY: the header asks for places.
        unsafe {
            boundary::put_if_asked(missed, gap);
            boundary::put(header, "header", *image.header())?;
            boundary::put(pixels, "pixels", image.as_ptr())
        }
    })
}

/// Gives the image back that vpc_image_newest returned, before the next one comes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_image_release(subscriber: *mut ImageSubscriber) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        unsafe { boundary::handle(subscriber, "subscriber") }?.held = None;
        Ok(())
    })
}
