//! The services of a domain.

use core::any::Any;
use core::fmt::Debug;

use iceoryx2::node::Node;
use iceoryx2::prelude::{Alignment, ServiceName, ZeroCopySend};
use iceoryx2::service::builder::publish_subscribe::{
    Builder, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::ipc;
use iceoryx2::service::port_factory::publish_subscribe;

use crate::error::JoinReason;
use crate::field::Struct;
use crate::message::{Message, Payload, Qos};
use crate::{
    CycleRecord, Features, ImageHeader, Reply, Request, RobotState, Snapshot, TwistCommand,
};

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
    pub payload: Payload,
    /// What it carries, or the user header of what it carries.
    pub message: Struct,
}

impl Service {
    const fn of<T: Message>() -> Self {
        Self {
            name: T::SERVICE,
            publisher: T::PUBLISHER,
            qos: T::QOS,
            payload: T::PAYLOAD,
            message: Struct::of::<T>(),
        }
    }
}

macro_rules! services {
    ($($message:ident: $open:ident,)+) => {
        /// All services of the contract.
        pub const SERVICES: &[Service] = &[$(Service::of::<$message>(),)+];

        /// Opens all services, so that each exists from the first participant to the last.
        pub(crate) fn open_all(
            node: &Node<ipc::Service>,
        ) -> Result<Vec<Box<dyn OpenService>>, JoinReason> {
            Ok(vec![$(Box::new($open::<$message>(node)?),)+])
        }
    };
}

services! {
    Features: open,
    TwistCommand: open,
    RobotState: open,
    CycleRecord: open,
    Snapshot: open,
    Request: open,
    Reply: open,
    ImageHeader: open_slices,
}

/// An opened service that carries `T`.
pub(crate) type Factory<T> = publish_subscribe::PortFactory<ipc::Service, T, ()>;

/// An opened service that carries slices of bytes under the header `T`.
pub(crate) type SliceFactory<T> = publish_subscribe::PortFactory<ipc::Service, [u8], T>;

/// An opened service, whatever it carries.
pub(crate) trait OpenService: Any + Debug {}

impl<T: Message> OpenService for Factory<T> {}
impl<T: Message> OpenService for SliceFactory<T> {}

/// Opens a service, or creates it.
fn open<T: Message>(node: &Node<ipc::Service>) -> Result<Factory<T>, JoinReason> {
    let name = name::<T>()?;
    let builder = node.service_builder(&name).publish_subscribe::<T>();
    let factory = with_settings::<T, _, _>(builder).open_or_create();
    factory.map_err(refused::<T>)
}

/// As [`open`], for slices of bytes.
fn open_slices<T: Message>(node: &Node<ipc::Service>) -> Result<SliceFactory<T>, JoinReason> {
    let name = name::<T>()?;
    let mut builder = node.service_builder(&name).publish_subscribe::<[u8]>();
    if let Payload::Bytes { alignment } = T::PAYLOAD
        && let Some(alignment) = Alignment::new(alignment)
    {
        builder = builder.payload_alignment(alignment);
    }
    let factory = with_settings::<T, _, _>(builder.user_header::<T>()).open_or_create();
    factory.map_err(refused::<T>)
}

fn name<T: Message>() -> Result<ServiceName, JoinReason> {
    // The names are constants of this crate, all of them valid.
    let name = T::SERVICE.try_into();
    name.map_err(|_| refused::<T>(PublishSubscribeOpenOrCreateError::SystemInFlux))
}

fn with_settings<T: Message, P: Debug + ZeroCopySend + ?Sized, H: Debug + ZeroCopySend>(
    builder: Builder<P, H, ipc::Service>,
) -> Builder<P, H, ipc::Service> {
    builder
        .max_publishers(T::QOS.publishers + SPARE)
        .max_subscribers(T::QOS.subscribers)
        .max_nodes(MAX_NODES)
        .history_size(T::QOS.history)
        .subscriber_max_buffer_size(T::QOS.buffer)
        .subscriber_max_borrowed_samples(T::PAYLOAD.borrowed())
        .enable_safe_overflow(true)
}

fn refused<T: Message>(reason: PublishSubscribeOpenOrCreateError) -> JoinReason {
    use PublishSubscribeOpenError as Open;
    use PublishSubscribeOpenOrCreateError as Error;
    let service = T::SERVICE;
    match reason {
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
    }
}
