//! Typed ports: one message type each, sequence numbers, time stamps, checks; no heap once a connection stands.

use std::ops::Deref;
use std::rc::Rc;

use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::port::update_connections::{ConnectionFailure, UpdateConnections};
use iceoryx2::service::ipc::Service;

use crate::domain::{Domain, Shared};
use crate::error::{OpenError, PublishError, ReceiveError};
use crate::field::Stamp;
use crate::message::Message;

impl Domain {
    /// Opens a publisher of `T`.
    ///
    /// # Errors
    /// [`OpenError::Taken`] if the service has all the publishers that it takes, even if they are stopped.
    pub fn publisher<T: Message>(&self) -> Result<Publisher<T>, OpenError> {
        Publisher::open(self.shared())
    }

    /// Opens a subscriber of `T` that keeps the newest `buffer` messages, 1 to `T::QOS.buffer`.
    ///
    /// # Errors
    /// [`OpenError::Full`] if the service has all the subscribers that it takes.
    pub fn subscriber<T: Message>(&self, buffer: usize) -> Result<Subscriber<T>, OpenError> {
        Subscriber::open(self.shared(), buffer.clamp(1, T::QOS.buffer))
    }
}

/// What became of a message that was published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    /// Its sequence number.
    pub sequence: u64,
    /// Its time of publication, CLOCK_MONOTONIC, ns.
    pub published_ns: u64,
    /// Subscribers that it was delivered to.
    pub receivers: usize,
}

/// The one publisher of a service.
#[derive(Debug)]
pub struct Publisher<T: Message> {
    // Ports before the domain: fields are dropped in this order.
    port: iceoryx2::port::publisher::Publisher<Service, T, ()>,
    sequence: u64,
    _domain: Rc<Shared>,
}

impl<T: Message> Publisher<T> {
    pub(crate) fn open(domain: &Rc<Shared>) -> Result<Self, OpenError> {
        let service = T::SERVICE;
        let _startup = domain.startup()?;
        let create = || -> Result<_, OpenError> {
            let builder = domain
                .factory::<T>()
                .ok_or(OpenError::Left { service })?
                .publisher_builder();
            let port = builder.max_loaned_samples(1).create();
            port.map_err(|source| match source {
                PublisherCreateError::ExceedsMaxSupportedPublishers => OpenError::Taken {
                    service,
                    domain: domain.directory(),
                    most: T::QOS.publishers,
                },
                _ => OpenError::Publisher { service, source },
            })
        };
        let port = match create() {
            // The other one may have been killed since we joined.
            Err(OpenError::Taken { .. }) => {
                domain.reap();
                create()?
            }
            result => result?,
        };
        Ok(Self {
            port,
            sequence: 0,
            _domain: Rc::clone(domain),
        })
    }

    /// Publishes a copy of `message` under the next sequence number and the present time; the rest, `data_ns`
    /// included, is as given.
    ///
    /// # Errors
    /// [`PublishError`]; the sequence number is used up, so that the loss shows as a gap.
    pub fn publish(&mut self, message: &T) -> Result<Sent, PublishError> {
        self.sequence += 1;
        let mut stamped = *message;
        let stamp = stamped.stamp_mut();
        stamp.sequence = self.sequence;
        stamp.published_ns = crate::now_ns();
        self.publish_verbatim(&stamped)
    }

    /// Publishes a message with the stamp that it carries: for replay, and for playing faults.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn publish_verbatim(&mut self, message: &T) -> Result<Sent, PublishError> {
        let service = T::SERVICE;
        let sample = self
            .port
            .loan_uninit()
            .map_err(|source| PublishError::Loan { service, source })?;
        let receivers = sample
            .write_payload(*message)
            .send()
            .map_err(|source| PublishError::Send { service, source })?;
        let Stamp {
            sequence,
            published_ns,
            ..
        } = *message.stamp();
        Ok(Sent {
            sequence,
            published_ns,
            receivers,
        })
    }

    /// Uses up a sequence number without publishing: a frame that the camera took and lost.
    pub fn skip(&mut self) {
        self.sequence += 1;
    }

    /// Looks for subscribers that came since the last message, and hands them the history of the service. Publishing
    /// does it too; who waits for an answer before publishing again must do it while waiting.
    ///
    /// # Errors
    /// [`PublishError::Send`] where a connection cannot be made.
    pub fn refresh(&mut self) -> Result<(), PublishError> {
        self.port
            .update_connections()
            .map_err(|source: ConnectionFailure| PublishError::Send {
                service: T::SERVICE,
                source: source.into(),
            })
    }
}

/// Where a message stands in the sequence of its service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The first one that this subscriber sees.
    First,
    /// The successor of the one before.
    Next,
    /// Some between were missed or overwritten.
    Gap {
        /// How many.
        missed: u64,
    },
    /// The same one again, by the history of the service.
    Repeated,
    /// The publisher started again.
    Restarted,
}

