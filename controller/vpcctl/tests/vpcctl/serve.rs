//! `serve`: who may see, who may command, and the page in a real browser where one is installed.

use std::io::{Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use messages::{Encoding, ImageHeader};

use crate::browser::Browser;
use crate::metrics::Server;
use crate::stand_in::{Camera, StandIn};
use crate::{painted_scene, stderr, stdout, vpcctl};

#[test]
fn the_page_and_its_events_are_served() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let page = server.get("/");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("<canvas id=\"image\">"));
    assert!(page.contains("default-src 'none'"), "{page}");
    let events = server.events(2);
    assert!(
        events.contains("Content-Type: text/event-stream\r\n"),
        "{events}"
    );
    assert!(events.contains("\r\ndata: {"), "{events}");
    assert!(events.contains("\"control\":false"), "{events}");
    assert!(events.contains("\"state\":\"disarmed\""), "{events}");
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
    let status = vpcctl(directory.path(), &["status", "--watch", "0.2"]);
    assert_eq!(
        status.status.code(),
        Some(5),
        "something armed it:\n{}",
        stdout(&status)
    );
    let done = post(&server, &host, &origin, &token);
    assert!(
        done.starts_with("HTTP/1.1 200") && done.contains("arm: done; moving"),
        "{done}"
    );
    // After a stop it takes a second step, which names that stop.
    let stop = vpcctl(directory.path(), &["stop"]);
    assert_eq!(stop.status.code(), Some(0), "{}", stderr(&stop));
    let refused = post(&server, &host, &origin, &token);
    assert!(
        refused.starts_with("HTTP/1.1 409") && refused.ends_with("vpcctl arm --stops 1\n"),
        "{refused}"
    );
    let fields =
        format!("Host: {host}\r\nOrigin: {origin}\r\nX-Vpc-Token: {token}\r\nX-Vpc-Stops: 1\r\n");
    let done = server.ask("POST /arm", &fields, 1 << 16);
    assert!(done.starts_with("HTTP/1.1 200"), "{done}");
}

#[test]
fn clients_are_bounded_in_number_head_and_time() {
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
    // Views that are never read.
    let host = format!("Host: {}\r\n\r\n", server.address);
    let clients: Vec<_> = (0..5).map(|_| server.connect()).collect();
    for mut client in &clients {
        rustix::net::sockopt::set_socket_recv_buffer_size(client, 4096).unwrap();
        write!(client, "GET /events HTTP/1.1\r\n{host}").unwrap();
    }
    std::thread::sleep(Duration::from_millis(200));
    let host = format!("Host: {}\r\n", server.address);
    let events = server.ask("GET /events", &host, 2048);
    assert!(
        events.starts_with("HTTP/1.1 503") && events.contains("5 views are open"),
        "{events}"
    );
    testkit::eventually("idle clients are dropped", || {
        let events = server.ask("GET /events", &host, 2048);
        events.starts_with("HTTP/1.1 200").then_some(())
    });
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
    let server = Server::with_descriptors(128, directory.path(), &words);
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

#[test]
fn a_server_ends_on_a_signal_though_a_page_reads() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let mut server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let mut stream = server.connect();
    let address = &server.address;
    write!(stream, "GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    stream.read_exact(&mut [0; 1000]).unwrap();
    assert_eq!(server.terminate(), Some(0));
}

#[test]
fn the_scene_that_the_daemon_left_in_the_domain_is_shown() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let server = Server::start(directory.path(), &["serve", "--listen", "127.0.0.1:0"]);
    let without = server.events(1);
    assert!(without.contains("\"known\":false"), "{without}");
    let path = directory.path().join(ipc::SCENE_FILE);
    std::fs::create_dir(path.parent().unwrap()).unwrap();
    std::fs::write(path, scene::PAPER_SIM).unwrap();
    let with = server.events(1);
    assert!(with.contains("\"known\":true"), "{with}");
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
    assert!(server.events(1).contains("\"image\":null"));
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
    let status = stdout(&vpcctl(directory.path(), &["status", "--watch", "0.5"]));
    assert!(status.contains("image     1400 x 700 bgr8, "), "{status}");
    let json = stdout(&vpcctl(
        directory.path(),
        &["status", "--json", "--watch", "0.5"],
    ));
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let rate = json["image"]["rate_hz"].as_f64().unwrap();
    assert!((20.0..=100.0).contains(&rate), "{rate}");

    // The last image stays, and comes once.
    drop(camera);
    let (head, tag) = testkit::eventually("the last picture", || {
        let (head, _) = found();
        let tag = head
            .split("Etag: ")
            .nth(1)
            .unwrap()
            .split('\r')
            .next()
            .unwrap()
            .to_owned();
        std::thread::sleep(Duration::from_millis(200));
        let (head, _) = picture(&server, &tag);
        head.starts_with("HTTP/1.1 304").then_some((head, tag))
    });
    assert!(!head.contains("X-Vpc-Picture"), "{head}");
    std::thread::sleep(Duration::from_millis(200));
    assert!(picture(&server, &tag).0.starts_with("HTTP/1.1 304"));
}

