//! `vpcctl` as a server, and what its clients do.

use std::borrow::BorrowMut;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};

use testkit::{PATIENCE, Running};

/// A server of ours; killed when dropped.
pub struct Server {
    pub process: Running,
    /// host:port.
    pub address: String,
    /// The first line that it printed.
    pub line: String,
}

impl Server {
    pub fn start(domain: &Path, words: &[&str]) -> Self {
        let program = testkit::command(env!("CARGO_BIN_EXE_vpcctl"));
        Self::begin(program, domain, words)
    }

    /// The same, of a command that becomes `vpcctl`.
    pub fn begin(mut command: impl BorrowMut<Command>, domain: &Path, words: &[&str]) -> Self {
        let command = command.borrow_mut();
        command.arg("--domain").arg(domain).args(words);
        let mut process = Running::start(command.stdout(Stdio::piped()));
        let line = process.line("http://");
        let address = line.split("http://").nth(1).unwrap();
        let address = address.split('/').next().unwrap().to_owned();
        Self {
            process,
            address,
            line,
        }
    }

    /// A connection on which nothing is waited for without end.
    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
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

    /// The head of the stream of events, and those up to the first with these words.
    pub fn events(&self, words: &str) -> String {
        let mut stream = self.connect();
        let head = format!("GET /events HTTP/1.1\r\nHost: {}\r\n\r\n", self.address);
        stream.write_all(head.as_bytes()).unwrap();
        let mut text = String::new();
        for line in BufReader::new(stream).split(b'\n') {
            let line = String::from_utf8_lossy(&line.unwrap()).into_owned();
            text += &line;
            text.push('\n');
            if line.starts_with("data: ") && line.contains(words) {
                return text;
            }
        }
        panic!("no event with {words}:\n{text}");
    }
}
