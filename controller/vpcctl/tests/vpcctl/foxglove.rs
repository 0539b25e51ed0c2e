//! `serve --foxglove`: who may connect. Foxglove's own client is in the target `judges`; that a client
//! that does not read holds one image, `recorder` tests.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Stdio;

use testkit::{PATIENCE, Place, Running};

use crate::{stderr, vpcctl};

#[test]
fn foxglove_is_served_to_other_machines_only_if_that_is_said() {
    let place = Place::new();
    let refused = vpcctl(&place.domain(), &["serve", "--foxglove", "0.0.0.0:0"]);
    assert_eq!(refused.status.code(), Some(64));
    assert!(stderr(&refused).contains("0.0.0.0:0: other machines reach this address"));
    for words in [["--listen", "127.0.0.1:1"].as_slice(), &["--control"]] {
        let line = [&["serve", "--foxglove"], words].concat();
        assert_eq!(
            vpcctl(&place.domain(), &line).status.code(),
            Some(64),
            "{words:?}"
        );
    }
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let refused = vpcctl(&place.domain(), &["serve", "--foxglove", &address]);
    assert_eq!(refused.status.code(), Some(69));
    assert!(stderr(&refused).contains(&address), "{}", stderr(&refused));
}

/// A WebSocket by hand: the answer to its head from a page of this origin, and the connection.
fn socket(url: &str, origin: Option<&str>) -> (String, TcpStream) {
    let host = url.strip_prefix("ws://").unwrap();
    let mut stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let origin = origin.map_or_else(String::new, |origin| format!("Origin: {origin}\r\n"));
    let head = format!(
        "GET / HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n{origin}\r\n"
    );
    stream.write_all(head.as_bytes()).unwrap();
    let mut answer = Vec::new();
    while !answer.ends_with(b"\r\n\r\n") {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        answer.push(byte[0]);
    }
    let answer = String::from_utf8(answer).unwrap();
    (answer.lines().next().unwrap().to_owned(), stream)
}

/// `serve --foxglove` with these words, and its address.
fn serving(place: &Place, words: &[&str]) -> (Running, String) {
    let mut server = testkit::command(env!("CARGO_BIN_EXE_vpcctl"));
    server.arg("--domain").arg(place.domain());
    server
        .args(["serve", "--foxglove", "127.0.0.1:0"])
        .args(words);
    server.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut server = Running::start(server);
    let line = server.line("Foxglove: open a connection to ws://127.0.0.1:");
    let url = line.rsplit(' ').next().unwrap().to_owned();
    (server, url)
}

#[test]
fn foreign_pages_may_not_connect_to_foxglove() {
    let place = Place::new();
    let (server, url) = serving(&place, &["--origin", "https://app.foxglove.dev"]);
    let answer = |origin| socket(&url, origin).0;
    for origin in [
        None,
        Some("http://localhost:8080"),
        Some("https://app.foxglove.dev"),
    ] {
        assert!(answer(origin).contains(" 101 "), "{origin:?}");
    }
    for origin in [
        "null",
        "http://evil.example",
        "http://localhost.evil.example",
    ] {
        assert!(answer(Some(origin)).contains(" 403 "), "{origin}");
        let told = format!("--origin {origin}\n");
        testkit::eventually(origin, || server.stderr().contains(&told).then_some(()));
    }
}
