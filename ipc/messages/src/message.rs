//! What every message has: a stamp, a service, and a check on reception.

use core::fmt::{self, Debug};

use crate::field::{Field, Meaning, Stamp, Values, Wire};

/// Quality of service of one service; the same for every process that opens it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Messages that a publisher keeps for subscribers that come later.
    pub history: usize,
    /// Largest buffer that a subscriber may ask for. When it is full, the oldest message is
    /// dropped.
    pub buffer: usize,
    /// Most subscribers.
    pub subscribers: usize,
    /// Most publishers at a time.
    pub publishers: usize,
}

/// What a service carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload {
    /// The message.
    Message,
    /// A slice of bytes. The message is its user header.
    Bytes {
        /// Alignment of the first byte, in bytes.
        alignment: usize,
    },
}

impl Payload {
    /// Samples that a subscriber may borrow at a time. A message is copied at once. Of slices a
    /// program has one at hand, and takes two more while it looks for the newest.
    pub const fn borrowed(self) -> usize {
        match self {
            Self::Message => 1,
            Self::Bytes { .. } => 3,
        }
    }
}

/// A message of the contract. Only this crate implements it.
pub trait Message: Wire + Debug {
    /// Name of the service that carries it.
    const SERVICE: &'static str;
    /// Its topic in recordings.
    const TOPIC: &'static str;
    /// The role that publishes it.
    const PUBLISHER: &'static str;
    /// Quality of service.
    const QOS: Qos;
    /// What its service carries.
    const PAYLOAD: Payload;

    /// The head.
    fn stamp(&self) -> &Stamp;

    /// The head, to be filled in.
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// Checks a message from another process: sequence number, counts, codes, and that numbers are
    /// finite.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    fn check(&self) -> Result<(), Invalid> {
        check(self, false)
    }
}

/// A received message was refused: one of its numbers is not allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Invalid {
    pub service: &'static str,
    pub field: &'static Field,
    /// Index within the field.
    pub index: usize,
    pub found: f64,
    /// The least and the greatest value, where other fields decide it.
    pub limits: Option<(f64, f64)>,
}

impl core::error::Error for Invalid {}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.service, self.field.name)?;
        if self.field.count > 1 {
            write!(f, "[{}]", self.index)?;
        }
        write!(f, " = {}; allowed: ", self.found)?;
        match self.limits {
            Some((least, most)) if least == most => return write!(f, "{least}"),
            Some((least, f64::INFINITY)) => return write!(f, "{least} or more"),
            Some((least, most)) => return write!(f, "{least} to {most}"),
            None => (),
        }
        match self.field.meaning {
            Meaning::Range(least, most) => write!(f, "{least} to {most}"),
            Meaning::Finite | Meaning::FinitePairs => f.write_str("finite numbers"),
            Meaning::Code(table) | Meaning::AnyCode(table) | Meaning::Bits(table) => {
                for (k, name) in table.names.iter().enumerate() {
                    let comma = if k == 0 { "" } else { ", " };
                    write!(f, "{comma}{} {}", name.number, name.text)?;
                }
                Ok(())
            }
            // A sequence number.
            Meaning::Any => f.write_str("1 and more"),
        }
    }
}

/// Checks head and fields by their [`Meaning`]; `AnyCode` only if `every_code`.
pub(crate) fn check<T: Message>(message: &T, every_code: bool) -> Result<(), Invalid> {
    if message.stamp().sequence == 0 {
        return Err(refuse::<T>(&Stamp::FIELDS[0], 0, 0.0));
    }
    check_fields(message, every_code)
}

fn refuse<T: Message>(field: &'static Field, index: usize, found: f64) -> Invalid {
    Invalid {
        service: T::SERVICE,
        field,
        index,
        found,
        limits: None,
    }
}

/// Checks the fields behind the head.
pub(crate) fn check_fields<T: Message>(message: &T, every_code: bool) -> Result<(), Invalid> {
    let mut count = 0;
    for (field, values) in message.fields() {
        match (field.meaning, values) {
            (Meaning::AnyCode(_), _) if !every_code => (),
            (meaning, Values::U32(&[found])) => {
                if !meaning.allows(found) {
                    return Err(refuse::<T>(field, 0, f64::from(found)));
                }
                if matches!(meaning, Meaning::Range(..)) {
                    count = found as usize;
                }
            }
            (meaning @ (Meaning::Finite | Meaning::FinitePairs), Values::F64(numbers)) => {
                let used = match meaning {
                    Meaning::FinitePairs => 2 * count,
                    _ => numbers.len(),
                };
                let mut used = numbers.iter().enumerate().take(used);
                if let Some((index, found)) = used.find(|(_, x)| !x.is_finite()) {
                    return Err(refuse::<T>(field, index, *found));
                }
            }
            _ => (),
        }
    }
    Ok(())
}

/// Declares a message: a struct on the wire (see `wire!`), then its service, publisher and quality
/// of service; for the header of a slice also `[Payload::Bytes { .. }]`.
macro_rules! message {
    ($(#[doc = $doc:literal])+ $name:ident { $($fields:tt)+ }
     $service:literal $([$payload:expr])? from $publisher:literal: $qos:expr) => {
        $crate::field::wire! {
            $(#[doc = $doc])+
            #[doc = concat!("\nService `", $service, "`.")]
            $name { $($fields)+ }
        }

        impl $crate::message::Message for $name {
            const SERVICE: &'static str = $service;
            const TOPIC: &'static str = concat!("/", $service);
            const PUBLISHER: &'static str = $publisher;
            const QOS: $crate::message::Qos = $qos;
            const PAYLOAD: $crate::message::Payload =
                $crate::message::message!(@payload $($payload)?);

            fn stamp(&self) -> &$crate::field::Stamp {
                &self.stamp
            }

            fn stamp_mut(&mut self) -> &mut $crate::field::Stamp {
                &mut self.stamp
            }
        }
    };
    (@payload) => { $crate::message::Payload::Message };
    (@payload $payload:expr) => { $payload };
}
pub(crate) use message;
