//! Just enough HTTP/1.1 for a page, a stream of events and a few buttons: no bodies in, one request a connection,
//! everything bounded.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use crate::exit::Failure;

/// Longest head of a request, bytes.
const HEAD: u64 = 16 * 1024;
/// Patience with a peer that sends or receives slowly.
const PATIENCE: Duration = Duration::from_secs(5);
/// Most connections at one time.
const CONNECTIONS: usize = 32;

/// A request.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// GET, HEAD, POST, ...
    pub method: String,
    /// Path without the query.
    pub path: String,
    /// Head fields, names in lower case.
    fields: Vec<(String, String)>,
}

impl Request {
    /// The value of a head field, by its name in lower case; `None` where it is missing or comes twice.
    pub fn field(&self, name: &str) -> Option<&str> {
        let mut found = self.fields.iter().filter(|(key, _)| key == name);
        match (found.next(), found.next()) {
            (Some((_, value)), None) => Some(value),
            _ => None,
        }
    }

    /// Whether the host that was asked for is an address or `localhost`. A name that somebody's DNS lets point to
    /// this machine would make the browser take his page for one of ours.
    pub fn host_is_plain(&self) -> bool {
        let Some(host) = self.field("host") else {
            return false;
        };
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split(']').next(),
            None => host.split(':').next(),
        };
        name.is_some_and(|name| name == "localhost" || name.parse::<IpAddr>().is_ok())
    }

    /// Whether the request comes from a page that we served: its origin is the host asked for.
    pub fn is_same_origin(&self) -> bool {
        match (self.field("origin"), self.field("host")) {
            (Some(origin), Some(host)) => origin.strip_prefix("http://") == Some(host),
            _ => false,
        }
    }

    /// Reads the head.
    fn read(stream: impl Read) -> io::Result<Self> {
        let wrong = |what| io::Error::new(io::ErrorKind::InvalidData, what);
        let mut lines = BufReader::new(stream.take(HEAD)).lines();
        let first = lines.next().ok_or_else(|| wrong("empty"))??;
        let mut words = first.split(' ');
        let (Some(method), Some(target), Some("HTTP/1.1" | "HTTP/1.0"), None) =
            (words.next(), words.next(), words.next(), words.next())
        else {
            return Err(wrong("request line"));
        };
        let mut request = Self {
            method: method.to_owned(),
            path: target.split('?').next().unwrap_or_default().to_owned(),
            fields: Vec::new(),
        };
        for line in lines {
            let line = line?;
            if line.is_empty() {
                return Ok(request);
            }
            let (name, value) = line.split_once(':').ok_or_else(|| wrong("head field"))?;
            let field = (name.to_ascii_lowercase(), value.trim().to_owned());
            request.fields.push(field);
        }
        Err(wrong("head too long, or cut off"))
    }
}

/// Gives the next piece of a stream; `None` ends it.
pub type Pieces = Box<dyn FnMut() -> Option<Arc<str>> + Send>;

/// What is answered.
pub enum Response {
    /// All at once.
    Whole {
        /// Status code.
        status: u16,
        /// Media type.
        media: &'static str,
        /// Content.
        content: String,
    },
    /// Server-sent events, piece by piece.
    Events(Pieces),
}

impl Response {
    /// A whole answer.
    pub fn whole(status: u16, media: &'static str, content: String) -> Self {
        Self::Whole {
            status,
            media,
            content,
        }
    }

    /// A refusal with its reason.
    pub fn refusal(status: u16, reason: &str) -> Self {
        Self::whole(status, "text/plain; charset=utf-8", format!("{reason}\n"))
    }

    fn write(self, head_only: bool, stream: &mut impl Write) -> io::Result<()> {
        // Nothing from elsewhere is loaded, nobody frames us, nothing is kept.
        let common = "Connection: close\r\nCache-Control: no-store\r\n\
             X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
             Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; \
             style-src 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'\r\n";
        match self {
            Self::Whole {
                status,
                media,
                content,
            } => {
                let phrase = match status {
                    200 => "OK",
                    403 => "Forbidden",
                    404 => "Not Found",
                    405 => "Method Not Allowed",
                    409 => "Conflict",
                    _ => "Service Unavailable",
                };
                let length = content.len();
                write!(
                    stream,
                    "HTTP/1.1 {status} {phrase}\r\n{common}Content-Type: {media}\r\n\
                     Content-Length: {length}\r\n\r\n"
                )?;
                if !head_only {
                    stream.write_all(content.as_bytes())?;
                }
                stream.flush()
            }
            Self::Events(mut pieces) => {
                write!(
                    stream,
                    "HTTP/1.1 200 OK\r\n{common}Content-Type: text/event-stream\r\n\r\n"
                )?;
                while let Some(piece) = pieces() {
                    stream.write_all(piece.as_bytes())?;
                    stream.flush()?;
                }
                Ok(())
            }
        }
    }
}

