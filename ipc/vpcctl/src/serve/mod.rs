//! `vpcctl serve`: a live view in the browser.

mod feed;

use std::convert::Infallible;
use std::fs::File;
use std::io::{self, Read};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, Sse};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::stream::{self, Stream};
use ipc::Action;
use tokio::time::Interval;

use crate::exit::{Exit, Failure};
use crate::image_plane::ImagePlane;
use crate::request;
use crate::server::{self, field, is_same_origin, refusal};
use crate::status::{self, Status};
use crate::watcher::Watcher;
use feed::Feed;

/// The page: plain JavaScript, nothing from elsewhere.
const PAGE: &str = include_str!("page.html");
/// Time between two events.
const EVENT: Duration = Duration::from_millis(50);
/// How long to wait for the daemon's answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// What the handlers share.
#[derive(Debug)]
struct Server {
    status: Mutex<Status>,
    plane: ImagePlane,
    /// `None` if the page may not command.
    token: Option<String>,
}

/// Serves the page until a signal comes; with `control`, the page may arm, disarm and stop.
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
        token: control.then(token).transpose()?,
    });
    // The part behind # stays in the browser: it is not sent, and not logged.
    let token = server.token.as_ref().map(|token| format!("#{token}"));
    let token = token.unwrap_or_default();
    let line = |address| format!("live view at http://{address}/{token}\n");
    let routes = Router::new()
        .route("/", get(Html(PAGE)))
        .route("/events", get(events))
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
        .with_state(Arc::clone(&server));
    let routes = server::for_plain_hosts(routes);
    server::serve(
        address,
        routes,
        line,
        status::keep(&server.status, &mut watcher, EVENT),
    )
}

async fn events(
    State(server): State<Arc<Server>>,
) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let feed = Feed::new(server.plane.clone());
    let ticks = tokio::time::interval(EVENT);
    let next = async |(server, mut feed, mut ticks): (Arc<Server>, Feed, Interval)| {
        ticks.tick().await;
        let mut event = feed.event(&server.status.lock().unwrap_or_else(PoisonError::into_inner));
        event["control"] = server.token.is_some().into();
        let event = Event::default().data(event.to_string());
        Some((Ok(event), (server, feed, ticks)))
    };
    Sse::new(stream::unfold((server, feed, ticks), next))
}

/// Commands come from our own page, with the token that was printed.
async fn command(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    action: Action,
) -> Response {
    let forbidden = |reason| refusal(StatusCode::FORBIDDEN, reason);
    let Some(token) = &server.token else {
        return forbidden("only watching: start with --control to command");
    };
    if !is_same_origin(&headers) {
        return forbidden("not from this page");
    }
    if !field(&headers, "x-vpc-token").is_some_and(|found| equal(found, token)) {
        return forbidden("wrong token: open the address that vpcctl printed");
    }
    let directory = {
        let status = server.status.lock().unwrap_or_else(PoisonError::into_inner);
        status.directory.clone()
    };
    let asked = move || request::send(&directory, &request::plain(action), PATIENCE);
    match tokio::task::spawn_blocking(asked).await {
        Ok(Ok(reply)) => {
            let (line, exit) = request::outcome(&reply);
            match exit {
                Exit::Ok => line.into_response(),
                _ => (StatusCode::CONFLICT, line).into_response(),
            }
        }
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
