//! What many clients do to the server of the page, in real time.

use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use messages::{Encoding, ImageHeader};

use crate::server::Server;
use crate::stand_in::{Camera, StandIn};

#[test]
fn views_that_are_never_read_are_dropped() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let host = format!("Host: {}\r\n", server.address);
    let clients: Vec<_> = (0..5).map(|_| server.connect()).collect();
    for mut client in &clients {
        rustix::net::sockopt::set_socket_recv_buffer_size(client, 4096).unwrap();
        write!(client, "GET /events HTTP/1.1\r\n{host}\r\n").unwrap();
        client.read_exact(&mut [0; 15]).unwrap();
    }
    let events = server.ask("GET /events", &host, 2048);
    assert!(events.starts_with("HTTP/1.1 503"), "{events}");
    testkit::eventually("idle clients are dropped", || {
        let events = server.ask("GET /events", &host, 2048);
        events.starts_with("HTTP/1.1 200").then_some(())
    });
    drop(clients);
}

#[test]
fn a_stop_gets_through_whatever_others_do() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let words = ["serve", "--listen", "127.0.0.1:0", "--control"];
    let server = Server::start(directory.path(), &words);
    let token = server.line.trim().rsplit('#').next().unwrap().to_owned();
    let host = server.address.clone();
    // As many watchers as there are places, read without end.
    let watchers: Vec<_> = (0..64).map(|_| server.connect()).collect();
    for mut watcher in &watchers {
        // Those beyond the places are refused, and may be dropped before they have asked.
        let _ = write!(watcher, "GET /events HTTP/1.1\r\nHost: {host}\r\n\r\n");
    }
    let header = ImageHeader::new(1024, 1024, Encoding::Rgb8, 0);
    let _camera = Camera::start(directory.path(), header, |_, _| [100; 3]);
    let end = AtomicBool::new(false);
    std::thread::scope(|threads| {
        // Some that take picture after picture, and some that ask for one and never read it.
        for _ in 0..4 {
            threads.spawn(|| {
                let mut idle = Vec::new();
                while !end.load(Ordering::Relaxed) {
                    server.try_get("/image");
                    let mut client = server.connect();
                    let _ = write!(client, "GET /image HTTP/1.1\r\nHost: {host}\r\n\r\n");
                    idle.push(client);
                }
            });
        }
        // Clients that drip, more than may wait, and begin anew when they are dropped.
        for _ in 0..4 {
            threads.spawn(|| {
                let mut clients: Vec<_> = (0..48).map(|_| server.connect()).collect();
                while !end.load(Ordering::Relaxed) {
                    for client in &mut clients {
                        if client.write_all(b"G").is_err() {
                            *client = server.connect();
                        }
                    }
                    std::thread::sleep(Duration::from_millis(20));
                }
            });
        }
        std::thread::sleep(Duration::from_millis(300));
        let fields = format!("Host: {host}\r\nOrigin: http://{host}\r\nX-Vpc-Token: {token}\r\n");
        let answers: Vec<_> = (0..20)
            .map(|_| server.ask("POST /stop", &fields, 1 << 16))
            .collect();
        end.store(true, Ordering::Relaxed);
        for answer in answers {
            assert!(answer.contains("stop: done after"), "{answer}");
        }
    });
}

#[test]
fn a_stop_gets_through_where_idle_clients_hold_all_descriptors() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let words = ["serve", "--listen", "127.0.0.1:0", "--control"];
    // It may open this many files.
    let mut shell = testkit::command("sh");
    shell.args(["-c", "ulimit -n 128; exec \"$0\" \"$@\""]);
    shell.arg(env!("CARGO_BIN_EXE_vpcctl"));
    let server = Server::begin(shell, directory.path(), &words);
    let token = server.line.trim().rsplit('#').next().unwrap().to_owned();
    let host = server.address.clone();
    let idle: Vec<_> = (0..300).map(|_| server.connect()).collect();
    let fields = format!("Host: {host}\r\nOrigin: http://{host}\r\nX-Vpc-Token: {token}\r\n");
    let begin = std::time::Instant::now();
    for _ in 0..3 {
        let answer = server.ask("POST /stop", &fields, 1 << 16);
        assert!(answer.contains("stop: done after"), "{answer}");
    }
    // Idle clients are dropped after 5 s in any case.
    assert!(
        begin.elapsed() < Duration::from_secs(2),
        "{:?}",
        begin.elapsed()
    );
    drop(idle);
}