/// Refuses addresses that other machines reach, unless that was asked for.
///
/// # Errors
/// [`Failure::Exposed`].
pub fn allow(address: SocketAddr, expose: bool) -> Result<(), Failure> {
    match expose || address.ip().is_loopback() {
        true => Ok(()),
        false => Err(Failure::Exposed {
            address: address.to_string(),
        }),
    }
}

/// A server; its threads end with the process.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
}

impl Server {
    /// Listens at this address; port 0 takes any free one.
    ///
    /// # Errors
    /// [`Failure::Listen`] where the address cannot be used.
    pub fn start(
        address: SocketAddr,
        answer: impl Fn(&Request) -> Response + Send + Sync + 'static,
    ) -> Result<Self, Failure> {
        let trouble = |source| Failure::Listen {
            address: address.to_string(),
            source,
        };
        let listener = TcpListener::bind(address).map_err(trouble)?;
        let address = listener.local_addr().map_err(trouble)?;
        let answer = Arc::new(answer);
        let open = Arc::new(AtomicUsize::new(0));
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let Ok(stream) = stream else {
                    // Out of descriptors, for instance: others must close first.
                    std::thread::sleep(Duration::from_millis(100));
                    continue;
                };
                if open.fetch_add(1, Ordering::Relaxed) >= CONNECTIONS {
                    open.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let (answer, open) = (Arc::clone(&answer), Arc::clone(&open));
                std::thread::spawn(move || {
                    // A peer that left or talks nonsense is its own affair.
                    let _ = converse(stream, answer.as_ref());
                    open.fetch_sub(1, Ordering::Relaxed);
                });
            }
        });
        Ok(Self { address })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

fn converse(mut stream: TcpStream, answer: &dyn Fn(&Request) -> Response) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    stream.set_nodelay(true)?;
    let request = Request::read(&stream)?;
    answer(&request).write(request.method == "HEAD", &mut stream)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(text: &str) -> io::Result<Request> {
        Request::read(text.as_bytes())
    }

    #[test]
    fn method_path_and_fields_are_read() {
        let request = request("GET /metrics?x=1 HTTP/1.1\r\nHost: localhost:1\r\nX-A: b \r\n\r\n");
        let request = request.unwrap();
        assert_eq!(
            (request.method.as_str(), request.path.as_str()),
            ("GET", "/metrics")
        );
        assert_eq!(request.field("x-a"), Some("b"));
        assert_eq!(request.field("origin"), None);
    }

    #[test]
    fn nonsense_and_endless_heads_are_refused() {
        assert!(request("hello\r\n\r\n").is_err());
        assert!(request("GET / HTTP/1.1\r\nHost: x\r\n").is_err());
        let endless = format!("GET / HTTP/1.1\r\nX: {}\r\n\r\n", "a".repeat(20_000));
        assert!(request(&endless).is_err());
    }

    #[test]
    fn a_host_must_be_an_address_or_localhost() {
        let plain = |host: &str| {
            request(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"))
                .unwrap()
                .host_is_plain()
        };
        assert!(plain("127.0.0.1:9470") && plain("localhost") && plain("[::1]:9470"));
        assert!(!plain("evil.example:9470") && !plain("localhost.evil.example"));
        assert!(!request("GET / HTTP/1.1\r\n\r\n").unwrap().host_is_plain());
        let twice = "GET / HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n";
        assert!(!request(twice).unwrap().host_is_plain());
    }

    #[test]
    fn only_our_own_page_has_our_origin() {
        let same = |origin: &str| {
            let head = format!("POST /arm HTTP/1.1\r\nHost: 127.0.0.1:1\r\n{origin}\r\n");
            request(&head).unwrap().is_same_origin()
        };
        assert!(same("Origin: http://127.0.0.1:1\r\n"));
        assert!(!same("Origin: http://127.0.0.1:2\r\n") && !same("Origin: null\r\n") && !same(""));
    }
}
