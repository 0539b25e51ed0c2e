//! The ports of who watches, feeding a [`View`].

use ipc::{CycleRecord, Domain, Features, Message, OpenError, ReceiveError, Received};
use ipc::{RobotState, Subscriber};

use crate::view::View;

/// Most messages taken from one port in one go: a publisher may be faster than we are.
const BATCH: usize = 4096;

/// Watches a daemon. Twists are read from the records of its cycles, so that no port is taken for them.
#[derive(Debug)]
pub struct Watcher {
    cycles: Option<Subscriber<CycleRecord>>,
    robot: Option<Subscriber<RobotState>>,
    features: Option<Subscriber<Features>>,
    /// What is known by now.
    pub view: View,
    /// Services whose subscribers' places were all taken; they are left out.
    pub full: Vec<&'static str>,
}

impl Watcher {
    /// Opens the ports.
    ///
    /// # Errors
    /// [`OpenError`], but not for services that are full: see [`Watcher::full`].
    pub fn open(domain: &Domain) -> Result<Self, OpenError> {
        let mut full = Vec::new();
        Ok(Self {
            cycles: optional(domain, CycleRecord::QOS.buffer, &mut full)?,
            robot: optional(domain, 1, &mut full)?,
            features: optional(domain, 1, &mut full)?,
            view: View::default(),
            full,
        })
    }

    /// Takes in all that came since the last call; does not wait.
    ///
    /// # Errors
    /// A connection that failed. Messages that break the contract are counted, and left out.
    pub fn poll(&mut self) -> Result<(), ReceiveError> {
        if let Some(port) = &mut self.cycles {
            for _ in 0..BATCH {
                match heard(port.oldest(), &mut self.view.refused)? {
                    Heard::Message(record) => self.view.cycle(&record),
                    Heard::Refused => (),
                    Heard::Nothing => break,
                }
            }
        }
        if let Some(port) = &mut self.robot {
            match heard(port.latest(), &mut self.view.refused)? {
                Heard::Message(state) => self.view.robot = Some(state.message),
                Heard::Refused | Heard::Nothing => (),
            }
        }
        if let Some(port) = &mut self.features {
            match heard(port.latest(), &mut self.view.refused)? {
                Heard::Message(features) => self.view.features = Some(features.message),
                Heard::Refused | Heard::Nothing => (),
            }
        }
        Ok(())
    }
}

enum Heard<T> {
    Message(Received<T>),
    Refused,
    Nothing,
}

fn heard<T>(
    result: Result<Option<Received<T>>, ReceiveError>,
    refused: &mut u64,
) -> Result<Heard<T>, ReceiveError> {
    match result {
        Ok(Some(message)) => Ok(Heard::Message(message)),
        Ok(None) => Ok(Heard::Nothing),
        Err(ReceiveError::Invalid { .. }) => {
            *refused += 1;
            Ok(Heard::Refused)
        }
        Err(error) => Err(error),
    }
}

fn optional<T: Message>(
    domain: &Domain,
    buffer: usize,
    full: &mut Vec<&'static str>,
) -> Result<Option<Subscriber<T>>, OpenError> {
    match domain.subscriber(buffer) {
        Ok(port) => Ok(Some(port)),
        Err(OpenError::Full { service, .. }) => {
            full.push(service);
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