impl Order {
    /// Where `stamp` stands after `last`.
    pub fn after(last: Option<Stamp>, stamp: &Stamp) -> Self {
        let Some(last) = last else { return Self::First };
        match stamp.sequence.checked_sub(last.sequence) {
            None => Self::Restarted,
            Some(0) if stamp.published_ns == last.published_ns => Self::Repeated,
            Some(0) => Self::Restarted,
            Some(1) => Self::Next,
            Some(n) => Self::Gap { missed: n - 1 },
        }
    }
}

/// A received message that passed its checks, and where it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received<T> {
    /// The message.
    pub message: T,
    /// Where it stands in the sequence.
    pub order: Order,
}

impl<T> Deref for Received<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.message
    }
}

/// A subscriber of a service.
#[derive(Debug)]
pub struct Subscriber<T: Message> {
    port: iceoryx2::port::subscriber::Subscriber<Service, T, ()>,
    buffer: usize,
    last: Option<Stamp>,
    _domain: Rc<Shared>,
}

impl<T: Message> Subscriber<T> {
    pub(crate) fn open(domain: &Rc<Shared>, buffer: usize) -> Result<Self, OpenError> {
        let service = T::SERVICE;
        let _startup = domain.startup()?;
        let create = || -> Result<_, OpenError> {
            let builder = domain
                .factory::<T>()
                .ok_or(OpenError::Left { service })?
                .subscriber_builder();
            let port = builder.buffer_size(buffer).create();
            port.map_err(|source| match source {
                SubscriberCreateError::ExceedsMaxSupportedSubscribers => OpenError::Full {
                    service,
                    most: T::QOS.subscribers,
                },
                _ => OpenError::Subscriber { service, source },
            })
        };
        let port = match create() {
            Err(OpenError::Full { .. }) => {
                domain.reap();
                create()?
            }
            result => result?,
        };
        Ok(Self {
            port,
            buffer,
            last: None,
            _domain: Rc::clone(domain),
        })
    }

    /// The newest message since the last call; `None` where there is none. Older ones are thrown away, and count as
    /// a gap.
    ///
    /// # Errors
    /// [`ReceiveError::Invalid`] where the newest message is refused.
    pub fn latest(&mut self) -> Result<Option<Received<T>>, ReceiveError> {
        let mut newest = None;
        // Bounded: a publisher may be faster than this loop.
        for _ in 0..=self.buffer {
            match self.take()? {
                Some(message) => newest = Some(message),
                None => break,
            }
        }
        newest.map(|message| self.accept(message)).transpose()
    }

    /// The oldest message still in the buffer; `None` where there is none. For recorders, which want every message.
    ///
    /// # Errors
    /// As [`Subscriber::latest`].
    pub fn oldest(&mut self) -> Result<Option<Received<T>>, ReceiveError> {
        let message = self.take()?;
        message.map(|message| self.accept(message)).transpose()
    }

    /// Connects to a publisher that came since the last call. Receiving does it too; who wants the last messages of a
    /// publisher that may end soon connects while it lives.
    ///
    /// # Errors
    /// [`ReceiveError::Transport`] where the connection cannot be made.
    pub fn refresh(&mut self) -> Result<(), ReceiveError> {
        self.port
            .update_connections()
            .map_err(|source| ReceiveError::Transport {
                service: T::SERVICE,
                source: source.into(),
            })
    }

    fn take(&self) -> Result<Option<T>, ReceiveError> {
        match self.port.receive() {
            Ok(sample) => Ok(sample.map(|sample| *sample)),
            Err(source) => Err(ReceiveError::Transport {
                service: T::SERVICE,
                source,
            }),
        }
    }

    fn accept(&mut self, message: T) -> Result<Received<T>, ReceiveError> {
        let order = Order::after(self.last, message.stamp());
        self.last = Some(*message.stamp());
        match message.check() {
            Ok(()) => Ok(Received { message, order }),
            Err(invalid) => Err(ReceiveError::Invalid {
                invalid,
                stamp: *message.stamp(),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_repeats_and_restarts_are_told_apart() {
        let stamp = |sequence, published_ns| Stamp {
            sequence,
            published_ns,
            data_ns: 0,
        };
        let after = |sequence, published_ns| {
            Order::after(Some(stamp(5, 500)), &stamp(sequence, published_ns))
        };
        assert_eq!(Order::after(None, &stamp(5, 500)), Order::First);
        assert_eq!(after(6, 600), Order::Next);
        assert_eq!(after(9, 600), Order::Gap { missed: 3 });
        assert_eq!(after(5, 500), Order::Repeated);
        assert_eq!(after(5, 900), Order::Restarted);
        assert_eq!(after(1, 600), Order::Restarted);
    }
}
