//! Where a received message stands in the sequence of its service.

use core::ops::Deref;

use crate::field::Stamp;

/// Where a message stands in the sequence of its service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The first one that this subscriber sees.
    First,
    /// The successor of the one before.
    Next,
    /// So many between were missed or overwritten.
    Gap {
        #[allow(missing_docs)]
        missed: u64,
    },
    /// The same one again, by the history of the service.
    Repeated,
    /// The publisher started again.
    Restarted,
}

impl Order {
    /// Where `stamp` stands after `last`.
    pub fn after(last: Option<Stamp>, stamp: &Stamp) -> Self {
        let Some(last) = last else { return Self::First };
        match stamp.sequence.checked_sub(last.sequence) {
            None => Self::Restarted,
            Some(0) if stamp.published_ns == last.published_ns => Self::Repeated,
            Some(0) => Self::Restarted,
            Some(1) => Self::Next,
            Some(n) => Self::Gap { missed: n - 1 },
        }
    }
}

/// A received message that passed its checks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received<T> {
    /// The message.
    pub message: T,
    /// Where it stands in the sequence of its service.
    pub order: Order,
}

impl<T> Deref for Received<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.message
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_repeats_and_restarts_are_told_apart() {
        let stamp = |sequence, published_ns| Stamp {
            sequence,
            published_ns,
            data_ns: 0,
        };
        let after = |sequence, published_ns| {
            Order::after(Some(stamp(5, 500)), &stamp(sequence, published_ns))
        };
        assert_eq!(Order::after(None, &stamp(5, 500)), Order::First);
        assert_eq!(after(6, 600), Order::Next);
        assert_eq!(after(9, 600), Order::Gap { missed: 3 });
        assert_eq!(after(5, 500), Order::Repeated);
        assert_eq!(after(5, 900), Order::Restarted);
        assert_eq!(after(1, 600), Order::Restarted);
    }
}
