//! `serve`: who may see, and who may command. The page in a browser is in the target `judges`.

use std::io::{Read, Write};

use messages::{Encoding, ImageHeader};

use crate::server::Server;
use crate::stand_in::{Camera, StandIn};
use crate::{stderr, stdout, vpcctl};

#[test]
fn the_page_and_its_events_are_served() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let page = server.get("/");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("<canvas id=\"image\">"));
    assert!(page.contains("default-src 'none'"), "{page}");
    let events = server.events("\"state\":\"disarmed\"");
    assert!(
        events.contains("Content-Type: text/event-stream\r\n"),
        "{events}"
    );
    assert!(events.contains("\r\ndata: {"), "{events}");
    assert!(events.contains("\"control\":false"), "{events}");
    // The scene is not told again with each event.
    assert_eq!(events.matches("\"scene\":{").count(), 1, "{events}");
}

#[test]
fn only_the_page_with_the_token_commands_and_only_with_control() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let post = |server: &Server, host: &str, origin: &str, token: &str| {
        let fields = format!("Host: {host}\r\nOrigin: {origin}\r\nX-Vpc-Token: {token}\r\n");
        server.ask("POST /arm", &fields, 1 << 16)
    };
    let watching = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    assert!(!watching.line.contains('#'), "{}", watching.line);
    let refused = post(
        &watching,
        &watching.address,
        &format!("http://{}", watching.address),
        "",
    );
    assert!(
        refused.starts_with("HTTP/1.1 403") && refused.contains("--control"),
        "{refused}"
    );

    let words = ["serve", "--listen", "127.0.0.1:0", "--control"];
    let server = Server::start(directory.path(), &words);
    let token = server.line.trim().rsplit('#').next().unwrap().to_owned();
    assert_eq!(token.len(), 32, "{}", server.line);
    let (host, origin) = (server.address.clone(), format!("http://{}", server.address));
    let answers = [
        // A page of somebody else in the same browser; a name that was made to point here; a local
        // user without token.
        (
            post(&server, &host, "http://evil.example", &token),
            "not from this page",
        ),
        (
            post(&server, "evil.example", "http://evil.example", &token),
            "host not allowed",
        ),
        (
            post(&server, &host, &origin, &"0".repeat(32)),
            "wrong token",
        ),
        (post(&server, &host, &origin, ""), "wrong token"),
    ];
    for (answer, why) in answers {
        assert!(
            answer.starts_with("HTTP/1.1 403") && answer.contains(why),
            "{why}:\n{answer}"
        );
    }
    let get = server.get("/arm");
    assert!(get.starts_with("HTTP/1.1 405"), "{get}");
    // None of them armed it. Each answer tells the state; this request changes nothing.
    let asked = vpcctl(directory.path(), &["flight", "--timeout", "20"]);
    let line = stdout(&asked);
    assert!(line.contains("; disarmed (not armed)"), "{line}");
    let done = post(&server, &host, &origin, &token);
    assert!(
        done.starts_with("HTTP/1.1 200") && done.contains("arm: done; moving"),
        "{done}"
    );
    // After a stop it takes a second step, which names that stop.
    let stop = vpcctl(directory.path(), &["stop", "--timeout", "20"]);
    assert_eq!(stop.status.code(), Some(0), "{}", stderr(&stop));
    let refused = post(&server, &host, &origin, &token);
    assert!(
        refused.starts_with("HTTP/1.1 409") && refused.ends_with("vpcctl arm --veto 3\n"),
        "{refused}"
    );
    let fields =
        format!("Host: {host}\r\nOrigin: {origin}\r\nX-Vpc-Token: {token}\r\nX-Vpc-Veto: 3\r\n");
    let done = server.ask("POST /arm", &fields, 1 << 16);
    assert!(done.starts_with("HTTP/1.1 200"), "{done}");
}

#[test]
fn clients_are_bounded_in_number_and_head() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let endless = format!("X: {}\r\n", "a".repeat(20_000));
    let answer = server.ask("GET /", &endless, 1 << 16);
    assert!(
        answer.is_empty() || answer.starts_with("HTTP/1.1 431"),
        "{answer}"
    );
    let nonsense = server.ask("hello", "", 1 << 16);
    assert!(
        nonsense.is_empty() || nonsense.starts_with("HTTP/1.1 400"),
        "{nonsense}"
    );
    let host = format!("Host: {}\r\n", server.address);
    let views: Vec<_> = (0..5).map(|_| server.connect()).collect();
    for mut view in &views {
        write!(view, "GET /events HTTP/1.1\r\n{host}\r\n").unwrap();
        let mut head = [0; 15];
        view.read_exact(&mut head).unwrap();
        assert_eq!(&head, b"HTTP/1.1 200 OK");
    }
    let events = server.ask("GET /events", &host, 2048);
    assert!(
        events.starts_with("HTTP/1.1 503") && events.contains("5 views are open"),
        "{events}"
    );
    drop(views);
    testkit::eventually("a place for a view", || {
        let events = server.ask("GET /events", &host, 2048);
        events.starts_with("HTTP/1.1 200").then_some(())
    });
}

