//! HTTP for the page and the metrics: `axum` on one thread, with bounds on clients, heads and
//! time, and one request a connection.
//!
//! A command finds room beside up to a thousand connections a second: of the clients that have not
//! sent their head yet, the oldest makes room for a new one, once it had its time; and those that
//! are being answered leave out the commands.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::Future;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use axum::http::header::{self, HeaderMap, HeaderName};
use axum::http::uri::Authority;
use axum::http::{Method, StatusCode};
use axum::middleware::{Next, from_fn, map_response};
use axum::response::{IntoResponse, Response};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use program::Exit;
use rustix::process::{Resource, getrlimit};
use tokio::net::{TcpListener, TcpStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio::time::Instant;

use crate::failure::Failure;
use crate::output;

/// Longest head of a request, bytes.
const HEAD: usize = 16 * 1024;
/// How long a client may take to send its head, or to receive what it was sent.
const PATIENCE: Duration = Duration::from_secs(5);
/// Most clients that have not sent their head yet.
const WAITING: usize = 128;
/// How long each of them has for it, however many come after it.
const GRACE: Duration = Duration::from_millis(100);
/// Most that are being answered, commands not counted.
const ANSWERED: usize = 32;

/// Fewest files that may be open: with as many, a thousand idle clients delay a command by a
/// second.
const DESCRIPTORS: u64 = 128;

/// Headers of every response: nothing is loaded from elsewhere, framed or kept.
const HEADERS: [(HeaderName, &str); 4] = [
    (header::CACHE_CONTROL, "no-store"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
         connect-src 'self'; frame-ancestors 'none'",
    ),
];

/// Checks the address to listen at: other machines reach it with `expose` only, and never where
/// `control` lets the page command, since its token would be readable on the way.
///
/// # Errors
/// [`Exit::Usage`] with what is allowed.
pub fn allow(address: SocketAddr, expose: bool, control: bool) -> Result<(), Failure> {
    let message = match (address.ip().is_loopback(), control, expose) {
        (true, _, _) | (_, false, true) => return Ok(()),
        (_, true, _) => "--control: token and commands would be readable on the network; allowed: with 127.0.0.0/8 and [::1] (from afar: ssh -L 9470:127.0.0.1:9470 HOST)".to_owned(),
        (_, false, false) => format!("{address}: other machines reach this address; allowed: 127.0.0.0/8 and [::1] (see them from afar with `ssh -L`), others with --expose"),
    };
    Err(Failure::new(Exit::Usage, message))
}

/// Checks that idle clients cannot keep a stop waiting: each has its time, and those for which
/// there is no descriptor wait for the others.
///
/// # Errors
/// [`Exit::Unavailable`] with what is allowed.
pub fn has_descriptors() -> Result<(), Failure> {
    match getrlimit(Resource::Nofile).current {
        Some(found) if found < DESCRIPTORS => {
            let message = format!(
                "at most {found} open files; allowed: {DESCRIPTORS} and more (ulimit -n), so that a stop never waits for idle clients"
            );
            Err(Failure::new(Exit::Unavailable, message))
        }
        _ => Ok(()),
    }
}

/// Serves these routes at this address, beside `work`, until SIGINT, SIGTERM or SIGHUP. `line` is
/// what to print, given the address.
///
/// # Errors
/// The address cannot be used; `work` failed.
pub fn serve(
    address: SocketAddr,
    routes: Router,
    line: impl FnOnce(SocketAddr) -> String,
    work: impl Future<Output = Result<Infallible, Failure>>,
) -> Result<Exit, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let end = runtime.block_on(async {
        let unusable = |source| {
            let message = format!(
                "--listen {address}: {source}; allowed: a free address of this machine (port 0: any free port)"
            );
            Failure::new(Exit::Unavailable, message)
        };
        let listener = TcpListener::bind(address).await.map_err(unusable)?;
        let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
        let [mut interrupt, mut terminate, mut hangup] = {
            let [a, b, c] = kinds.map(signal);
            [a?, b?, c?]
        };
        output::write(&line(listener.local_addr().map_err(unusable)?))?;
        let routes = routes.layer(map_response(add_headers));
        tokio::select! {
            never = accept(listener, routes) => match never {},
            result = work => result.map(|never| match never {}),
            _ = interrupt.recv() => Ok(Exit::Ok),
            _ = terminate.recv() => Ok(Exit::Ok),
            _ = hangup.recv() => Ok(Exit::Ok),
        }
    });
    // A command that is under way in a thread of its own must not keep the process.
    runtime.shutdown_background();
    end
}

