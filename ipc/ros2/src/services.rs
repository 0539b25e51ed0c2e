//! std_srvs/Trigger: arm, disarm, stop. Runs in a thread of its own and waits for nothing, so that
//! no request keeps a stop waiting.

use std::hash::{BuildHasher, RandomState};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use ipc::{Action, Asked, Domain, OperatorPorts, Outcome, Reply, Request};
use ros2_client::RmwRequestId;

use crate::bridge::Event;
use crate::message::TriggerResponse;
use crate::ros::{BATCH, Ros, RosError, TriggerServer};

/// Longest wait for vpcd: it answers within one period.
const PATIENCE: Duration = Duration::from_secs(1);
/// Most requests of vpcd that wait for an answer; more are refused.
const MOST_WAITING: usize = 16;

/// The servers.
pub struct Services {
    stop: TriggerServer,
    asks: [(TriggerServer, Action); 2],
}

impl Services {
    /// Offers them.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn open(ros: &mut Ros) -> Result<Self, RosError> {
        Ok(Self {
            stop: ros.trigger("stop")?,
            asks: [
                (ros.trigger("arm")?, Action::Arm),
                (ros.trigger("disarm")?, Action::Disarm),
            ],
        })
    }
}

/// An ask of vpcd that waits for its answer.
struct Waiting {
    /// Of [`Services::asks`].
    server: usize,
    from: RmwRequestId,
    request: u64,
    end: Instant,
}

/// Answers requests.
pub struct RequestServer<'a> {
    services: &'a Services,
    directory: PathBuf,
    ports: OperatorPorts,
    ids: RandomState,
    waiting: Vec<Waiting>,
    /// Stops that wait for an answer, and until when.
    stops: Vec<(RmwRequestId, Instant)>,
    /// The newest stop, until a vpcd has obeyed it.
    asked: Option<Asked>,
    /// Nothing but zeros goes out: from a stop on, until a vpcd has obeyed it. Where it could not be
    /// asked for, until vpcd was armed by this service.
    is_stopping: &'a AtomicBool,
    tell: SyncSender<Event>,
}

impl<'a> RequestServer<'a> {
    /// Opens an operator's place in the domain.
    ///
    /// # Errors
    /// [`ipc::OpenError`]: all places are taken.
    pub fn open(
        services: &'a Services,
        domain: &Domain,
        directory: PathBuf,
        is_stopping: &'a AtomicBool,
        tell: SyncSender<Event>,
    ) -> Result<Self, ipc::OpenError> {
        Ok(Self {
            services,
            directory,
            ports: OperatorPorts::open(domain)?,
            ids: RandomState::new(),
            waiting: Vec::new(),
            stops: Vec::new(),
            asked: None,
            is_stopping,
            tell,
        })
    }

    /// Takes what came, answers what is decided, and returns.
    pub fn look(&mut self) {
        self.take_stops();
        for server in 0..self.services.asks.len() {
            self.take_asks(server);
        }
        self.answer_asks();
        self.answer_stops();
    }

    fn take_stops(&mut self) {
        for _ in 0..BATCH {
            let Ok(Some((from, _))) = self.services.stop.receive_request() else {
                return;
            };
            // Zeros go out before vpcd has read the file.
            self.is_stopping.store(true, Ordering::Relaxed);
            match Asked::in_domain(&self.directory) {
                Ok(asked) => {
                    self.asked = Some(asked);
                    match self.stops.len() < MOST_WAITING {
                        true => self.stops.push((from, Instant::now() + PATIENCE)),
                        false => {
                            let words = format!("asked for; {MOST_WAITING} others wait already");
                            respond(&self.services.stop, from, false, words);
                        }
                    }
                }
                Err(why) => respond(&self.services.stop, from, false, why.to_string()),
            }
            self.note("stop, by a service of ROS 2".to_owned());
        }
    }

    fn answer_stops(&mut self) {
        let Some(asked) = &self.asked else {
            return;
        };
        let server = &self.services.stop;
        match asked.is_obeyed() {
            Ok(true) => {
                for (from, _) in self.stops.drain(..) {
                    respond(server, from, true, "stopped".to_owned());
                }
                self.asked = None;
                self.is_stopping.store(false, Ordering::Relaxed);
            }
            Ok(false) => {
                let now = Instant::now();
                for (from, _) in self.stops.extract_if(.., |(_, end)| *end <= now) {
                    respond(server, from, false, asked.not_obeyed(PATIENCE).to_string());
                }
            }
            Err(why) => {
                for (from, _) in self.stops.drain(..) {
                    respond(server, from, false, why.to_string());
                }
            }
        }
    }

    /// For the log, which this thread does not wait for.
    fn note(&self, words: String) {
        let _ = self.tell.try_send(Event::Service(words));
    }

    fn take_asks(&mut self, server: usize) {
        let (trigger, action) = &self.services.asks[server];
        for _ in 0..BATCH {
            let Ok(Some((from, _))) = trigger.receive_request() else {
                return;
            };
            if self.waiting.len() >= MOST_WAITING {
                let words = format!("{MOST_WAITING} requests wait already");
                respond(trigger, from, false, words);
                continue;
            }
            let request = self.ids.hash_one(ipc::now_ns());
            match self.ports.requests.publish(&Request::new(request, *action)) {
                Ok(_) => self.waiting.push(Waiting {
                    server,
                    from,
                    request,
                    end: Instant::now() + PATIENCE,
                }),
                Err(why) => respond(trigger, from, false, why.to_string()),
            }
        }
    }

    fn answer_asks(&mut self) {
        for _ in 0..BATCH {
            // An answer that breaks the contract is none.
            let Ok(Some(reply)) = self.ports.replies.oldest() else {
                break;
            };
            let ours = |waiting: &Waiting| waiting.request == reply.id;
            if let Some(place) = self.waiting.iter().position(ours) {
                let waiting = self.waiting.remove(place);
                let is_done = reply.outcome() == Some(Outcome::Done);
                let is_arm = self.services.asks[waiting.server].1 == Action::Arm;
                if is_done && is_arm && self.asked.is_none() {
                    self.is_stopping.store(false, Ordering::Relaxed);
                }
                self.respond(&waiting, is_done, words(&reply));
            }
        }
        let now = Instant::now();
        while let Some(place) = self.waiting.iter().position(|waiting| waiting.end <= now) {
            let waiting = self.waiting.remove(place);
            let seconds = PATIENCE.as_secs();
            let words = format!("no vpcd of this domain answered within {seconds} s");
            self.respond(&waiting, false, words);
        }
        // For a vpcd that came since then.
        let _ = self.ports.requests.refresh();
    }

    fn respond(&self, waiting: &Waiting, success: bool, message: String) {
        let (server, action) = &self.services.asks[waiting.server];
        self.note(format!("{action}, by a service of ROS 2: {message}"));
        respond(server, waiting.from, success, message);
    }
}

/// What vpcd answered, and its state since.
fn words(reply: &Reply) -> String {
    let word = |text: Option<String>| text.unwrap_or_else(|| "unknown".to_owned());
    let outcome = word(reply.outcome().map(|outcome| outcome.to_string()));
    let state = word(reply.state().map(|state| state.to_string()));
    match reply.hold() {
        Some(hold) if reply.hold != 0 => format!("{outcome}; vpcd is {state}: {hold}"),
        _ => format!("{outcome}; vpcd is {state}"),
    }
}

fn respond(server: &TriggerServer, to: RmwRequestId, success: bool, message: String) {
    if let Err(why) = server.send_response(to, TriggerResponse { success, message }) {
        tracing::warn!("an answer could not be sent: {why:?}");
    }
}
