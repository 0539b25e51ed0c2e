//! `vpcctl serve`: a live view in the browser.

mod feed;

use std::fs::File;
use std::io::{self, Read};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use ipc::{Action, Domain};

use crate::exit::{Exit, Failure};
use crate::http::{Request, Response, Server};
use crate::output;
use crate::presence::Presence;
use crate::request;
use crate::stage::Stage;
use crate::watcher::Watcher;

use feed::{Feed, Teller};

/// The page: plain JavaScript, nothing from elsewhere.
const PAGE: &str = include_str!("page.html");
/// Time between two events.
const EVENT: Duration = Duration::from_millis(50);
/// Time between two looks for the daemon's process.
const LOOK: Duration = Duration::from_secs(1);
/// Patience with the daemon's answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// What is served.
#[derive(Clone, Debug)]
pub struct Service {
    /// The domain's directory.
    pub directory: PathBuf,
    /// Where to listen.
    pub address: SocketAddr,
    /// Whether the page may command.
    pub control: bool,
}

/// Serves the page until `end`.
///
/// # Errors
/// [`Failure::NoDaemon`] where there is no domain; what stands against joining, watching and listening.
pub fn run(service: &Service, stage: &Stage, end: &AtomicBool) -> Result<Exit, Failure> {
    let directory = service.directory.as_path();
    if Presence::of(directory) == Presence::NoDomain {
        let domain = directory.display().to_string();
        return Err(Failure::NoDaemon { domain });
    }
    let domain = Domain::join(directory)?;
    let mut watcher = Watcher::open(&domain)?;
    watcher.poll()?;
    let token = service.control.then(token).transpose()?;
    let desk = Arc::new(Desk {
        directory: domain.directory().to_owned(),
        feed: Arc::new(Feed::default()),
        stage: Mutex::new(String::new()),
        token,
    });
    desk.place(stage, &watcher);
    let clerk = Arc::clone(&desk);
    let server = Server::start(service.address, move |request| clerk.answer(request))?;
    // The part behind # stays in the browser: it is not sent, and not logged.
    let token = desk
        .token
        .as_ref()
        .map_or(String::new(), |token| format!("#{token}"));
    output::write(&format!(
        "live view at http://{}/{token}\n",
        server.address()
    ))?;
    let mut teller = Teller::default();
    let mut looked: Option<Instant> = None;
    let mut process = None;
    while !end.load(Ordering::Relaxed) {
        watcher.poll()?;
        if looked.is_none_or(|at| at.elapsed() >= LOOK) {
            process = Presence::of(directory).process();
            desk.place(stage, &watcher);
            looked = Some(Instant::now());
        }
        let event = teller.event(&watcher.view, process, ipc::now_ns());
        desk.feed.tell(&event);
        std::thread::sleep(EVENT);
    }
    Ok(Exit::Ok)
}

/// 128 bits that nobody guesses, as hexadecimal digits.
fn token() -> io::Result<String> {
    let mut bytes = [0; 16];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// What the threads that answer share.
#[derive(Debug)]
struct Desk {
    directory: PathBuf,
    feed: Arc<Feed>,
    stage: Mutex<String>,
    /// `None` where the page may not command.
    token: Option<String>,
}

impl Desk {
    /// Renews what is told of the stage: without a scene it grows with what was seen.
    fn place(&self, stage: &Stage, watcher: &Watcher) {
        let mut told = feed::stage(stage, &watcher.view);
        told["control"] = self.token.is_some().into();
        told["domain"] = self.directory.display().to_string().into();
        told["full"] = watcher.full.clone().into();
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner) = told.to_string();
    }

    fn answer(&self, request: &Request) -> Response {
        if !request.host_is_plain() {
            return Response::refusal(403, "host not allowed: ask by address or as localhost");
        }
        match (request.method.as_str(), request.path.as_str()) {
            ("GET" | "HEAD", "/") => {
                Response::whole(200, "text/html; charset=utf-8", PAGE.to_owned())
            }
            ("GET" | "HEAD", "/stage") => {
                let stage = self
                    .stage
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .clone();
                Response::whole(200, "application/json", stage)
            }
            ("GET", "/events") => self.events(),
            ("POST", "/arm") => self.command(request, Action::Arm),
            ("POST", "/disarm") => self.command(request, Action::Disarm),
            ("POST", "/stop") => self.command(request, Action::Stop),
            ("GET" | "HEAD", _) => Response::refusal(404, "see /"),
            _ => Response::refusal(405, "allowed: GET"),
        }
    }

    fn events(&self) -> Response {
        let feed = Arc::clone(&self.feed);
        let mut number = feed.end();
        Response::Events(Box::new(move || {
            // A comment where nothing is new keeps the connection, or finds that the page has left.
            let (text, next) = feed
                .next(number)
                .unwrap_or_else(|| (": idle\n\n".into(), number));
            number = next;
            Some(text)
        }))
    }

    /// Commands come from our own page, with the token that only who started us knows.
    fn command(&self, request: &Request, action: Action) -> Response {
        let Some(token) = &self.token else {
            return Response::refusal(403, "only watching: start with --control to command");
        };
        if !request.is_same_origin() {
            return Response::refusal(403, "not from this page");
        }
        let known = request
            .field("x-vpc-token")
            .is_some_and(|found| equal(found, token));
        if !known {
            return Response::refusal(403, "wrong token: open the address that vpcctl printed");
        }
        match request::send(&self.directory, &request::plain(action), PATIENCE) {
            Ok(reply) => {
                let (line, exit) = request::verdict(&reply);
                let status = if exit == Exit::Ok { 200 } else { 409 };
                Response::whole(status, "text/plain; charset=utf-8", line)
            }
            Err(failure) => Response::refusal(503, &failure.to_string()),
        }
    }
}

/// Whether two words are equal, in a time that does not tell how far they are.
fn equal(a: &str, b: &str) -> bool {
    let differing = a
        .bytes()
        .zip(b.bytes())
        .fold(0, |all, (a, b)| all | (a ^ b));
    a.len() == b.len() && differing == 0
}

/// Refuses commands over an address that other machines reach: token and commands would be readable on the way.
///
/// # Errors
/// [`Failure::ExposedControl`].
pub fn allow(service: &Service) -> Result<(), Failure> {
    match service.control && !service.address.ip().is_loopback() {
        true => Err(Failure::ExposedControl),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_long_differ_and_are_compared_whole() {
        let (a, b) = (token().unwrap(), token().unwrap());
        assert_eq!(a.len(), 32);
        assert_ne!(a, b);
        assert!(equal(&a, &a) && !equal(&a, &b) && !equal(&a, &a[..31]) && !equal("", &a));
    }

    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        for words in ["http://", "https://", "src=", "@import", "innerHTML"] {
            assert!(!PAGE.contains(words), "{words}");
        }
    }
}
