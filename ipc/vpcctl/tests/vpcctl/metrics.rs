//! `metrics`, judged by the client library that Prometheus publishes for Python, where it is installed.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::stand_in::StandIn;
use crate::{stderr, stdout, vpcctl};

/// A server of ours; killed when dropped.
pub struct Server {
    child: Child,
    /// host:port.
    pub address: String,
    /// The first line that it printed.
    pub line: String,
}

impl Server {
    pub fn start(domain: &Path, words: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_vpcctl"))
            .arg("--domain")
            .arg(domain)
            .args(words)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let address = line
            .split("http://")
            .nth(1)
            .unwrap()
            .split('/')
            .next()
            .unwrap()
            .to_owned();
        Self {
            child,
            address,
            line,
        }
    }

    /// Sends a request with these head fields; gives the whole answer, or of a stream what comes in this many bytes.
    pub fn ask(&self, first: &str, fields: &str, most: u64) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        write!(stream, "{first} HTTP/1.1\r\n{fields}\r\n").unwrap();
        let mut answer = Vec::new();
        stream.take(most).read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// Sends a request to the right host.
    pub fn get(&self, path: &str) -> String {
        self.ask(
            &format!("GET {path}"),
            &format!("Host: {}\r\n", self.address),
            1 << 20,
        )
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the text from standard input with the parser of PyPI's prometheus-client; prints what it found.
const PARSER: &str = r#"
import sys
try:
    from prometheus_client.parser import text_string_to_metric_families as parse
except ImportError:
    sys.exit(77)
names = {}
for family in parse(sys.stdin.read()):
    assert family.documentation and family.type != "unknown", family
    for sample in family.samples:
        names.setdefault(sample.name, 0)
        names[sample.name] += sample.value
for name in ("vpc_up", "vpc_cycles_total", "vpc_overruns_total", "vpc_cycle_duration_seconds_count"):
    print(name, float(names[name]))
"#;

#[test]
fn the_python_client_of_prometheus_reads_what_is_printed() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let output = vpcctl(directory.path(), &["metrics", "--once", "--watch", "0.5"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let python = std::env::var("VPC_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let parser = Command::new(python)
        .args(["-c", PARSER])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let Ok(mut parser) = parser else {
        println!("NOT RUN: no python3");
        return;
    };
    parser
        .stdin
        .take()
        .unwrap()
        .write_all(&output.stdout)
        .unwrap();
    let parsed = parser.wait_with_output().unwrap();
    if parsed.status.code() == Some(77) {
        println!("NOT RUN: pip install prometheus-client");
        return;
    }
    assert!(
        parsed.status.success(),
        "{}\n{}",
        stderr(&parsed),
        stdout(&output)
    );
    let text = stdout(&parsed);
    assert!(
        text.contains("vpc_up 1.0\n") && text.contains("vpc_overruns_total 2.0\n"),
        "{text}"
    );
}

#[test]
fn metrics_are_served_on_loopback_to_who_asks_for_this_machine() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["metrics", "--listen", "127.0.0.1:0"]);
    let answer = server.get("/metrics");
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
    let media = "Content-Type: text/plain; version=0.0.4";
    assert!(answer.contains(media), "{answer}");
    let family = "# TYPE vpc_cycle_duration_seconds histogram\n";
    assert!(answer.contains(family), "{answer}");
    assert!(server.get("/secrets").starts_with("HTTP/1.1 404 "));
    // A name that somebody's DNS lets point here.
    let rebound = server.ask("GET /metrics", "Host: evil.example\r\n", 1 << 16);
    assert!(rebound.starts_with("HTTP/1.1 403 "), "{rebound}");
}

#[test]
fn an_address_that_others_reach_is_refused_unless_asked_for() {
    let directory = tempfile::tempdir().unwrap();
    let output = vpcctl(directory.path(), &["metrics", "--listen", "0.0.0.0:0"]);
    assert_eq!(output.status.code(), Some(64));
    assert!(stderr(&output).contains("--expose"), "{}", stderr(&output));
    let words = ["metrics", "--listen", "0.0.0.0:0", "--expose"];
    let server = Server::start(directory.path(), &words);
    let port = server.address.rsplit(':').next().unwrap();
    let stream = TcpStream::connect(format!("127.0.0.1:{port}"));
    assert!(stream.is_ok());
}
