//! The node in the graph of ROS 2, and its quality of service.

use std::collections::BTreeSet;

use ros2_client::dds::rustdds::dds::statusevents::DomainParticipantStatusEvent as Status;
use ros2_client::dds::rustdds::{
    DomainParticipantBuilder, DomainParticipantStatusListener, GUID, StatusEvented, Topic,
};
use ros2_client::qos::{History, WhenFull};
use ros2_client::{
    Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile, Server,
    ServiceMapping, ServiceTypeName, Subscription,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::config::{Config, Reliability, Services};
use crate::message::{Named, TriggerRequest, TriggerResponse};
use crate::refusal::Refusal;

/// Messages that wait for the gateway, which looks every millisecond.
const INBOX: usize = 16;
/// Most messages of a topic that are taken at a time.
pub const BATCH: usize = 16;
/// Requests of a service that wait.
const REQUESTS: usize = 10;

/// A server of std_srvs/Trigger.
pub type TriggerServer = Server<TriggerRequest, TriggerResponse>;

/// The node cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("ROS 2, {what}: {why}")]
pub struct RosError {
    what: String,
    why: String,
}

fn failed<E: std::fmt::Debug>(what: &str) -> impl Fn(E) -> RosError + '_ {
    move |why| RosError {
        what: what.to_owned(),
        why: format!("{why:?}"),
    }
}

/// The node.
pub struct Ros {
    node: Node,
    name: String,
    services: ServiceMapping,
    statuses: Option<DomainParticipantStatusListener>,
}

/// The subscribers of one of our topics.
pub struct Listeners {
    writer: GUID,
    readers: BTreeSet<GUID>,
    statuses: DomainParticipantStatusListener,
}

impl Listeners {
    /// Whether the last one has left since it was asked last.
    pub fn have_left(&mut self) -> bool {
        let before = self.readers.len();
        while let Some(status) = self.statuses.try_recv_status() {
            match status {
                Status::RemoteReaderMatched {
                    local_writer,
                    remote_reader,
                } if local_writer == self.writer => _ = self.readers.insert(remote_reader),
                Status::ReaderLost { guid, .. } => _ = self.readers.remove(&guid),
                Status::ParticipantLost { id, .. } => self.readers.retain(|r| r.prefix != id),
                _ => (),
            }
        }
        before > 0 && self.readers.is_empty()
    }
}

impl Ros {
    /// Joins the graph.
    ///
    /// # Errors
    /// [`RosError`]: no socket, no such interface, or a name that ROS refuses.
    pub fn join(config: &Config) -> Result<Self, RosError> {
        let mut builder = DomainParticipantBuilder::new(config.ros_domain_id);
        if !config.interfaces.is_empty() {
            builder = builder.with_only_networks(config.interfaces.iter().copied());
        }
        let participant = builder.build().map_err(failed("participant"))?;
        let statuses = Some(participant.status_listener());
        let context = Context::from_domain_participant(participant);
        let context = context.map_err(failed("context"))?;
        let [namespace, name] = &config.node;
        let node = NodeName::new(namespace, name).map_err(failed("node"))?;
        let options = NodeOptions::new()
            .enable_rosout(false)
            .start_parameter_services(false);
        let name = node.fully_qualified_name();
        let node = context.new_node(node, options).map_err(failed("node"))?;
        Ok(Self {
            node,
            name,
            statuses,
            services: match config.services {
                Services::Fastdds => ServiceMapping::Enhanced,
                Services::Cyclonedds => ServiceMapping::Cyclone,
            },
        })
    }

    /// Its full name: services and overlays are below it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The subscribers of `publisher`; `None` for all publishers but the first that asks.
    pub fn listeners<M: Serialize>(&mut self, publisher: &Publisher<M>) -> Option<Listeners> {
        Some(Listeners {
            writer: publisher.guid(),
            readers: BTreeSet::new(),
            statuses: self.statuses.take()?,
        })
    }

    /// Offers a topic.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn publisher<M: Named + Serialize>(
        &mut self,
        topic: &str,
        reliability: Reliability,
    ) -> Result<Publisher<M>, RosError> {
        let qos = qos(reliability, 1);
        let topic = self.topic::<M>(topic, &qos)?;
        let publisher = self.node.create_publisher(&topic, Some(qos));
        publisher.map_err(failed(M::TYPE))
    }

    /// Subscribes to a topic.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn subscription<M: Named + DeserializeOwned + 'static>(
        &mut self,
        topic: &str,
        reliability: Reliability,
    ) -> Result<Subscription<M>, RosError> {
        let qos = qos(reliability, INBOX);
        let topic = self.topic::<M>(topic, &qos)?;
        let subscription = self.node.create_subscription(&topic, Some(qos));
        subscription.map_err(failed(M::TYPE))
    }

    /// Serves std_srvs/Trigger below the node's name.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn trigger(&mut self, name: &str) -> Result<TriggerServer, RosError> {
        let qos = qos(Reliability::Reliable, REQUESTS);
        let full = Name::new(&self.name, name).map_err(failed(name))?;
        let type_name = ServiceTypeName::new(TriggerRequest::PACKAGE, TriggerRequest::TYPE);
        let server = self
            .node
            .create_server(self.services, &full, &type_name, qos.clone(), qos);
        server.map_err(failed(name))
    }

    fn topic<M: Named>(&self, topic: &str, qos: &QosProfile) -> Result<Topic, RosError> {
        let name = Name::parse(topic).map_err(failed(topic))?;
        let type_name = MessageTypeName::new(M::PACKAGE, M::TYPE);
        let made = self.node.create_topic(&name, type_name, qos);
        made.map_err(failed(topic))
    }
}

fn qos(reliability: Reliability, depth: usize) -> QosProfile {
    let qos = QosProfile::subscription_default().history(History::KeepLast { depth });
    match reliability {
        Reliability::BestEffort => qos.reliability_best_effort(),
        // Whoever has to send zeros waits for nobody.
        Reliability::Reliable => qos.reliability_reliable(WhenFull::Fail),
    }
}

/// The next message that waits; `None` if there is none.
///
/// # Errors
/// [`Refusal::Unreadable`]: a message came that is not of this type.
pub fn take<M: DeserializeOwned + 'static>(
    subscription: &Subscription<M>,
) -> Result<Option<M>, Refusal> {
    let taken = subscription.take();
    let taken = taken.map_err(|why| Refusal::Unreadable(format!("{why:?}")))?;
    Ok(taken.map(|(message, _)| message))
}