/// The page in a real browser; `None`, and a word about it, where there is none.
fn browse(domain: &Path, options: &[&str]) -> Option<(Server, Browser)> {
    let words = [&["serve", "--listen", "127.0.0.1:0"], options].concat();
    let server = Server::start(domain, &words);
    let url = server.line.trim().rsplit(' ').next()?;
    let browser = Browser::open(domain, url);
    if browser.is_none() {
        testkit::not_run("the page in a browser", "no chromium");
    }
    Some((server, browser?))
}

#[test]
fn a_browser_shows_the_painted_mask_where_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let scene = painted_scene(directory.path());
    let scene = scene.to_str().unwrap();
    let Some((_server, mut browser)) = browse(directory.path(), &["--scene", scene]) else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    // The ring is painted to the left, the right, above and below its middle, which is clear.
    let painted = "(() => { const c = document.getElementById('image'), s = c.width / 1024; \
        const at = (u, v) => c.getContext('2d').getImageData(u * s, v * s, 1, 1).data[3] > 0; \
        return [[140, 700], [460, 700], [300, 540], [300, 860]].every(p => at(...p)) \
        && ![[300, 700], [90, 700], [300, 470], [500, 880]].some(p => at(...p)); })()";
    browser.wait_for(painted);
    // Without --control there is nothing to press.
    browser.wait_for("getComputedStyle(document.getElementById('buttons')).display === 'none'");
    browser.keep_picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("serve-mask.png"));
}

/// Of a camera with a square image and of a wide one.
#[test]
fn the_image_fills_its_panel_on_a_desk_and_on_a_phone() {
    for (name, text) in [
        ("sim", scene::PAPER_SIM.to_owned()),
        (
            "wide",
            scene::PAPER_SIM.replacen("height = 1024", "height = 720", 1),
        ),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let _daemon = StandIn::sound(directory.path());
        let path = directory.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        let options = ["--scene", path.to_str().unwrap()];
        let Some((_server, mut browser)) = browse(directory.path(), &options) else {
            return;
        };
        browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
        let fills = "(() => { const c = document.getElementById('image'), box = c.parentElement, \
            panel = box.parentElement, title = panel.querySelector('h2'); \
            const bottom = panel.getBoundingClientRect().bottom - c.getBoundingClientRect().bottom; \
            return c.clientWidth > 200 && Math.abs(c.clientWidth - title.clientWidth) <= 1 && bottom < 12 \
            && Math.abs(c.clientWidth / c.clientHeight - scene.size[0] / scene.size[1]) < .01; })()";
        for (width, height) in [(1280, 800), (390, 844), (1280, 800)] {
            browser.resize(width, height);
            // As before the numbers below it were there.
            browser.value("document.getElementById('image').parentElement.style.height = '900px'");
            browser.wait_for(&format!("innerWidth === {width} && {fills}"));
            // Nothing sticks out, and on a desk nothing has to be scrolled to.
            browser.wait_for("document.documentElement.scrollWidth <= innerWidth");
            browser.wait_for(
                "innerWidth < 800 || document.documentElement.scrollHeight <= innerHeight",
            );
            let file = format!("serve-{name}-{width}.png");
            browser.keep_picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join(file));
        }
    }
}

#[test]
fn trails_break_where_runs_begin_and_features_are_missing() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let Some((_server, mut browser)) = browse(directory.path(), &[]) else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    browser.wait_for("cycles.some(row => Number.isFinite(row[FRAME]))");
    // Time and number of the frame: a run ends with frame 8, and the features of the next stay away
    // for half a second.
    let lengths = "(() => { const row = ([t, frame]) => [t, ...Array(10).fill(0), [[t, 5]], frame]; \
        used = 1; cycles = [[.1, 7], [.2, 8], [.3, 1], [.4, 2], [.5, 3], [1, 18]].map(row); \
        return pieces().map(piece => piece.length).join(); })()";
    assert_eq!(browser.value(lengths), "2,3,1");
}

