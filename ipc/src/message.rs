//! What every message has: a stamp, a service, and a check on reception.

use core::fmt::Debug;

use crate::field::{Meaning, Stamp, Values, Wire};

/// Quality of service of one service; the same for everybody who opens it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Messages that a publisher keeps for subscribers that come later.
    pub history: usize,
    /// Largest buffer that a subscriber may ask for. When it is full, the oldest message is dropped.
    pub buffer: usize,
    /// Most subscribers.
    pub subscribers: usize,
    /// Most publishers.
    pub publishers: usize,
}

/// A message of the contract. Only this crate implements it.
pub trait Message: Wire + Debug {
    /// Name of the service that carries it.
    const SERVICE: &'static str;
    /// Its topic in recordings.
    const TOPIC: &'static str;
    /// Who publishes it.
    const PUBLISHER: &'static str;
    /// Quality of service.
    const QOS: Qos;

    /// The head.
    fn stamp(&self) -> &Stamp;

    /// The head, to be filled in.
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// Checks a message from another process: sequence number, counts, codes, and that numbers are finite.
    ///
    /// # Errors
    /// [`Invalid`] names the first field that is wrong.
    fn check(&self) -> Result<(), Invalid> {
        check(self, false)
    }
}

/// Why a received message was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum Invalid {
    /// A sequence number of zero.
    #[error("{service}: sequence = 0; allowed: 1 and more")]
    Sequence { service: &'static str },
    /// A count outside its range.
    #[error("{service}: {field} = {found}; allowed: {least} to {most}")]
    Count {
        service: &'static str,
        field: &'static str,
        found: u32,
        least: u32,
        most: u32,
    },
    /// A number that is NaN or infinite.
    #[error("{service}: {field}[{index}] = {found}; allowed: finite numbers")]
    NotFinite {
        service: &'static str,
        field: &'static str,
        index: usize,
        found: f64,
    },
    /// A code that the contract does not know.
    #[error("{service}: {field} = {found}; allowed: the codes of CONTRACT.md")]
    Code {
        service: &'static str,
        field: &'static str,
        found: u32,
    },
}

/// Checks head and fields by their [`Meaning`]; `AnyCode` only if `every_code`.
pub(crate) fn check<T: Message>(message: &T, every_code: bool) -> Result<(), Invalid> {
    let service = T::SERVICE;
    if message.stamp().sequence == 0 {
        return Err(Invalid::Sequence { service });
    }
    let mut count = 0;
    for (field, values) in message.fields() {
        let is_any = matches!(field.meaning, Meaning::AnyCode(_));
        let field_name = field.name;
        match (field.meaning, values) {
            (Meaning::Range(least, most), Values::U32(&[found])) => {
                if !(least..=most).contains(&found) {
                    return Err(Invalid::Count {
                        service,
                        field: field_name,
                        found,
                        least,
                        most,
                    });
                }
                count = found as usize;
            }
            (Meaning::Code(table) | Meaning::AnyCode(table), Values::U32(&[found]))
                if table.get(found).is_none() && (every_code || !is_any) =>
            {
                return Err(Invalid::Code {
                    service,
                    field: field_name,
                    found,
                });
            }
            (Meaning::Finite, Values::F64(numbers)) => finite(service, field_name, numbers)?,
            (Meaning::FinitePairs, Values::F64(numbers)) => {
                let used = numbers.len().min(2 * count);
                finite(service, field_name, &numbers[..used])?;
            }
            _ => (),
        }
    }
    Ok(())
}

fn finite(service: &'static str, field: &'static str, numbers: &[f64]) -> Result<(), Invalid> {
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

/// Declares a message: a struct on the wire (see `wire!`), then its service, publisher and quality of service.
macro_rules! message {
    ($(#[doc = $doc:literal])+ $name:ident: $type_name:tt { $($fields:tt)+ }
     $service:literal from $publisher:literal: $qos:expr) => {
        $crate::field::wire! {
            $(#[doc = $doc])+
            #[doc = concat!("\nService `", $service, "`.")]
            $name: $type_name { $($fields)+ }
        }

        impl $crate::message::Message for $name {
            const SERVICE: &'static str = $service;
            const TOPIC: &'static str = concat!("/", $service);
            const PUBLISHER: &'static str = $publisher;
            const QOS: $crate::message::Qos = $qos;

            fn stamp(&self) -> &$crate::field::Stamp {
                &self.stamp
            }

            fn stamp_mut(&mut self) -> &mut $crate::field::Stamp {
                &mut self.stamp
            }
        }
    };
}
pub(crate) use message;
