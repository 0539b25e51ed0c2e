//! The services of a domain.

use core::any::Any;
use core::fmt::Debug;

use iceoryx2::node::Node;
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::ipc;
use iceoryx2::service::port_factory::publish_subscribe;

use crate::error::JoinReason;
use crate::field::Struct;
use crate::message::{Message, Qos};
use crate::{CycleRecord, Features, Reply, Request, RobotState, Snapshot, TwistCommand};

/// Most processes in one domain.
pub const MAX_NODES: usize = 32;
/// Publishers that iceoryx2 allows beyond those of the contract: places that kills may leave taken.
const SPARE: usize = 16;

/// One service of the contract.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct Service {
    pub name: &'static str,
    /// Who publishes.
    pub publisher: &'static str,
    pub qos: Qos,
    pub message: Struct,
}

impl Service {
    const fn of<T: Message>() -> Self {
        Self {
            name: T::SERVICE,
            publisher: T::PUBLISHER,
            qos: T::QOS,
            message: Struct::of::<T>(),
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
        ) -> Result<Vec<Box<dyn OpenService>>, JoinReason> {
            Ok(vec![$(Box::new(open::<$message>(node)?),)+])
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
pub(crate) trait OpenService: Any + Debug {}

impl<T: Message> OpenService for Factory<T> {}

/// Opens a service, or creates it.
fn open<T: Message>(node: &Node<ipc::Service>) -> Result<Factory<T>, JoinReason> {
    use PublishSubscribeOpenError as Open;
    use PublishSubscribeOpenOrCreateError as Error;
    let service = T::SERVICE;
    let open = || {
        // The names are constants of this crate, all of them valid.
        let name = service.try_into().map_err(|_| Error::SystemInFlux)?;
        node.service_builder(&name)
            .publish_subscribe::<T>()
            .max_publishers(T::QOS.publishers + SPARE)
            .max_subscribers(T::QOS.subscribers)
            .max_nodes(MAX_NODES)
            .history_size(T::QOS.history)
            .subscriber_max_buffer_size(T::QOS.buffer)
            .subscriber_max_borrowed_samples(1)
            .enable_safe_overflow(true)
            .open_or_create()
    };
    open().map_err(|reason| match reason {
        Error::PublishSubscribeOpenError(
            Open::IncompatibleTypes
            | Open::IncompatibleMessagingPattern
            | Open::IncompatibleOverflowBehavior
            | Open::DoesNotSupportRequestedMinBufferSize
            | Open::DoesNotSupportRequestedMinHistorySize
            | Open::DoesNotSupportRequestedAmountOfPublishers
            | Open::DoesNotSupportRequestedAmountOfSubscribers,
        ) => JoinReason::OtherContract { service, reason },
        _ => JoinReason::Service { service, reason },
    })
}
