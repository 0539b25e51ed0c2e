//! std_srvs/Trigger: arm, arm_despite, disarm, stop, teach. Runs in a thread of its own and
//! waits for nothing, so that no request keeps a stop waiting.

use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use ipc::{Asked, Domain, OperatorPorts};
use messages::{Action, Outcome, Reply, Request};
use ros2_client::RmwRequestId;

use crate::event::Event;
use crate::message::TriggerResponse;
use crate::ros::{BATCH, Ros, RosError, TriggerServer};

/// Longest wait for vpcd: it answers within one period.
const PATIENCE: Duration = Duration::from_secs(1);
/// Most requests of vpcd that wait for an answer; more are refused.
const MOST_WAITING: usize = 16;

/// Of a request that cannot be read.
const UNREADABLE: &str = "its request is of another middleware: is the key services right?";

/// The servers.
pub struct Services {
    stop: TriggerServer,
    asks: [(TriggerServer, Action); 3],
    teach: TriggerServer,
}

/// Of [`Services::asks`]: arms in spite of the stop or disarm that the last refusal of `arm` has
/// told.
const ARM_DESPITE: usize = 2;

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
                (ros.trigger("arm_despite")?, Action::Arm),
            ],
            teach: ros.trigger("teach")?,
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
    /// Whether a stop was asked for since.
    is_before_stop: bool,
}

