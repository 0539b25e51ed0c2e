//! The services of the contract.

use crate::field::Struct;
use crate::message::{Message, Payload, Qos};
use crate::{
    CycleRecord, DesiredTwist, Features, ImageHeader, Reply, Request, RobotState, Snapshot,
    TwistCommand,
};

/// One service of the contract.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct Service {
    pub name: &'static str,
    /// The role that publishes.
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

/// All services of the contract.
pub const SERVICES: &[Service] = &[
    Service::of::<Features>(),
    Service::of::<TwistCommand>(),
    Service::of::<RobotState>(),
    Service::of::<DesiredTwist>(),
    Service::of::<CycleRecord>(),
    Service::of::<Snapshot>(),
    Service::of::<Request>(),
    Service::of::<Reply>(),
    Service::of::<ImageHeader>(),
];
