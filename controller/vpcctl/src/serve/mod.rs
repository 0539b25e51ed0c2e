//! `vpcctl serve`: a live view in the browser.

mod feed;
mod picture;

use std::convert::Infallible;
use std::fs::File;
use std::io::{self, Read};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, Sse};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::stream::{self, Stream, StreamExt};
use messages::Action;
use program::Exit;
use tokio::sync::Semaphore;
use tokio::time::Interval;

use crate::clock::Monotonic;
use crate::failure::Failure;
use crate::image_plane::ImagePlane;
use crate::server::{self, field, is_same_origin, refusal};
use crate::status::{self, Status};
use crate::watcher::Watcher;
use crate::{request, stop, teach};
use feed::Feed;
use picture::Pictures;

/// The page: plain JavaScript, nothing from elsewhere.
const PAGE: &str = include_str!("page.html");
/// Most views at one time: a browser opens six connections to a host, for all its tabs, and a
/// command needs one.
const VIEWS: usize = 5;
/// Time between two events.
const EVENT: Duration = Duration::from_millis(50);
/// What keeps a descriptor.
const SPARE: &str = "/dev/null";
/// How long to wait for the daemon's answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long to look at a goal that is taught.
const LOOK: Duration = Duration::from_secs(1);
/// Pause between two looks whether a stop was obeyed.
const POLL: Duration = Duration::from_millis(2);

/// What the handlers share.
#[derive(Debug)]
struct Server {
    status: Mutex<Status>,
    plane: ImagePlane,
    pictures: Pictures,
    views: Arc<Semaphore>,
    /// `None` if the page may not command.
    token: Option<String>,
    /// A descriptor that is free for the stop file where connections took all others.
    spare: Mutex<Option<File>>,
}

/// Serves the page until a signal comes; with `control`, the page may arm, disarm, stop and
/// teach a goal.
///
/// # Errors
/// The domain cannot be joined or watched; the address cannot be used.
pub fn run(
    mut watcher: Watcher,
    plane: ImagePlane,
    address: SocketAddr,
    control: bool,
) -> Result<Exit, Failure> {
    let server = Arc::new(Server {
        status: Mutex::new(Status::new(&watcher)),
        plane,
        pictures: Pictures::default(),
        views: Arc::new(Semaphore::new(VIEWS)),
        token: control.then(token).transpose()?,
        spare: Mutex::new(Some(File::open(SPARE)?)),
    });
    // The part behind # stays in the browser: it is not sent, and not logged.
    let token = server.token.as_ref().map(|token| format!("#{token}"));
    let token = token.unwrap_or_default();
    let line = |address| format!("live view at http://{address}/{token}\n");
    let routes = Router::new()
        .route("/", get(Html(PAGE)))
        .route("/events", get(events))
        .route("/image", get(image))
        .route(
            "/arm",
            post(|server, headers| command(server, headers, Action::Arm)),
        )
        .route(
            "/disarm",
            post(|server, headers| command(server, headers, Action::Disarm)),
        )
        .route(
            "/stop",
            post(|server, headers| command(server, headers, Action::Stop)),
        )
        .route("/teach", post(show_goal))
        .with_state(Arc::clone(&server));
    let routes = server::for_plain_hosts(routes);
    let show = |watcher: &Watcher| {
        if let Some(image) = &watcher.image {
            server.pictures.show(image, Instant::now());
        }
    };
    let work = status::keep(&server.status, &mut watcher, EVENT, show);
    server::serve(address, routes, line, work)
}

async fn image(State(server): State<Arc<Server>>, headers: HeaderMap) -> Response {
    server.pictures.answer(&headers, Instant::now())
}

