//! A topic that is subscribed to, and what became of its messages.

use std::sync::mpsc::SyncSender;

use ipc::now_ns;
use ros2_client::Subscription;
use serde::de::DeserializeOwned;

use crate::config::Reliability;
use crate::event::{BridgeError, Event};
use crate::message::Named;
use crate::refusal::{Counts, Refusal};
use crate::ros::{BATCH, Ros, RosError, take};

/// A topic that is subscribed to.
pub(crate) struct Inbox<M> {
    pub topic: String,
    pub counts: Counts,
    subscription: Subscription<M>,
}

impl<M: Named + DeserializeOwned + 'static> Inbox<M> {
    pub fn open(ros: &mut Ros, topic: &str, reliability: Reliability) -> Result<Self, RosError> {
        Ok(Self {
            subscription: ros.subscription(topic, reliability)?,
            topic: topic.to_owned(),
            counts: Counts::default(),
        })
    }

    /// Hands over what waits. `judge` returns the instant that a message is about, ns, and what
    /// follows from it; `None` passes over a message that is of no concern.
    pub fn each<T>(
        &mut self,
        tell: &SyncSender<Event>,
        mut judge: impl FnMut(&M, u64) -> Result<Option<(u64, T)>, Refusal>,
        mut then: impl FnMut(T) -> Result<(), BridgeError>,
    ) -> Result<(), BridgeError> {
        for _ in 0..BATCH {
            let now = now_ns();
            let judged = match take(&self.subscription) {
                Ok(None) => break,
                Ok(Some(message)) => judge(&message, now),
                Err(refusal) => Err(refusal),
            };
            match judged {
                Ok(None) => self.counts.passed_over += 1,
                Ok(Some((instant, value))) => {
                    if self.counts.taken == 0 {
                        let _ = tell.try_send(Event::Comes(self.topic.clone()));
                    }
                    self.counts.taken += 1;
                    self.counts.last_ns = now;
                    self.counts.age_ns = now.saturating_sub(instant);
                    then(value)?;
                }
                Err(refusal) => {
                    *self.counts.refused.entry(refusal.kind()).or_default() += 1;
                    let _ = tell.try_send(Event::Refused(self.topic.clone(), refusal));
                }
            }
        }
        Ok(())
    }
}