async fn accept(listener: TcpListener, routes: Router) -> Infallible {
    let places = Arc::new(Semaphore::new(ANSWERED));
    let mut waiting: VecDeque<Waiting> = VecDeque::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Out of descriptors, for instance: the oldest makes room, or others must close first.
            waiting.retain(Waiting::still_waits);
            match waiting.pop_front() {
                Some(oldest) => oldest.leave().await,
                None => tokio::time::sleep(GRACE).await,
            }
            // The connection closes with its task.
            tokio::task::yield_now().await;
            continue;
        };
        let client = Arc::new(Client::default());
        let admitted = admitted(routes.clone(), &client, &places);
        let task = tokio::spawn(async move {
            // A client that left or talks nonsense is its own affair.
            let _ = converse(stream, admitted).await;
        });
        waiting.push_back(Waiting {
            until: Instant::now() + GRACE,
            task: task.abort_handle(),
            client,
        });
        // Connections wait here, so that many of them do not push out one that has just come.
        loop {
            waiting.retain(Waiting::still_waits);
            if waiting.len() <= WAITING {
                break;
            }
            if let Some(oldest) = waiting.pop_front() {
                oldest.leave().await;
            }
        }
    }
}

/// A client that has not sent its head yet.
struct Waiting {
    /// It may be dropped from then on.
    until: Instant,
    task: AbortHandle,
    client: Arc<Client>,
}

impl Waiting {
    fn still_waits(&self) -> bool {
        !(self.task.is_finished() || self.client.has_asked())
    }

    /// Drops it once it had its time, unless it asks until then.
    async fn leave(self) {
        tokio::time::sleep_until(self.until).await;
        if self.still_waits() {
            self.task.abort();
        }
    }
}

/// A connection.
#[derive(Debug, Default)]
struct Client {
    has_asked: AtomicBool,
    /// Given back when the connection ends.
    place: OnceLock<OwnedSemaphorePermit>,
}

impl Client {
    fn has_asked(&self) -> bool {
        self.has_asked.load(Ordering::Relaxed)
    }
}

/// The routes for this client, which needs a place unless it commands.
fn admitted(routes: Router, client: &Arc<Client>, places: &Arc<Semaphore>) -> Router {
    let (client, places) = (Arc::clone(client), Arc::clone(places));
    routes.layer(from_fn(move |request: Request, next: Next| {
        client.has_asked.store(true, Ordering::Relaxed);
        let is_admitted = request.method() == Method::POST
            || match Arc::clone(&places).try_acquire_owned() {
                Ok(place) => client.place.set(place).is_ok(),
                Err(_) => false,
            };
        async move {
            match is_admitted {
                true => next.run(request).await,
                false => refusal(StatusCode::SERVICE_UNAVAILABLE, "too many clients"),
            }
        }
    }))
}

async fn converse(stream: TcpStream, routes: Router) -> Result<(), Box<dyn std::error::Error>> {
    stream.set_nodelay(true)?;
    // The kernel closes the connection of a client that takes nothing for so long.
    let patience = u32::try_from(PATIENCE.as_millis())?;
    rustix::net::sockopt::set_tcp_user_timeout(&stream, patience)?;
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(PATIENCE)
        .max_buf_size(HEAD)
        .keep_alive(false)
        .title_case_headers(true)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes));
    Ok(connection.await?)
}

async fn add_headers(mut response: Response) -> Response {
    for (name, value) in HEADERS {
        let value = header::HeaderValue::from_static(value);
        response.headers_mut().insert(name, value);
    }
    response
}

