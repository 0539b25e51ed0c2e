//! Typed ports: sequence numbers, time stamps, checks. They do not touch the heap once a connection
//! is made.

use iceoryx2::port::SendError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::service::ipc::Service;
use messages::{Message, Order, Payload, Received, Stamp};

use crate::clock::now_ns;
use crate::domain::Domain;
use crate::error::{OpenError, PublishError, ReceiveError};
use crate::guard::Place;
use crate::service::{Carried, Factory};

impl Domain {
    /// Opens a publisher of `T`.
    ///
    /// # Errors
    /// [`OpenError::Taken`] if the service has all the publishers that it takes, even if they are
    /// stopped.
    pub fn publisher<T: Message>(&self) -> Result<Publisher<T>, OpenError> {
        const { assert!(matches!(T::PAYLOAD, Payload::Message)) };
        let startup = self.shared.startup()?;
        let place = self.shared.place::<T>(&startup)?;
        let port = self
            .shared
            .open::<T, _, _>(&startup, |factory: &Factory<T>| {
                let port = factory.publisher_builder().max_loaned_samples(1).create();
                port.map_err(|error| refused(T::SERVICE, error))
            })?;
        Ok(Publisher {
            port,
            sequence: 0,
            _place: place,
            _domain: self.clone(),
        })
    }

    /// Opens a subscriber of `T` that keeps the newest `buffer` messages, 1 to `T::QOS.buffer`.
    ///
    /// # Errors
    /// [`OpenError::Full`] if the service has all the subscribers that it takes.
    pub fn subscriber<T: Message>(&self, buffer: usize) -> Result<Subscriber<T>, OpenError> {
        const { assert!(matches!(T::PAYLOAD, Payload::Message)) };
        let buffer = buffer.clamp(1, T::QOS.buffer);
        let startup = self.shared.startup()?;
        let port = self
            .shared
            .open::<T, _, _>(&startup, |factory: &Factory<T>| {
                let port = factory.subscriber_builder().buffer_size(buffer).create();
                port.map_err(no_subscriber::<T>)
            })?;
        Ok(Subscriber {
            port,
            buffer,
            last: None,
            _domain: self.clone(),
        })
    }
}

pub(crate) fn no_subscriber<T: Message>(error: SubscriberCreateError) -> OpenError {
    let (service, most) = (T::SERVICE, T::QOS.subscribers);
    match error {
        SubscriberCreateError::ExceedsMaxSupportedSubscribers => OpenError::Full { service, most },
        _ => refused(service, error),
    }
}

pub(crate) fn refused(service: &'static str, reason: impl ToString) -> OpenError {
    let reason = reason.to_string();
    OpenError::Port { service, reason }
}

/// A message that was published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    /// Its sequence number.
    pub sequence: u64,
    /// Its time of publication, CLOCK_MONOTONIC, ns.
    pub published_ns: u64,
    /// Subscribers that got it.
    pub receivers: usize,
}

impl Sent {
    /// The outcome of sending a message with this stamp.
    pub(crate) fn of<T: Message>(
        stamp: &Stamp,
        sent: Result<usize, SendError>,
    ) -> Result<Self, PublishError> {
        Ok(Self {
            sequence: stamp.sequence,
            published_ns: stamp.published_ns,
            receivers: sent.map_err(not_delivered::<T>)?,
        })
    }
}

/// A publisher of a service.
#[derive(Debug)]
pub struct Publisher<T: Message> {
    // Ports before the place and the domain: fields are dropped in this order.
    port: iceoryx2::port::publisher::Publisher<Service, Carried<T>, ()>,
    sequence: u64,
    _place: Place,
    _domain: Domain,
}

impl<T: Message> Publisher<T> {
    /// Publishes a copy of `message` with the next sequence number and the present time; the rest
    /// is unchanged.
    ///
    /// # Errors
    /// [`PublishError`]; the sequence number is used up, so that subscribers see a gap.
    pub fn publish(&mut self, message: &T) -> Result<Sent, PublishError> {
        self.sequence += 1;
        let mut stamped = *message;
        let stamp = stamped.stamp_mut();
        stamp.sequence = self.sequence;
        stamp.published_ns = now_ns();
        self.publish_verbatim(&stamped)
    }

