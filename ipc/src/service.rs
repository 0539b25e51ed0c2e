//! The services of a domain.

use core::any::Any;
use core::fmt::Debug;

use iceoryx2::node::Node;
use iceoryx2::prelude::{Alignment, MessagingPattern, ServiceName, ZeroCopySend};
use iceoryx2::service::builder::publish_subscribe::{
    Builder, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::publish_subscribe;
use iceoryx2::service::{Service as _, ipc};
use messages::{
    CycleRecord, DesiredTwist, Features, ImageHeader, Message, Payload, Reply, Request, RobotState,
    SERVICES, Snapshot, TwistCommand,
};

use crate::error::JoinReason;

/// Most processes in one domain.
pub const MAX_NODES: usize = 32;
/// Publishers that iceoryx2 allows beyond those of the contract: places that kills may leave taken.
const SPARE: usize = 16;

/// A message as iceoryx2 carries it: the message itself, under its own type name.
#[derive(Clone, Copy, Debug, Default)]
#[repr(transparent)]
pub(crate) struct Carried<T>(pub T);

// SAFETY: only `messages::wire!` implements `Message`, for `repr(C)` structs of numbers, arrays of
// numbers and stamps, without padding: plain data that means the same in every process. The wrapper
// is transparent, and the type name stands for that layout in every language.
#[allow(unsafe_code)]
unsafe impl<T: Message> ZeroCopySend for Carried<T> {
    unsafe fn type_name() -> &'static str {
        T::TYPE_NAME
    }
}

/// Opens all services, so that each exists from the first participant to the last.
pub(crate) fn open_all(node: &Node<ipc::Service>) -> Result<Vec<Box<dyn OpenService>>, JoinReason> {
    let services: [Box<dyn OpenService>; SERVICES.len()] = [
        Box::new(open::<Features>(node)?),
        Box::new(open::<TwistCommand>(node)?),
        Box::new(open::<RobotState>(node)?),
        Box::new(open::<DesiredTwist>(node)?),
        Box::new(open::<CycleRecord>(node)?),
        Box::new(open::<Snapshot>(node)?),
        Box::new(open::<Request>(node)?),
        Box::new(open::<Reply>(node)?),
        Box::new(open_slices::<ImageHeader>(node)?),
    ];
    Ok(services.into())
}

/// An opened service that carries `T`.
pub(crate) type Factory<T> = publish_subscribe::PortFactory<ipc::Service, Carried<T>, ()>;

/// An opened service that carries slices of bytes under the header `T`.
pub(crate) type SliceFactory<T> = publish_subscribe::PortFactory<ipc::Service, [u8], Carried<T>>;

/// An opened service, whatever it carries.
pub(crate) trait OpenService: Any + Debug {}

impl<T: Message> OpenService for Factory<T> {}
impl<T: Message> OpenService for SliceFactory<T> {}

/// Opens a service, or creates it.
fn open<T: Message>(node: &Node<ipc::Service>) -> Result<Factory<T>, JoinReason> {
    let name = name::<T>()?;
    let builder = node
        .service_builder(&name)
        .publish_subscribe::<Carried<T>>();
    let factory = with_settings::<T, _, _>(builder).open_or_create();
    factory.map_err(|reason| refused::<T>(node, &name, reason))
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
    let builder = builder.user_header::<Carried<T>>();
    let factory = with_settings::<T, _, _>(builder).open_or_create();
    factory.map_err(|reason| refused::<T>(node, &name, reason))
}

fn name<T: Message>() -> Result<ServiceName, JoinReason> {
    // The names are constants of this crate, all of them valid.
    T::SERVICE.try_into().map_err(|_| JoinReason::Service {
        service: T::SERVICE,
        reason: PublishSubscribeOpenOrCreateError::SystemInFlux,
    })
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

fn refused<T: Message>(
    node: &Node<ipc::Service>,
    name: &ServiceName,
    reason: PublishSubscribeOpenOrCreateError,
) -> JoinReason {
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
        ) => JoinReason::OtherContract {
            service,
            found: found::<T>(node, name),
            ours: T::TYPE_NAME,
            reason,
        },
        _ => JoinReason::Service { service, reason },
    }
}

/// Type name of the message that the domain's service carries.
fn found<T: Message>(node: &Node<ipc::Service>, name: &ServiceName) -> String {
    let pattern = MessagingPattern::PublishSubscribe;
    let Ok(Some(service)) = ipc::Service::details(name, node.config(), pattern) else {
        return "unknown".to_owned();
    };
    let types = service.static_details.publish_subscribe();
    let types = types.message_type_details();
    let message = match T::PAYLOAD {
        Payload::Message => types.payload,
        Payload::Bytes { .. } => types.user_header,
    };
    message.type_name().to_string()
}
