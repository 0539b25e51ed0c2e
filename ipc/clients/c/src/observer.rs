//! An observer: receives everything.

use ipc::Subscriber;
use messages::{CycleRecord, Features, Message, Order, RobotState, TwistCommand};

use crate::boundary::{self, Fault, Handle};
use crate::domain::Domain;
use crate::status::Status;

/// Receives everything and sends nothing.
pub type Observer = Handle<ipc::Observer>;

/// Which of the messages that wait is taken.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Take {
    /// The oldest, to get all of them.
    Oldest = 0,
    /// The newest; those before it are dropped.
    Latest = 1,
}

/// Opens an observer's ports. VPC_STATUS_TAKEN if a service has all the subscribers that it allows.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_observer_open(domain: *mut Domain, out: *mut *mut Observer) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, ipc::Observer::open(domain)?) }
    })
}

/// Closes an observer's ports. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_observer_close(observer: *mut Observer) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(observer, "observer") })
}

/// Takes a message from one of the observer's subscribers.
///
/// # Safety
/// `observer` is NULL or an open handle; `out` and `missed` are NULL or point to writable memory.
unsafe fn take<T: Message>(
    observer: *mut Observer,
    subscriber: impl FnOnce(&mut ipc::Observer) -> &mut Subscriber<T>,
    take: u32,
    out: *mut T,
    missed: *mut u64,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the caller's promise.
        let subscriber = subscriber(unsafe { boundary::handle(observer, "observer") }?);
        let service = T::SERVICE;
        if out.is_null() {
            return Err(Fault::null("out"));
        }
        let message = match take {
            0 => subscriber.oldest()?,
            1 => subscriber.latest()?,
            other => {
                let words = format!("{service}: take = {other}; allowed: 0 oldest, 1 latest");
                return Err(Fault::new(Status::Argument, words));
            }
        };
        let message = message.ok_or_else(|| {
            Fault::new(Status::Nothing, format!("{service}: no message is waiting"))
        })?;
        let gap = match message.order {
            Order::Gap { missed } => missed,
            _ => 0,
        };
        // SAFETY: the caller's promise.
        unsafe { boundary::put_if_asked(missed, gap) };
        // SAFETY: the caller's promise.
        unsafe { boundary::put(out, "out", message.message) }
    })
}

/// What the camera saw; VPC_STATUS_NOTHING if no message is waiting. `take` is a vpc_take. `missed`
/// (may be NULL) gets the number of messages that were lost or dropped since the one before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_observer_features(
    observer: *mut Observer,
    take: u32,
    out: *mut Features,
    missed: *mut u64,
) -> Status {
    // SAFETY: the header asks for a handle and places.
    unsafe { self::take(observer, |ports| &mut ports.features, take, out, missed) }
}

/// What the controller commanded; as vpc_observer_features.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_observer_twist(
    observer: *mut Observer,
    take: u32,
    out: *mut TwistCommand,
    missed: *mut u64,
) -> Status {
    // SAFETY: the header asks for a handle and places.
    unsafe { self::take(observer, |ports| &mut ports.twist, take, out, missed) }
}

/// Where the robot is; as vpc_observer_features.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_observer_robot(
    observer: *mut Observer,
    take: u32,
    out: *mut RobotState,
    missed: *mut u64,
) -> Status {
    // SAFETY: the header asks for a handle and places.
    unsafe { self::take(observer, |ports| &mut ports.robot, take, out, missed) }
}

/// What a cycle of the controller did; as vpc_observer_features.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_observer_cycle(
    observer: *mut Observer,
    take: u32,
    out: *mut CycleRecord,
    missed: *mut u64,
) -> Status {
    // SAFETY: the header asks for a handle and places.
    unsafe { self::take(observer, |ports| &mut ports.cycles, take, out, missed) }
}
