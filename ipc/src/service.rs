//! The services of a domain.

use core::any::Any;
use core::fmt::Debug;

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::Node;
use iceoryx2::prelude::{CallbackProgression, Config, PortFactory};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc;
use iceoryx2::service::port_factory::publish_subscribe;

use crate::error::JoinError;
use crate::field::Field;
use crate::message::{Message, Qos};
use crate::{CycleRecord, Features, Reply, Request, RobotState, Snapshot, TwistCommand};

/// Most processes in one domain.
pub const MAX_NODES: usize = 32;

/// One service of the contract.
#[derive(Clone, Copy, Debug)]
pub struct Service {
    /// Its name.
    pub name: &'static str,
    /// Who publishes.
    pub publisher: &'static str,
    /// Quality of service.
    pub qos: Qos,
    /// Name of its message in Rust.
    pub message: &'static str,
    /// Name of the message that iceoryx2 compares.
    pub type_name: &'static str,
    /// Documentation of the message, a line each.
    pub doc: &'static str,
    /// Bytes of a message.
    pub size: usize,
    /// Fields of the message.
    pub fields: &'static [Field],
}

impl Service {
    /// The service that carries `T`.
    pub const fn of<T: Message>() -> Self {
        Self {
            name: T::SERVICE,
            publisher: T::PUBLISHER,
            qos: T::QOS,
            message: T::NAME,
            type_name: T::TYPE_NAME,
            doc: T::DOC,
            size: size_of::<T>(),
            fields: T::FIELDS,
        }
    }
}

macro_rules! services {
    ($($message:ident,)+) => {
        /// All services of the contract.
        pub const SERVICES: &[Service] = &[$(Service::of::<$message>(),)+];

        /// Opens all services, so that each exists from the first participant to the last.
        pub(crate) fn open_all(
            node: &Node<ipc::Service>,
            domain: &str,
        ) -> Result<Vec<Box<dyn OpenService>>, JoinError> {
            Ok(vec![$(Box::new(open::<$message>(node, domain)?),)+])
        }
    };
}

services! {
    Features,
    TwistCommand,
    RobotState,
    CycleRecord,
    Snapshot,
    Request,
    Reply,
}

/// An opened service.
pub(crate) type Factory<T> = publish_subscribe::PortFactory<ipc::Service, T, ()>;

/// An opened service, whatever its message.
pub(crate) trait OpenService: Any + Debug {
    /// Node and number of each port.
    fn ports(&self) -> Vec<(UniqueNodeId, u128)>;

    /// Removes a node and its ports, as far as they have tags.
    fn remove(&self, node: &UniqueNodeId, config: &Config);
}

impl<T: Message> OpenService for Factory<T> {
    fn ports(&self) -> Vec<(UniqueNodeId, u128)> {
        let mut ports = Vec::new();
        let dynamic = self.dynamic_config();
        dynamic.list_publishers(|port| {
            ports.push((port.node_id, port.publisher_id.value()));
            CallbackProgression::Continue
        });
        dynamic.list_subscribers(|port| {
            ports.push((port.node_id, port.subscriber_id.value()));
            CallbackProgression::Continue
        });
        ports
    }

    fn remove(&self, node: &UniqueNodeId, config: &Config) {
        // What cannot be removed now, the next process that joins removes.
        let _ =
            ipc::Service::__internal_remove_node_from_service(node, self.service_hash(), config);
    }
}

/// Opens a service, or creates it.
fn open<T: Message>(node: &Node<ipc::Service>, domain: &str) -> Result<Factory<T>, JoinError> {
    use PublishSubscribeOpenError as Open;
    use PublishSubscribeOpenOrCreateError as Error;
    let (path, service) = (domain.to_owned(), T::SERVICE);
    let refuse = |source: Error| match source {
        Error::PublishSubscribeOpenError(
            Open::IncompatibleTypes
            | Open::IncompatibleMessagingPattern
            | Open::IncompatibleOverflowBehavior
            | Open::DoesNotSupportRequestedMinBufferSize
            | Open::DoesNotSupportRequestedMinHistorySize
            | Open::DoesNotSupportRequestedAmountOfPublishers
            | Open::DoesNotSupportRequestedAmountOfSubscribers,
        ) => JoinError::OtherContract {
            path,
            service,
            source,
        },
        _ => JoinError::Service {
            path,
            service,
            source,
        },
    };
    let open = || {
        // The names are constants of this crate, all of them valid.
        let name = service.try_into().map_err(|_| Error::SystemInFlux)?;
        node.service_builder(&name)
            .publish_subscribe::<T>()
            .max_publishers(T::QOS.publishers)
            .max_subscribers(T::QOS.subscribers)
            .max_nodes(MAX_NODES)
            .history_size(T::QOS.history)
            .subscriber_max_buffer_size(T::QOS.buffer)
            .subscriber_max_borrowed_samples(1)
            .enable_safe_overflow(true)
            .open_or_create()
    };
    open().map_err(refuse)
}