#[test]
fn a_browser_shows_the_image_of_the_camera_under_the_lines() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let scene = painted_scene(directory.path());
    let Some((_server, mut browser)) =
        browse(directory.path(), &["--scene", scene.to_str().unwrap()])
    else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    browser.wait_for("document.getElementById('camera').hidden");
    // A red square on black, its edges between pixels 399 and 400, 599 and 600.
    let header = ImageHeader::new(1024, 1024, Encoding::Bgr8, 0);
    let camera = Camera::start(directory.path(), header, |u, v| {
        let is_inside = [u, v].iter().all(|x| (400..600).contains(x));
        [0, 0, if is_inside { 255 } else { 0 }]
    });
    let seen = "at = (u, v) => { const c = document.getElementById('image'), s = c.width / 1024; \
        return c.getContext('2d').getImageData(u * s, v * s, 1, 1).data; }; \
        isRed = (u, v) => at(u, v)[0] > 80 && at(u, v)[1] < 20 && at(u, v)[3] > 0; \
        isBlack = (u, v) => at(u, v)[0] < 20 && at(u, v)[3] > 80; 0";
    browser.value(seen);
    browser.wait_for("isRed(500, 450) && isRed(405, 405) && isRed(595, 595)");
    browser.wait_for("isBlack(390, 450) && isBlack(500, 390) && isBlack(610, 500)");
    // The occlusion, the goal and a feature are on top of it.
    browser.wait_for("at(140, 700)[1] > 40 && at(700, 500)[2] > 100 && !isRed(700, 500)");
    browser.keep_picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("serve-image.png"));
    // Without it, where one switches it off, the page is as before.
    browser.value("document.getElementById('live').click()");
    browser.wait_for("at(500, 450)[3] === 0 && at(140, 700)[3] > 0");
    browser.value("count = 0; fetch = (f => (...a) => { count++; return f(...a); })(fetch); 0");
    browser.value("document.getElementById('live').click()");
    browser.wait_for("isRed(500, 450)");
    // Ten pictures a second, and none for an image that it has.
    browser.value("count = 0; begin_ms = performance.now(); 0");
    std::thread::sleep(Duration::from_secs(1));
    browser.wait_for("count > 2 && count <= (performance.now() - begin_ms) / 100 + 1");
    drop(camera);
    browser.wait_for("document.getElementById('age').textContent.endsWith('s ago')");
    browser.value("count = 0; 0");
    std::thread::sleep(Duration::from_millis(500));
    browser.wait_for("count === 0 && isRed(500, 450)");
}

#[test]
fn a_browser_shows_the_run_and_its_buttons_command() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let Some((_server, mut browser)) = browse(directory.path(), &["--control"]) else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    browser.wait_for("document.getElementById('cause').textContent === 'not armed'");
    browser.wait_for("document.getElementById('numbers').innerText.includes('25.5 px')");
    browser.wait_for("getComputedStyle(document.getElementById('buttons')).display === 'flex'");
    // Something is painted where feature 0 is, (700, 500) of 1280 x 960 px.
    let pixel = "(() => { const c = document.getElementById('image'); const s = c.width / 1280; \
        return c.getContext('2d').getImageData(700 * s, 500 * s, 1, 1).data[3] > 0; })()";
    browser.wait_for(pixel);
    // As many tabs as a browser has connections, and more.
    browser.value("others = [...Array(8)].map(() => new EventSource('events')); 0");
    browser.value("document.getElementById('arm').click()");
    browser.wait_for("document.getElementById('state').textContent === 'moving'");
    browser.wait_for("document.getElementById('answer').textContent.startsWith('arm: done')");
    browser.value("document.getElementById('stop').click()");
    browser.wait_for("document.getElementById('cause').textContent === 'operator'");
    browser.value("confirm = () => false; document.getElementById('teach').click()");
    browser.wait_for("document.getElementById('answer').textContent.startsWith('stop')");
    // The stand-in has left no configuration.
    browser.value("confirm = () => true; document.getElementById('teach').click()");
    browser.wait_for("document.getElementById('answer').textContent.includes('config/vpcd.toml')");
}
