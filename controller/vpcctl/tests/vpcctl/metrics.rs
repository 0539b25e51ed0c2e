//! `metrics`, judged by the client library that Prometheus publishes for Python.

use std::borrow::BorrowMut;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use testkit::python::Environment;
use testkit::{Place, Running, eventually, program, root};

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
        Self::begin(
            testkit::command(env!("CARGO_BIN_EXE_vpcctl")),
            domain,
            words,
        )
    }

    /// One that may open this many files.
    pub fn with_descriptors(most: u32, domain: &Path, words: &[&str]) -> Self {
        let mut shell = testkit::command("sh");
        shell
            .arg("-c")
            .arg(format!("ulimit -n {most}; exec \"$0\" \"$@\""));
        Self::begin(shell.arg(env!("CARGO_BIN_EXE_vpcctl")), domain, words)
    }

    fn begin(mut command: impl BorrowMut<Command>, domain: &Path, words: &[&str]) -> Self {
        let mut child = command
            .borrow_mut()
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

    pub fn connect(&self) -> TcpStream {
        TcpStream::connect(&self.address).unwrap()
    }

    /// Sends a request with these head fields; the answer, at most this many bytes of it. What a
    /// server that hangs up leaves unsent or unread is no failure.
    pub fn ask(&self, first: &str, fields: &str, most: u64) -> String {
        String::from_utf8_lossy(&self.ask_bytes(first, fields, most)).into_owned()
    }

    /// The same, of an answer that is no text.
    pub fn ask_bytes(&self, first: &str, fields: &str, most: u64) -> Vec<u8> {
        let mut stream = self.connect();
        let mut answer = Vec::new();
        let _ = write!(stream, "{first} HTTP/1.1\r\n{fields}\r\n");
        let _ = stream.take(most).read_to_end(&mut answer);
        answer
    }

    /// Sends a request to the right host.
    pub fn get(&self, path: &str) -> String {
        let answer = self.try_get(path);
        assert!(!answer.is_empty(), "GET {path}: no answer");
        answer
    }

    /// The same, of a server that may have no place.
    pub fn try_get(&self, path: &str) -> String {
        let host = format!("Host: {}\r\n", self.address);
        self.ask(&format!("GET {path}"), &host, 1 << 20)
    }

    /// The head of the stream of events, and this many of them.
    pub fn events(&self, count: usize) -> String {
        let mut stream = self.connect();
        write!(
            stream,
            "GET /events HTTP/1.1\r\nHost: {}\r\n\r\n",
            self.address
        )
        .unwrap();
        let (mut text, mut events) = (String::new(), 0);
        for line in BufReader::new(stream).split(b'\n') {
            let line = String::from_utf8_lossy(&line.unwrap()).into_owned();
            events += usize::from(line.starts_with("data: "));
            text += &line;
            text.push('\n');
            if events == count {
                return text;
            }
        }
        panic!("{events} of {count} events:\n{text}");
    }

    /// Ends it by SIGTERM; its exit code.
    pub fn terminate(&mut self) -> Option<i32> {
        let process = self.child.id().to_string();
        let kill = testkit::command("kill").arg(process).status().unwrap();
        assert!(kill.success());
        eventually("the server ends", || self.child.try_wait().unwrap()).code()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the text from standard input with the parser of PyPI's prometheus-client; prints what it
/// found.
const PARSER: &str = r#"
import sys
from prometheus_client.parser import text_string_to_metric_families as parse
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
    let environment = Environment {
        name: "python-prometheus",
        requirements: &[],
        packages: &["prometheus-client"],
    };
    let Some(python) = environment.python("the parser of Prometheus") else {
        return;
    };
    let mut parser = testkit::command(python)
        .args(["-c", PARSER])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = parser.stdin.take().unwrap();
    input.write_all(&output.stdout).unwrap();
    drop(input);
    let parsed = parser.wait_with_output().unwrap();
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

/// What the alerts tell a stop from a failure by, of the daemon itself.
#[test]
fn the_cause_of_the_last_cycle_is_told_after_the_daemons_end() {
    let place = Place::new();
    let start = |name, words: &[&str]| {
        let mut command = testkit::command(program(name));
        command.arg("--domain").arg(place.domain()).args(words);
        command.current_dir(root());
        Running::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()))
    };
    let mut daemon = start("vpcd", &["--config", "controller/vpcd-robot.toml", "--arm"]);
    daemon.line("scene controller");
    let _robot = start("hw-sim", &["--config", "hw-sim/hw-sim-robot.toml"]);
    let server = Server::start(&place.domain(), &["metrics", "--listen", "127.0.0.1:0"]);
    let is_told = |lines: &[&str]| {
        let text = server.get("/metrics");
        let is_there = |line: &&str| text.lines().any(|found| found == *line);
        lines.iter().all(is_there).then_some(())
    };
    eventually("motion", || {
        is_told(&[
            "vpc_state{state=\"moving\"} 1",
            "vpc_last_cause_info{cause=\"none\"} 1",
        ])
    });
    assert_eq!(daemon.terminated().code, Some(0));
    eventually("the end", || {
        is_told(&["vpc_up 0", "vpc_last_cause_info{cause=\"shutdown\"} 1"])
    });
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