/// Answers requests.
pub struct RequestServer<'a> {
    services: &'a Services,
    directory: PathBuf,
    ports: OperatorPorts,
    ids: RandomState,
    waiting: Vec<Waiting>,
    /// The veto that the last refusal of `arm` has told.
    told_veto: u32,
    /// Stops that wait for an answer, and until when.
    stops: Vec<(RmwRequestId, Instant)>,
    /// A goal that is being taught, by a program of its own, and for whom.
    teaching: Option<(RmwRequestId, Child)>,
    /// The newest stop, until a vpcd has obeyed it.
    asked: Option<Asked>,
    /// Nothing but zeros goes out: from a stop on, until a vpcd has obeyed it, or was armed by this
    /// service at a later request.
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
            told_veto: 0,
            stops: Vec::new(),
            teaching: None,
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
        self.take_teaching();
        self.answer_asks();
        self.answer_stops();
        self.answer_teaching();
    }

    fn take_stops(&mut self) {
        for _ in 0..BATCH {
            let from = match self.services.stop.receive_request() {
                Ok(None) => return,
                Ok(Some((from, _))) => Some(from),
                // The sender cannot be read, but the request is clear.
                Err(_) => None,
            };
            let asked = self.ask_for_a_stop();
            self.note("stop, by a service of ROS 2".to_owned());
            let Some(from) = from else {
                let words = asked.map_or_else(|why| format!("; {why}"), |()| String::new());
                self.note(format!("a stop cannot be answered: {UNREADABLE}{words}"));
                continue;
            };
            match asked {
                Err(words) => self.respond(&self.services.stop, from, false, words),
                Ok(()) if self.stops.len() < MOST_WAITING => {
                    self.stops.push((from, Instant::now() + PATIENCE));
                }
                Ok(()) => {
                    let words = format!("asked for; {MOST_WAITING} others wait already");
                    self.respond(&self.services.stop, from, false, words);
                }
            }
        }
    }

    fn ask_for_a_stop(&mut self) -> Result<(), String> {
        // Zeros go out before vpcd has read the file.
        self.is_stopping.store(true, Ordering::Relaxed);
        for waiting in &mut self.waiting {
            waiting.is_before_stop = true;
        }
        let asked = Asked::in_domain(&self.directory);
        self.asked = Some(asked.map_err(|why| why.to_string())?);
        Ok(())
    }

    fn answer_stops(&mut self) {
        let Some(asked) = &self.asked else {
            return;
        };
        let now = Instant::now();
        let (is_obeyed, words) = match asked.is_obeyed() {
            Ok(true) => (true, "stopped".to_owned()),
            Ok(false) => (false, asked.not_obeyed(PATIENCE).to_string()),
            Err(why) => (false, why.to_string()),
        };
        let is_decided = |(_, end): &mut (_, Instant)| is_obeyed || *end <= now;
        for (from, _) in self.stops.extract_if(.., is_decided).collect::<Vec<_>>() {
            self.respond(&self.services.stop, from, is_obeyed, words.clone());
        }
        if is_obeyed {
            self.asked = None;
            self.is_stopping.store(false, Ordering::Relaxed);
        }
    }

    /// For the log, which this thread does not wait for.
    fn note(&self, words: String) {
        let _ = self.tell.try_send(Event::Service(words));
    }

    fn take_teaching(&mut self) {
        let server = &self.services.teach;
        let from = match server.receive_request() {
            Ok(None) => return,
            Ok(Some((from, _))) => from,
            Err(_) => return self.note(format!("teach is refused: {UNREADABLE}")),
        };
        if self.teaching.is_some() {
            let words = "a goal is being taught already".to_owned();
            return self.respond(server, from, false, words);
        }
        match self.teach() {
            Ok(program) => self.teaching = Some((from, program)),
            Err(why) => self.respond(server, from, false, format!("vpcctl: {why}")),
        }
    }

    /// Starts the program that looks, builds the memory and lets vpcd take both up.
    #[expect(clippy::disallowed_methods, reason = "what it has begun it may end")]
    fn teach(&self) -> io::Result<Child> {
        let mut command = Command::new(program::sibling("vpcctl"));
        command.arg("--domain").arg(&self.directory);
        command.args(["teach", "--replace"]).stdin(Stdio::null());
        // Its few lines fit into a pipe.
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn()
    }

    fn answer_teaching(&mut self) {
        let Some((from, program)) = &mut self.teaching else {
            return;
        };
        let (is_taught, words) = match program.try_wait() {
            Ok(None) => return,
            Ok(Some(status)) if status.success() => (true, "taught; vpcd is disarmed".to_owned()),
            Ok(Some(_)) => {
                let told = program.stderr.take().map(io::read_to_string);
                (false, told.and_then(Result::ok).unwrap_or_default())
            }
            Err(why) => (false, why.to_string()),
        };
        let from = *from;
        self.teaching = None;
        self.note(format!("teach, by a service of ROS 2: {}", words.trim()));
        self.respond(
            &self.services.teach,
            from,
            is_taught,
            words.trim().to_owned(),
        );
    }

    fn take_asks(&mut self, server: usize) {
        let (trigger, action) = &self.services.asks[server];
        for _ in 0..BATCH {
            let from = match trigger.receive_request() {
                Ok(None) => return,
                Ok(Some((from, _))) => from,
                Err(_) => {
                    self.note(format!("{action} is refused: {UNREADABLE}"));
                    continue;
                }
            };
            if self.waiting.len() >= MOST_WAITING {
                let words = format!("{MOST_WAITING} requests wait already");
                self.respond(trigger, from, false, words);
                continue;
            }
            let request = self.ids.hash_one(ipc::now_ns());
            let asked = match server {
                ARM_DESPITE => Request::arm(request, self.told_veto),
                _ => Request::new(request, *action),
            };
            match self.ports.requests.publish(&asked) {
                Ok(_) => self.waiting.push(Waiting {
                    server,
                    from,
                    request,
                    end: Instant::now() + PATIENCE,
                    is_before_stop: false,
                }),
                Err(why) => self.respond(trigger, from, false, why.to_string()),
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
                if is_done && is_arm && !waiting.is_before_stop {
                    self.is_stopping.store(false, Ordering::Relaxed);
                }
                let mut words = words(&reply);
                if reply.outcome() == Some(Outcome::Vetoed) {
                    self.told_veto = reply.veto;
                    words += "; look first, then call arm_despite";
                }
                self.decided(&waiting, is_done, words);
            }
        }
        let now = Instant::now();
        while let Some(place) = self.waiting.iter().position(|waiting| waiting.end <= now) {
            let waiting = self.waiting.remove(place);
            let seconds = PATIENCE.as_secs();
            let words = format!("no vpcd of this domain answered within {seconds} s");
            self.decided(&waiting, false, words);
        }
        // For a vpcd that came since then.
        let _ = self.ports.requests.refresh();
    }

    fn decided(&self, waiting: &Waiting, success: bool, message: String) {
        let (server, action) = &self.services.asks[waiting.server];
        self.note(format!("{action}, by a service of ROS 2: {message}"));
        self.respond(server, waiting.from, success, message);
    }

    fn respond(&self, server: &TriggerServer, to: RmwRequestId, success: bool, message: String) {
        if let Err(why) = server.send_response(to, TriggerResponse { success, message }) {
            self.note(format!("an answer could not be sent: {why:?}"));
        }
    }
}

/// What vpcd answered, and its state since.
fn words(reply: &Reply) -> String {
    let word = |text: Option<String>| text.unwrap_or_else(|| "unknown".to_owned());
    let outcome = word(reply.outcome().map(|outcome| outcome.to_string()));
    let state = word(reply.state().map(|state| state.to_string()));
    match reply.hold() {
        Some(hold) => format!("{outcome}; vpcd is {state}: {hold}"),
        None => format!("{outcome}; vpcd is {state}"),
    }
}