/// Refuses requests to a host other than an address or `localhost`. An attacker's DNS name may
/// point at this machine, and the browser would take the attacker's page for one of ours.
pub fn for_plain_hosts(routes: Router) -> Router {
    routes.layer(from_fn(
        async |request: Request, next: Next| match is_plain(request.headers()) {
            true => next.run(request).await,
            false => refusal(
                StatusCode::FORBIDDEN,
                "host not allowed: ask by address or as localhost",
            ),
        },
    ))
}

fn is_plain(headers: &HeaderMap) -> bool {
    let Some(host) = field(headers, header::HOST).and_then(|host| host.parse::<Authority>().ok())
    else {
        return false;
    };
    let name = host.host().trim_matches(['[', ']']);
    // A user's name before the host is none of ours.
    !host.as_str().contains('@') && (name == "localhost" || name.parse::<IpAddr>().is_ok())
}

/// Whether the request comes from a page that we served: its origin is the host asked for.
pub fn is_same_origin(headers: &HeaderMap) -> bool {
    let origin = field(headers, header::ORIGIN).and_then(|origin| origin.strip_prefix("http://"));
    origin.is_some() && origin == field(headers, header::HOST)
}

/// The value of a header; `None` if it is missing, comes twice, or is not text.
pub fn field(headers: &HeaderMap, name: impl header::AsHeaderName) -> Option<&str> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (Some(value), None) => value.to_str().ok(),
        _ => None,
    }
}

/// A refusal with its reason.
pub fn refusal(status: StatusCode, reason: &str) -> Response {
    (status, format!("{reason}\n")).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(fields: &[(HeaderName, &str)]) -> HeaderMap {
        let fields = fields.iter().cloned();
        let mut headers = HeaderMap::new();
        for (name, value) in fields {
            headers.append(name, value.parse().unwrap());
        }
        headers
    }

    #[test]
    fn a_host_must_be_an_address_or_localhost() {
        let plain = |host: &str| is_plain(&headers(&[(header::HOST, host)]));
        assert!(plain("127.0.0.1:9470") && plain("localhost") && plain("[::1]:9470"));
        assert!(!plain("evil.example:9470") && !plain("localhost.evil.example"));
        assert!(!plain("evil@127.0.0.1") && !plain("evil:word@localhost:9470"));
        assert!(!is_plain(&HeaderMap::new()));
        let twice = [(header::HOST, "localhost"), (header::HOST, "localhost")];
        assert!(!is_plain(&headers(&twice)));
    }

    #[test]
    fn only_our_own_page_has_our_origin() {
        let host = (header::HOST, "127.0.0.1:1");
        let same =
            |origin: &str| is_same_origin(&headers(&[host.clone(), (header::ORIGIN, origin)]));
        assert!(same("http://127.0.0.1:1"));
        assert!(!same("http://127.0.0.1:2") && !same("null"));
        assert!(!is_same_origin(&headers(&[host])));
    }

    #[test]
    fn a_command_is_admitted_where_all_places_are_taken() {
        use axum::body::Body;
        use axum::routing::get;
        use hyper::service::Service;

        let runtime = tokio::runtime::Builder::new_current_thread().build();
        let runtime = runtime.unwrap();
        let places = Arc::new(Semaphore::new(1));
        let routes = Router::new().route("/", get(async || "page").post(async || "done"));
        // The place is held until the client goes.
        let ask = |method: Method| {
            let client = Arc::default();
            let request = Request::builder().method(method).uri("/");
            let service = TowerToHyperService::new(admitted(routes.clone(), &client, &places));
            let answer = service.call(request.body(Body::empty()).unwrap());
            (client, runtime.block_on(answer).unwrap().status())
        };
        let (first, status) = ask(Method::GET);
        assert_eq!(status, StatusCode::OK);
        assert_eq!(ask(Method::GET).1, StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(ask(Method::POST).1, StatusCode::OK);
        drop(first);
        assert_eq!(ask(Method::GET).1, StatusCode::OK);
    }
}