    /// Publishes a message with its own stamp: for simulated time, replay and fault injection.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn publish_verbatim(&mut self, message: &T) -> Result<Sent, PublishError> {
        let send = || {
            let sample = self.port.loan_uninit()?;
            sample.write_payload(Carried(*message)).send()
        };
        Sent::of::<T>(message.stamp(), send())
    }

    /// Skips a sequence number: a frame that the camera took and lost.
    pub fn skip(&mut self) {
        self.sequence += 1;
    }

    /// Connects to subscribers that came since the last message, and gives them the history of the
    /// service. Publishing does it too; call this while waiting for an answer before publishing
    /// again.
    ///
    /// # Errors
    /// [`PublishError`] if a connection cannot be made.
    pub fn refresh(&mut self) -> Result<(), PublishError> {
        let done = self.port.update_connections();
        done.map_err(|reason| not_delivered::<T>(reason.into()))
    }
}

pub(crate) fn not_delivered<T: Message>(reason: SendError) -> PublishError {
    PublishError {
        service: T::SERVICE,
        reason,
    }
}

/// A subscriber of a service.
#[derive(Debug)]
pub struct Subscriber<T: Message> {
    port: iceoryx2::port::subscriber::Subscriber<Service, Carried<T>, ()>,
    buffer: usize,
    last: Option<Stamp>,
    _domain: Domain,
}

impl<T: Message> Subscriber<T> {
    /// The newest message since the last call. Older ones are dropped, and count as a gap.
    ///
    /// # Errors
    /// [`ReceiveError::Invalid`] if the newest message is refused.
    pub fn latest(&mut self) -> Result<Option<Received<T>>, ReceiveError> {
        let newest = newest(self.buffer, || self.take())?;
        newest.map(|message| self.accept(message)).transpose()
    }

    /// The oldest message in the buffer: for recorders, which need every message.
    ///
    /// # Errors
    /// As [`Subscriber::latest`].
    pub fn oldest(&mut self) -> Result<Option<Received<T>>, ReceiveError> {
        let message = self.take()?;
        message.map(|message| self.accept(message)).transpose()
    }

    /// Connects to a publisher that came since the last call. Receiving does it too; call this to
    /// get the last messages of a publisher that may end soon.
    ///
    /// # Errors
    /// [`ReceiveError::Transport`] if the connection cannot be made.
    pub fn refresh(&mut self) -> Result<(), ReceiveError> {
        let done = self.port.update_connections();
        done.map_err(|reason| no_connection::<T>(reason.into()))
    }

    fn take(&self) -> Result<Option<T>, ReceiveError> {
        let sample = self.port.receive().map_err(no_connection::<T>)?;
        Ok(sample.map(|sample| sample.0))
    }

    fn accept(&mut self, message: T) -> Result<Received<T>, ReceiveError> {
        let stamp = *message.stamp();
        let order = Order::after(self.last.replace(stamp), &stamp);
        match message.check() {
            Ok(()) => Ok(Received { message, order }),
            Err(invalid) => Err(ReceiveError::Invalid { invalid, stamp }),
        }
    }
}

/// The last of what `take` gives in at most one buffer full and one more: a publisher may be faster
/// than this loop.
pub(crate) fn newest<M>(
    buffer: usize,
    mut take: impl FnMut() -> Result<Option<M>, ReceiveError>,
) -> Result<Option<M>, ReceiveError> {
    let mut newest = None;
    for _ in 0..=buffer {
        match take()? {
            Some(message) => newest = Some(message),
            None => break,
        }
    }
    Ok(newest)
}

pub(crate) fn no_connection<T: Message>(reason: iceoryx2::port::ReceiveError) -> ReceiveError {
    ReceiveError::Transport {
        service: T::SERVICE,
        reason,
    }
}
