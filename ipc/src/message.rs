//! What every message has: a stamp, a service, and a check on reception.

use core::fmt::Debug;

use iceoryx2::prelude::ZeroCopySend;
use serde::{Deserialize, Serialize};

use crate::domain::Factories;

/// Head of every message.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend, Serialize, Deserialize)]
#[type_name("vpc/Stamp/1")]
pub struct Stamp {
    /// Number of the message, from 1, by one more for each message of one publisher; a publisher that restarts
    /// starts from 1 again.
    pub sequence: u64,
    /// When the message was published, CLOCK_MONOTONIC, ns.
    pub published_ns: u64,
    /// The instant that the data describe, CLOCK_MONOTONIC, ns: for features the middle of the exposure.
    pub data_ns: u64,
}

const _: () = {
    assert!(core::mem::size_of::<Stamp>() == 24);
    assert!(core::mem::offset_of!(Stamp, sequence) == 0);
    assert!(core::mem::offset_of!(Stamp, published_ns) == 8);
    assert!(core::mem::offset_of!(Stamp, data_ns) == 16);
};

/// Quality of service of one service; the same for everybody who opens it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Messages that a publisher keeps for subscribers that come later.
    pub history: usize,
    /// Longest buffer that a subscriber may ask for; the oldest message falls out of a full one.
    pub buffer: usize,
    /// Most subscribers.
    pub subscribers: usize,
    /// Most publishers: one, but where several operators may ask.
    pub publishers: usize,
}

/// A message of the contract. Implemented by the messages of this crate only.
pub trait Message: ZeroCopySend + Copy + Debug + Sized + 'static {
    /// Name of the service that carries it.
    const SERVICE: &'static str;
    /// Quality of service.
    const QOS: Qos;

    /// The head.
    fn stamp(&self) -> &Stamp;

    /// The head, to be filled in.
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// Checks a message that came from somebody else.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    fn check(&self) -> Result<(), Invalid>;

    #[doc(hidden)]
    fn factory(factories: &Factories) -> &crate::domain::Factory<Self>;
}

/// Why a received message was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Invalid {
    /// A sequence number of zero.
    #[error("{service}: sequence = 0; allowed: 1 and more")]
    Sequence {
        /// The service.
        service: &'static str,
    },
    /// A count outside its range.
    #[error("{service}: {field} = {found}; allowed: {least} to {most}")]
    Count {
        /// The service.
        service: &'static str,
        /// The field.
        field: &'static str,
        /// What was found.
        found: u32,
        /// Least value allowed.
        least: u32,
        /// Greatest value allowed.
        most: u32,
    },
    /// A number that is NaN or infinite.
    #[error("{service}: {field}[{index}] = {found}; allowed: finite numbers")]
    NotFinite {
        /// The service.
        service: &'static str,
        /// The field.
        field: &'static str,
        /// Index within the field.
        index: usize,
        /// What was found.
        found: f64,
    },
    /// A code that the contract does not know.
    #[error("{service}: {field} = {found}; allowed: the codes of CONTRACT.md")]
    Code {
        /// The service.
        service: &'static str,
        /// The field.
        field: &'static str,
        /// What was found.
        found: u32,
    },
}

/// What is alike in every implementation of [`Message`]: where the head is, and which of a domain's services carries the
/// message.
macro_rules! carried_by {
    ($service:ident) => {
        fn stamp(&self) -> &crate::message::Stamp {
            &self.stamp
        }

        fn stamp_mut(&mut self) -> &mut crate::message::Stamp {
            &mut self.stamp
        }

        fn factory(factories: &crate::domain::Factories) -> &crate::domain::Factory<Self> {
            &factories.$service
        }
    };
}
pub(crate) use carried_by;

/// Checks the head, which every message shares.
pub(crate) fn check_stamp(service: &'static str, stamp: &Stamp) -> Result<(), Invalid> {
    match stamp.sequence {
        0 => Err(Invalid::Sequence { service }),
        _ => Ok(()),
    }
}

/// Checks that numbers are finite.
pub(crate) fn check_finite(
    service: &'static str,
    field: &'static str,
    numbers: &[f64],
) -> Result<(), Invalid> {
    match numbers.iter().position(|x| !x.is_finite()) {
        Some(index) => Err(Invalid::NotFinite {
            service,
            field,
            index,
            found: numbers[index],
        }),
        None => Ok(()),
    }
}

/// Checks that a count lies in its range.
pub(crate) fn check_count(
    service: &'static str,
    field: &'static str,
    found: u32,
    range: core::ops::RangeInclusive<usize>,
) -> Result<(), Invalid> {
    if range.contains(&(found as usize)) {
        return Ok(());
    }
    Err(Invalid::Count {
        service,
        field,
        found,
        least: *range.start() as u32,
        most: *range.end() as u32,
    })
}

/// Checks that a code is one that the contract knows.
pub(crate) fn check_code(
    service: &'static str,
    field: &'static str,
    found: u32,
    known: bool,
) -> Result<(), Invalid> {
    if known {
        return Ok(());
    }
    Err(Invalid::Code {
        service,
        field,
        found,
    })
}

/// Declares an enumeration whose numbers travel as `u32`: a bit pattern from another process is a number first, and
/// becomes a value by `from_code` only where the contract knows it.
macro_rules! codes {
    ($(#[$outer:meta])* $name:ident { $($(#[$inner:meta])* $variant:ident = $code:literal => $text:literal,)+ }) => {
        $(#[$outer])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[repr(u32)]
        pub enum $name {
            $($(#[$inner])* $variant = $code,)+
        }

        impl $name {
            /// The number that travels.
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// The value of a number; `None` where the contract does not know it.
            pub const fn from_code(code: u32) -> Option<Self> {
                match code {
                    $($code => Some(Self::$variant),)+
                    _ => None,
                }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(match self {
                    $(Self::$variant => $text,)+
                })
            }
        }
    };
}
pub(crate) use codes;
