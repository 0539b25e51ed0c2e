//! `metrics`: whom it serves, and what. The text is judged in `controller/vpcctl/src/metrics.rs`, and
//! by Prometheus and its client in the target `judges`.

use std::net::TcpStream;

use crate::server::Server;
use crate::stand_in::StandIn;
use crate::{stderr, vpcctl};

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
