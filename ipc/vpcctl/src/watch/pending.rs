//! A request whose answer has not come yet, so that the picture goes on meanwhile.

use std::time::{Duration, Instant};

use ipc::{Action, AskError, Domain, OperatorPorts, Request};

use crate::exit::Failure;
use crate::request;

/// How long an answer is waited for.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long until `stop` is sent again.
const AGAIN: Duration = Duration::from_millis(250);

/// A request under way. The operator's place is taken for as long as that lasts.
#[derive(Debug)]
pub struct Pending {
    ports: OperatorPorts,
    request: Request,
    since: Instant,
    sent: Instant,
}

impl Pending {
    /// Sends the request.
    ///
    /// # Errors
    /// As [`OperatorPorts::open`] and publishing.
    pub fn ask(domain: &Domain, request: Request) -> Result<Self, Failure> {
        let mut ports = OperatorPorts::open(domain)?;
        ports.requests.publish(&request).map_err(AskError::from)?;
        let now = Instant::now();
        Ok(Self {
            ports,
            request,
            since: now,
            sent: now,
        })
    }

    /// What was asked.
    pub fn action(&self) -> String {
        let action = self.request.action();
        action.map_or_else(|| "unknown".to_owned(), |action| action.to_string())
    }

    /// One line when it is over: the outcome, or why none is known.
    pub fn poll(&mut self) -> Option<String> {
        match self.look() {
            Ok(line) => line,
            Err(error) => Some(format!("{}: {error}", self.action())),
        }
    }

    fn look(&mut self) -> Result<Option<String>, AskError> {
        while let Some(reply) = self.ports.replies.oldest()? {
            if reply.id == self.request.id {
                let (line, _) = request::verdict(&reply.message);
                return Ok(Some(line.trim_end().to_owned()));
            }
        }
        if self.since.elapsed() >= PATIENCE {
            return Ok(Some(format!("{}: no answer", self.action())));
        }
        let is_stop = self.request.action == Action::Stop.code();
        if is_stop && self.sent.elapsed() >= AGAIN {
            self.ports.requests.publish(&self.request)?;
            self.sent = Instant::now();
        } else {
            self.ports.requests.refresh()?;
        }
        Ok(None)
    }
}
