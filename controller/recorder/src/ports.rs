//! The queues of a domain, and what is to be done with each message.

use ipc::{Domain, OpenError, ReceiveError, Subscriber};
use messages::{
    CycleRecord, DesiredTwist, Features, Reply, Request, RobotState, Snapshot, TwistCommand,
};
use recording::{Sink, WriteError};

use crate::ledger::Notice;
use crate::recorder::Recorder;
use crate::views::Viewed;

/// Failures to receive in a row, on one port, that are passed over.
pub(crate) const MOST_FAILURES: u32 = 1_000;

/// What is to be done with a message.
pub(crate) type Item<S> =
    Box<dyn FnOnce(&mut Recorder<S>) -> Result<Option<Notice>, WriteError> + Send>;

/// A port of any type of message.
pub(crate) trait Source<S> {
    /// Gives what waits, at most one queue full, until `give` returns false.
    ///
    /// # Errors
    /// The port failed again and again.
    fn drain(&mut self, give: &mut dyn FnMut(Item<S>) -> bool) -> Result<(), ReceiveError>;
}

/// Ports for all that a domain publishes, causes before effects: a finished recording has no answer
/// without its question.
pub(crate) fn all<S: Sink>(domain: &Domain) -> Result<Vec<Box<dyn Source<S>>>, OpenError> {
    Ok(vec![
        Port::<Features>::open(domain)?,
        Port::<Request>::open(domain)?,
        Port::<RobotState>::open(domain)?,
        Port::<DesiredTwist>::open(domain)?,
        Port::<TwistCommand>::open(domain)?,
        Port::<Snapshot>::open(domain)?,
        Port::<CycleRecord>::open(domain)?,
        Port::<Reply>::open(domain)?,
    ])
}

/// Ports that cost the daemon's loop nothing, whenever they are opened: for what it publishes
/// itself, twists and replies, a new subscriber costs it some heap calls once. Twists are in the
/// records of the cycles, too.
pub(crate) fn free_for_the_loop<S: Sink>(
    domain: &Domain,
) -> Result<Vec<Box<dyn Source<S>>>, OpenError> {
    Ok(vec![
        Port::<Features>::open(domain)?,
        Port::<RobotState>::open(domain)?,
        Port::<CycleRecord>::open(domain)?,
    ])
}

struct Port<T: Viewed> {
    subscriber: Subscriber<T>,
    failures: Failures,
}

/// Failures to receive in a row, on one port.
#[derive(Debug, Default)]
pub(crate) struct Failures(u32);

impl Failures {
    /// Counts a look without a failure.
    pub(crate) fn end(&mut self) {
        self.0 = 0;
    }

    /// Passes a failure over, unless it is one too many.
    ///
    /// # Errors
    /// The failure.
    pub(crate) fn pass_over(&mut self, failure: ReceiveError) -> Result<(), ReceiveError> {
        self.0 += 1;
        match self.0 < MOST_FAILURES {
            true => Ok(()),
            false => Err(failure),
        }
    }
}

impl<T: Viewed + Send> Port<T> {
    fn open<S: Sink>(domain: &Domain) -> Result<Box<dyn Source<S>>, OpenError> {
        Ok(Box::new(Self {
            subscriber: domain.subscriber(T::QOS.buffer)?,
            failures: Failures::default(),
        }))
    }
}

impl<T: Viewed + Send, S: Sink> Source<S> for Port<T> {
    fn drain(&mut self, give: &mut dyn FnMut(Item<S>) -> bool) -> Result<(), ReceiveError> {
        for _ in 0..T::QOS.buffer {
            let item: Item<S> = match self.subscriber.oldest() {
                Ok(None) => {
                    self.failures.end();
                    return Ok(());
                }
                Ok(Some(m)) => Box::new(move |to| to.take(&m.message, m.order)),
                Err(ReceiveError::Invalid { invalid, .. }) => {
                    Box::new(move |to| to.refuse(T::TOPIC, invalid.to_string()).map(Some))
                }
                Err(error) => return self.failures.pass_over(error),
            };
            if !give(item) {
                return Ok(());
            }
        }
        Ok(())
    }
}