#[test]
fn a_server_ends_on_a_signal_though_a_page_reads() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let mut stream = server.connect();
    let address = &server.address;
    write!(stream, "GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    stream.read_exact(&mut [0; 1000]).unwrap();
    assert_eq!(server.process.terminated().code, Some(0));
}

#[test]
fn the_scene_that_the_daemon_left_in_the_domain_is_shown() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let without = server.events("");
    assert!(without.contains("\"known\":false"), "{without}");
    let path = directory.path().join(ipc::SCENE_FILE);
    std::fs::create_dir(path.parent().unwrap()).unwrap();
    std::fs::write(path, scene::PAPER_SIM).unwrap();
    let with = server.events("\"known\":true");
    assert!(with.contains("\"size\":[1024.0,1024.0]"), "{with}");
}

#[test]
fn commands_are_never_offered_to_the_network() {
    let directory = tempfile::tempdir().unwrap();
    for words in [
        ["serve", "--listen", "0.0.0.0:0"].as_slice(),
        &["serve", "--listen", "0.0.0.0:0", "--expose", "--control"],
    ] {
        let output = vpcctl(directory.path(), words);
        assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
    }
}

/// The answer to a page that has the picture with this tag: its head, and its bytes.
fn picture(server: &Server, tag: &str) -> (String, Vec<u8>) {
    let fields = format!("Host: {}\r\nIf-None-Match: {tag}\r\n", server.address);
    let mut answer = server.ask_bytes("GET /image", &fields, 1 << 24);
    let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n");
    let bytes = answer.split_off(end.unwrap() + 4);
    (String::from_utf8(answer).unwrap(), bytes)
}

#[test]
fn the_newest_image_is_served_to_who_has_not_got_it() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let (head, bytes) = picture(&server, "none");
    assert!(
        head.starts_with("HTTP/1.1 204") && bytes.is_empty(),
        "{head}"
    );
    assert!(server.events("").contains("\"image\":null"));
    let header = ImageHeader::new(1400, 700, Encoding::Bgr8, 0);
    let camera = Camera::start(directory.path(), header, |u, v| {
        [u as u8, v as u8, if u < 700 { 50 } else { 250 }]
    });
    let found = || {
        testkit::eventually("a picture", || {
            Some(picture(&server, "none")).filter(|(head, _)| head.starts_with("HTTP/1.1 200"))
        })
    };
    let (head, bytes) = found();
    assert!(
        head.contains("X-Vpc-Picture: 1400 700 700 350 bgr8\r\n"),
        "{head}"
    );
    assert_eq!(bytes.len(), 700 * 350 * 3);
    // The pixel (900, 20): row 10, column 450.
    let place = (10 * 700 + 450) * 3;
    assert_eq!(bytes[place..place + 3], [900_u32 as u8, 20, 250]);

    // The last image stays, and comes once.
    drop(camera);
    let mut tag = "none".to_owned();
    testkit::eventually("the last picture", || {
        let (head, bytes) = picture(&server, &tag);
        if head.starts_with("HTTP/1.1 304") {
            assert!(
                bytes.is_empty() && !head.contains("X-Vpc-Picture"),
                "{head}"
            );
            return Some(());
        }
        let found = head.split("Etag: ").nth(1).unwrap();
        tag = found.split('\r').next().unwrap().to_owned();
        None
    });
}

#[test]
fn a_page_that_commands_has_files_for_its_clients() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let mut shell = testkit::command("sh");
    shell.args(["-c", "ulimit -n 48; exec \"$@\"", "sh"]);
    shell.arg(env!("CARGO_BIN_EXE_vpcctl")).arg("--domain");
    shell.arg(directory.path()).args(["serve", "--control"]);
    let output = shell.args(["--listen", "127.0.0.1:0"]).output().unwrap();
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    let words = "at most 48 open files; allowed: 128 and more (ulimit -n)";
    assert!(stderr(&output).contains(words), "{}", stderr(&output));
}