async fn events(
    State(server): State<Arc<Server>>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Response> {
    let Ok(view) = Arc::clone(&server.views).try_acquire_owned() else {
        let reason = format!("{VIEWS} views are open; allowed: {VIEWS}");
        return Err(refusal(StatusCode::SERVICE_UNAVAILABLE, &reason));
    };
    let feed = Feed::new(server.plane.clone());
    let ticks = tokio::time::interval(EVENT);
    let next = async |(server, mut feed, mut ticks): (Arc<Server>, Feed, Interval)| {
        ticks.tick().await;
        let mut event = feed.event(&server.status.lock().unwrap_or_else(PoisonError::into_inner));
        event["control"] = server.token.is_some().into();
        let event = Event::default().data(event.to_string());
        Some((Ok(event), (server, feed, ticks)))
    };
    let events = stream::unfold((server, feed, ticks), next);
    // The place is given back with the stream.
    Ok(Sse::new(events.inspect(move |_| _ = &view)))
}

/// The domain, for whoever may command: our own page, with the token that was printed. Else why
/// not.
fn commanded(server: &Server, headers: &HeaderMap) -> Result<PathBuf, &'static str> {
    let Some(token) = &server.token else {
        return Err("only watching: start with --control to command");
    };
    if !is_same_origin(headers) {
        return Err("not from this page");
    }
    if !field(headers, "x-vpc-token").is_some_and(|found| equal(found, token)) {
        return Err("wrong token: open the address that vpcctl printed");
    }
    let status = server.status.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(status.directory.clone())
}

async fn command(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    action: Action,
) -> Response {
    let directory = match commanded(&server, &headers) {
        Ok(directory) => directory,
        Err(why) => return refusal(StatusCode::FORBIDDEN, why),
    };
    if action == Action::Stop {
        // Nothing else runs in this thread until the stop file is open.
        let spare = || server.spare.lock().unwrap_or_else(PoisonError::into_inner);
        drop(spare().take());
        let answer = stop_by_file(&directory).await;
        *spare() = File::open(SPARE).ok();
        return answer;
    }
    let request = match action {
        Action::Arm => {
            let veto = field(&headers, "x-vpc-veto").and_then(|text| text.parse().ok());
            request::arm(veto.unwrap_or(0))
        }
        _ => request::plain(action),
    };
    let asked = move || request::ask(&directory, &request, PATIENCE);
    match tokio::task::spawn_blocking(asked).await {
        Ok(Ok((line, Exit::Ok))) => line.into_response(),
        Ok(Ok((line, _))) => (StatusCode::CONFLICT, line).into_response(),
        Ok(Err(failure)) => refusal(StatusCode::SERVICE_UNAVAILABLE, &failure.to_string()),
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}

/// What the camera sees now becomes the daemon's goal. If it has a memory, that takes minutes.
async fn show_goal(State(server): State<Arc<Server>>, headers: HeaderMap) -> Response {
    let directory = match commanded(&server, &headers) {
        Ok(directory) => directory,
        Err(why) => return refusal(StatusCode::FORBIDDEN, why),
    };
    let never = AtomicBool::new(false);
    let taught = move || teach::replace(&directory, LOOK, &[], &never, &mut Monotonic);
    match tokio::task::spawn_blocking(taught).await {
        Ok(Ok(lines)) => lines.into_response(),
        Ok(Err(failure)) => refusal(StatusCode::CONFLICT, &failure.to_string()),
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}

/// Stops by the stop file, without a thread, which a machine in trouble may not give.
async fn stop_by_file(directory: &Path) -> Response {
    let begin = Instant::now();
    let asked = match ipc::Asked::in_domain(directory) {
        Ok(asked) => asked,
        Err(_) => return stop_by_request(directory.to_owned()).await,
    };
    loop {
        match asked.is_obeyed() {
            Ok(true) => return stop::stopped(begin.elapsed()).into_response(),
            Ok(false) if begin.elapsed() < PATIENCE => tokio::time::sleep(POLL).await,
            Ok(false) | Err(_) => return stop_by_request(directory.to_owned()).await,
        }
    }
}

/// Where the file does not get through.
async fn stop_by_request(directory: PathBuf) -> Response {
    let stopped = tokio::task::spawn_blocking(move || stop::stop(&directory, Duration::ZERO));
    match stopped.await {
        Ok(Ok((line, _))) => line.into_response(),
        Ok(Err(failure)) => refusal(StatusCode::SERVICE_UNAVAILABLE, &failure.to_string()),
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}

/// 128 random bits in hexadecimal.
fn token() -> io::Result<String> {
    let mut bytes = [0; 16];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(format!("{:032x}", u128::from_ne_bytes(bytes)))
}

/// Whether two words are equal, in a time that does not tell where they differ.
fn equal(a: &str, b: &str) -> bool {
    let pairs = a.bytes().zip(b.bytes());
    let differing = pairs.fold(0, |all, (a, b)| all | (a ^ b));
    a.len() == b.len() && differing == 0
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
