//! The ports of an observer, feeding a [`View`].

use std::path::Path;

use ipc::{Domain, Image, ImageSubscriber, OpenError};
use ipc::{ReceiveError, Subscriber};
use messages::RobotState;
use messages::{CycleRecord, Features, Message};

use crate::failure::Failure;
use crate::presence;
use crate::view::View;

/// Most messages taken from one port in one go: a publisher may be faster than we are.
const BATCH: usize = 4096;

/// Watches a daemon. Twists are read from the records of its cycles, so that no port is taken for
/// them.
#[derive(Debug)]
pub struct Watcher {
    /// The domain that is watched.
    pub domain: Domain,
    /// Services that are left out because all subscribers' slots were taken.
    pub full: Vec<&'static str>,
    cycles: Option<Subscriber<CycleRecord>>,
    robot: Option<Subscriber<RobotState>>,
    features: Option<Subscriber<Features>>,
    images: Option<ImageSubscriber>,
    /// The newest image.
    pub image: Option<Image>,
}

impl Watcher {
    /// Joins the domain in this directory and opens the ports.
    ///
    /// # Errors
    /// As [`presence::join`], and [`OpenError`]; services that are full are no error.
    pub fn open(directory: &Path) -> Result<Self, Failure> {
        let domain = presence::join(directory)?;
        let mut full = Vec::new();
        Ok(Self {
            cycles: optional(&domain, CycleRecord::QOS.buffer, &mut full)?,
            robot: optional(&domain, 1, &mut full)?,
            features: optional(&domain, 1, &mut full)?,
            images: unless_full(domain.image_subscriber(), &mut full)?,
            image: None,
            domain,
            full,
        })
    }

    /// Takes in all that came since the last call; does not wait. Messages that break the contract
    /// are counted and left out.
    ///
    /// # Errors
    /// A connection that failed.
    pub fn poll(&mut self, view: &mut View) -> Result<(), ReceiveError> {
        if let Some(port) = &mut self.cycles {
            for _ in 0..BATCH {
                match port.oldest() {
                    Ok(Some(record)) => view.cycle(&record),
                    Ok(None) => break,
                    Err(ReceiveError::Invalid { .. }) => view.refused += 1,
                    Err(error) => return Err(error),
                }
            }
        }
        let refused = &mut view.refused;
        if let Some(port) = &mut self.robot
            && let Some(state) = valid(port.latest(), refused)?
        {
            view.robot = Some(state.message);
        }
        if let Some(port) = &mut self.features
            && let Some(features) = valid(port.latest(), refused)?
        {
            view.features = Some(features.message);
        }
        if let Some(port) = &mut self.images
            && let Some(image) = valid(port.latest(), refused)?
        {
            view.add_image(image.header(), image.order());
            self.image = Some(image);
        }
        Ok(())
    }
}

/// The message, if it keeps the contract; else it is counted.
fn valid<T>(
    result: Result<Option<T>, ReceiveError>,
    refused: &mut u64,
) -> Result<Option<T>, ReceiveError> {
    match result {
        Err(ReceiveError::Invalid { .. }) => {
            *refused += 1;
            Ok(None)
        }
        result => result,
    }
}

fn optional<T: Message>(
    domain: &Domain,
    buffer: usize,
    full: &mut Vec<&'static str>,
) -> Result<Option<Subscriber<T>>, OpenError> {
    unless_full(domain.subscriber(buffer), full)
}

fn unless_full<P>(
    opened: Result<P, OpenError>,
    full: &mut Vec<&'static str>,
) -> Result<Option<P>, OpenError> {
    match opened {
        Ok(port) => Ok(Some(port)),
        Err(OpenError::Full { service, .. }) => {
            full.push(service);
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
