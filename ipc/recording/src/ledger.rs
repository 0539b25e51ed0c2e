//! What was recorded of each topic, and what was not.

use std::collections::BTreeMap;
use std::fmt;

use ipc::Order;

/// Counts of one topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Account {
    /// Messages in the file.
    pub recorded: u64,
    /// Messages that sequence numbers tell of, but that never reached the recorder.
    pub lost: u64,
    /// Messages that broke the contract; they are not in the file.
    pub refused: u64,
    /// Times that the publisher started again; what was lost then cannot be counted.
    pub restarts: u64,
}

/// Something that whoever records should know at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Messages are missing.
    Lost {
        /// The topic.
        topic: &'static str,
        /// How many.
        missed: u64,
    },
    /// A publisher started again.
    Restarted {
        /// The topic.
        topic: &'static str,
    },
    /// A message broke the contract.
    Refused {
        /// The topic.
        topic: &'static str,
        /// What was wrong with it.
        reason: String,
    },
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lost { topic, missed } => write!(f, "{topic}: {missed} messages lost"),
            Self::Restarted { topic } => write!(f, "{topic}: the publisher started again"),
            Self::Refused { topic, reason } => {
                write!(f, "{topic}: a message was refused: {reason}")
            }
        }
    }
}

/// The counts of all topics.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ledger {
    accounts: BTreeMap<String, Account>,
}

impl Ledger {
    /// Counts a message that is to be recorded; `None` where there is nothing to tell about it. A repeated one is not
    /// to be recorded: ask `is_new` first.
    pub fn record(&mut self, topic: &'static str, order: Order) -> Option<Notice> {
        let account = self.account(topic);
        account.recorded += 1;
        match order {
            Order::Gap { missed } => {
                account.lost += missed;
                Some(Notice::Lost { topic, missed })
            }
            Order::Restarted => {
                account.restarts += 1;
                Some(Notice::Restarted { topic })
            }
            Order::First | Order::Next | Order::Repeated => None,
        }
    }

    /// Counts a message that broke the contract.
    pub fn refuse(&mut self, topic: &'static str, reason: String) -> Notice {
        self.account(topic).refused += 1;
        Notice::Refused { topic, reason }
    }

    /// The counts of each topic, by its name.
    pub fn accounts(&self) -> impl Iterator<Item = (&str, &Account)> {
        self.accounts
            .iter()
            .map(|(topic, account)| (topic.as_str(), account))
    }

    /// The counts of one topic.
    pub fn of(&self, topic: &str) -> Account {
        self.accounts.get(topic).copied().unwrap_or_default()
    }

    /// All topics together.
    pub fn total(&self) -> Account {
        self.accounts
            .values()
            .fold(Account::default(), |sum, one| Account {
                recorded: sum.recorded + one.recorded,
                lost: sum.lost + one.lost,
                refused: sum.refused + one.refused,
                restarts: sum.restarts + one.restarts,
            })
    }

    /// As a file's metadata: `topic.count` -> number.
    pub(crate) fn to_map(&self) -> BTreeMap<String, String> {
        let mut map = BTreeMap::new();
        for (topic, account) in &self.accounts {
            for (name, number) in [
                ("recorded", account.recorded),
                ("lost", account.lost),
                ("refused", account.refused),
                ("restarts", account.restarts),
            ] {
                map.insert(format!("{topic}.{name}"), number.to_string());
            }
        }
        map
    }

    pub(crate) fn from_map(map: &BTreeMap<String, String>) -> Self {
        let mut ledger = Self::default();
        for (key, number) in map {
            let (Some((topic, name)), Ok(number)) = (key.rsplit_once('.'), number.parse()) else {
                continue;
            };
            let account = ledger.account(topic);
            match name {
                "recorded" => account.recorded = number,
                "lost" => account.lost = number,
                "refused" => account.refused = number,
                "restarts" => account.restarts = number,
                _ => (),
            }
        }
        ledger
    }

    fn account(&mut self, topic: &str) -> &mut Account {
        self.accounts.entry(topic.to_owned()).or_default()
    }
}

/// Whether a message is another one than the one before: late subscribers are handed the last one again.
pub(crate) fn is_new(order: Order) -> bool {
    order != Order::Repeated
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_and_survive_the_metadata() {
        let mut ledger = Ledger::default();
        assert_eq!(ledger.record("/a", Order::First), None);
        assert_eq!(ledger.record("/a", Order::Next), None);
        let lost = ledger.record("/a", Order::Gap { missed: 7 }).unwrap();
        assert_eq!(lost.to_string(), "/a: 7 messages lost");
        assert!(ledger.record("/b", Order::Restarted).is_some());
        ledger.refuse("/b", "too long".to_owned());
        let account = Account {
            recorded: 3,
            lost: 7,
            ..Account::default()
        };
        assert_eq!(ledger.of("/a"), account);
        assert_eq!(ledger.total().recorded, 4);
        assert_eq!(Ledger::from_map(&ledger.to_map()), ledger);
    }
}
