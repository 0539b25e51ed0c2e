//! What was recorded of each topic, and what was not.

use std::collections::BTreeMap;

use messages::Order;

/// Counts of one topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Account {
    /// Messages in the file.
    pub recorded: u64,
    /// Messages that never reached the recorder, by the sequence numbers.
    pub lost: u64,
    /// Messages that broke the contract; they are not in the file.
    pub refused: u64,
    /// Times that the publisher started again; what was lost meanwhile is not known.
    pub restarts: u64,
}

/// Something that the user should know at once.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum Notice {
    #[error("waiting for vpcd in domain {domain} ...")]
    Waiting { domain: String },
    /// The first cycle came after a wait.
    #[error("recording: vpcd is running")]
    Begun,
    #[error("no scene in this recording, `plot` will need --scene: {reason}")]
    NoScene { reason: String },
    #[error("no configuration in this recording, it cannot be replayed: {reason}")]
    NoConfig { reason: String },
    #[error("{topic}: {missed} messages lost")]
    Lost { topic: &'static str, missed: u64 },
    #[error("{topic}: the publisher started again")]
    Restarted { topic: &'static str },
    /// A message broke the contract.
    #[error("{topic}: a message was refused: {reason}")]
    Refused { topic: &'static str, reason: String },
    /// A page may not connect.
    #[error("a page was refused; if you trust it: --origin {origin}")]
    Origin { origin: String },
}

/// The counts of all topics.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ledger {
    accounts: BTreeMap<String, Account>,
}

impl Ledger {
    /// Counts a message that is recorded; returns what should be told about it.
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

    /// As metadata of the file: `/vpc/cycles.lost` and so on.
    pub fn to_map(&self) -> BTreeMap<String, String> {
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

    fn account(&mut self, topic: &str) -> &mut Account {
        self.accounts.entry(topic.to_owned()).or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_and_told() {
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
        assert_eq!(ledger.of("/b").recorded, 1);
        let map = ledger.to_map();
        assert_eq!((&*map["/a.lost"], &*map["/b.refused"]), ("7", "1"));
    }
}
