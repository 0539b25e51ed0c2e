//! Observers cost the loop nothing: `vpcctl watch`, `serve` with a page that reads and looks at the
//! camera's images, `serve --foxglove` with a client that reads all and one that reads nothing,
//! `metrics` with a collector that scrapes, and `record`, all at once beside the daemon at 250 Hz. The loop makes no heap call, page fault or blocking call from wake to send, and
//! misses no release while its processor runs (`paced`). A processor that stood still for a quarter of the period in one of
//! four cycles shows nothing.
//!
//! Views and metrics start while the camera is in motion: they receive from the daemon's ordinary
//! thread only. `record` receives the loop's own commands, and a new subscriber costs the loop some
//! heap calls once (`Report::WARM_UP`), so it starts first. `VPC_WITHOUT=warm-up` starts it with
//! the others, to see the counters count. The counts are the daemon's own, as in `faultless`. The
//! test also asserts that the observers received something.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use crate::fixture::{EndOnDrop, Running, are_installed, eventually, program, repeats, tell, turn};
use crate::machine::{is_without, may_have_a_processor};
use crate::paced::{Laps, Track};

/// The daemon's rate, Hz.
const RATE: u32 = 250;
/// Cycles before the views come: the camera is in motion by then.
const BEFORE: u32 = 500;
/// Runs at most, until the processor does not stand still too often.
const RUNS: usize = 3;
/// Most of the cycles in which the processor may stand still.
const UNFIT: f64 = 0.25;

/// `vpcctl` in this domain.
fn vpcctl(domain: &Path) -> Command {
    let mut command = testkit::command(program("vpcctl"));
    command.arg("--domain").arg(domain).stdin(Stdio::null());
    command
}

/// What the onlookers saw.
#[derive(Debug, Default)]
struct Seen {
    /// Bytes that `watch` wrote to its terminal.
    drawn: AtomicU64,
    /// Events that the page read.
    told: AtomicU64,
    /// Pictures that it got.
    shown: AtomicU64,
    /// Bytes that a client of Foxglove read.
    streamed: AtomicU64,
    /// Scrapes that found the daemon at work.
    scraped: AtomicU64,
    /// Commands in the recording.
    recorded: AtomicU64,
}

/// Starts `record`, and waits until it hears what the camera will say.
fn recorder(domain: &Path, scene: &Path, file: &Path) -> Running {
    let mut record = vpcctl(domain);
    record.arg("record").arg(file).arg("--scene").arg(scene);
    record.stdout(Stdio::piped()).stderr(Stdio::null());
    let record = Running::start(record);
    // Its file is made when all its ports are open.
    eventually("a recording", || file.exists().then_some(()));
    record
}

/// Ends `record`: commands that it recorded, by its last words.
fn finished(record: Running) -> u64 {
    let ended = record.terminated();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let words = ended.stdout;
    let (_, count) = words.split_once("/vpc/twist ").expect(&words);
    let count = count.split_whitespace().next();
    count.and_then(|count| count.parse().ok()).unwrap_or(0)
}

/// Starts `watch` in a terminal of its own, which keeps what it draws.
fn watch(domain: &Path, scene: &Path) -> Running {
    let (program, domain, scene) = (program("vpcctl"), domain.display(), scene.display());
    let program = program.display();
    let line =
        format!("stty rows 50 cols 160; exec {program} --domain {domain} watch --scene {scene}");
    let mut script = testkit::command("script");
    script.args(["-q", "-e", "-c", &line, "/dev/null"]);
    script.env("TERM", "xterm").stderr(Stdio::null());
    script.stdin(Stdio::piped()).stdout(Stdio::piped());
    Running::start(script)
}

/// Starts a server of `vpcctl`; with its address.
fn server(domain: &Path, words: &[&str]) -> (Running, String) {
    let mut command = vpcctl(domain);
    command.args(words);
    let mut server = Running::start(command.stdout(Stdio::piped()));
    let line = server.line("://");
    let (_, address) = line.split_once("://").unwrap();
    let address = address.split('/').next().unwrap().to_owned();
    (server, address)
}

/// Sends a request; what comes back is read from the stream.
fn asked(address: &str, path: &str) -> std::io::Result<TcpStream> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_secs(2)))?;
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"
    )?;
    Ok(stream)
}

/// A page that reads the stream of events until its server ends.
fn read_events(address: &str, seen: &Seen) {
    let lines = BufReader::new(asked(address, "/events").unwrap()).lines();
    for line in lines.map_while(Result::ok) {
        if line.starts_with("data: ") && line.contains("\"state\":\"moving\"") {
            seen.told.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// A client of Foxglove's WebSocket that has subscribed to all channels.
fn foxglove_client(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(2)))
        .unwrap();
    let head = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
        Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1";
    write!(
        stream,
        "GET / HTTP/1.1\r\nHost: {address}\r\n{head}\r\n\r\n"
    )
    .unwrap();
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 101");
    // Channels have numbers from 1; the server passes over those that it does not have.
    let wanted = (1..=30).map(|id| format!("{{\"id\":{id},\"channelId\":{id}}}"));
    let wanted = wanted.collect::<Vec<_>>().join(",");
    let text = format!("{{\"op\":\"subscribe\",\"subscriptions\":[{wanted}]}}");
    // A text frame of 16 bits of length, masked with zeros.
    let mut frame = vec![0x81, 0xfe];
    frame.extend((text.len() as u16).to_be_bytes());
    frame.extend([0; 4]);
    frame.extend(text.as_bytes());
    stream.write_all(&frame).unwrap();
    stream
}

/// Reads what Foxglove is sent, until its server ends.
fn stream(address: &str, seen: &Seen) {
    let (mut stream, mut buffer) = (foxglove_client(address), vec![0; 1 << 16]);
    while let Ok(count @ 1..) = stream.read(&mut buffer) {
        seen.streamed.fetch_add(count as u64, Ordering::Relaxed);
    }
}

/// A camera of 30 images a second, noise that no picture saves on.
fn send_images(domain: &Path, done: &AtomicBool) {
    let domain = ipc::Domain::join(domain).unwrap();
    let mut camera = domain.image_publisher(640 * 480).unwrap();
    while !done.load(Ordering::Relaxed) {
        let header = messages::ImageHeader::new(640, 480, messages::Encoding::Mono8, ipc::now_ns());
        let mut image = camera.loan(&header).unwrap();
        let pixels = image.iter_mut().enumerate();
        pixels.for_each(|(k, pixel)| *pixel = (k.wrapping_mul(0x9e37_79b9) >> 7) as u8);
        camera.publish(image).unwrap();
        std::thread::sleep(Duration::from_millis(33));
    }
}

/// A page that asks for more pictures than there are.
fn look_at_images(address: &str, seen: &Seen, done: &AtomicBool) {
    while !done.load(Ordering::Relaxed) {
        let mut answer = Vec::new();
        if let Ok(mut stream) = asked(address, "/image") {
            let _ = stream.read_to_end(&mut answer);
        }
        if answer.len() > 640 * 480 {
            seen.shown.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A collector that scrapes more often than any collector does.
fn scrape(address: &str, seen: &Seen, done: &AtomicBool) {
    while !done.load(Ordering::Relaxed) {
        let mut text = String::new();
        if let Ok(mut stream) = asked(address, "/metrics") {
            let _ = stream.read_to_string(&mut text);
        }
        if text.lines().any(|line| line == "vpc_up 1") {
            seen.scraped.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Runs the daemon for so many cycles among onlookers.
fn run(cycles: u64) -> (Laps, Seen) {
    let track = Track::new(RATE);
    let (domain, scene_file) = (track.place.domain(), &track.scene_file);
    let recording = track.place.path("run.mcap");
    let (seen, done) = (Seen::default(), AtomicBool::new(false));
    let laps = std::thread::scope(|threads| {
        let _done = EndOnDrop(&done);
        let record = || recorder(&domain, scene_file, &recording);
        let early = (!is_without("warm-up")).then(record);
        let (laps, (record, views)) = track.run(u64::from(BEFORE) + cycles, || {
            std::thread::sleep(Duration::from_secs(1) / RATE * BEFORE);
            let record = early.unwrap_or_else(record);
            let scene = scene_file.to_str().unwrap();
            let (serve, page) = server(
                &domain,
                &["serve", "--listen", "127.0.0.1:0", "--scene", scene],
            );
            let foxglove = ["serve", "--foxglove", "127.0.0.1:0", "--scene", scene];
            let (foxglove, live) = server(&domain, &foxglove);
            let (metrics, address) = server(&domain, &["metrics", "--listen", "127.0.0.1:0"]);
            let (seen, done) = (&seen, &done);
            let camera = domain.clone();
            threads.spawn(move || send_images(&camera, done));
            let pictures = page.clone();
            threads.spawn(move || look_at_images(&pictures, seen, done));
            let deaf = live.clone();
            threads.spawn(move || {
                let _deaf = foxglove_client(&deaf);
                while !done.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(50));
                }
            });
            threads.spawn(move || stream(&live, seen));
            threads.spawn(move || read_events(&page, seen));
            threads.spawn(move || scrape(&address, seen, done));
            (
                record,
                [watch(&domain, scene_file), serve, foxglove, metrics],
            )
        });
        let drawn = views[0].stdout().len() as u64;
        seen.drawn.store(drawn, Ordering::Relaxed);
        seen.recorded.store(finished(record), Ordering::Relaxed);
        // The page and the terminal end with their servers.
        drop(views);
        laps
    });
    (laps, seen)
}

/// Whether this run shows that onlookers cost no release, and not that the machine is unfit.
fn costs_no_release(cycles: u64) -> bool {
    let (laps, seen) = run(cycles);
    let Seen {
        drawn,
        told,
        shown,
        streamed,
        scraped,
        recorded,
    } = &seen;
    let [drawn, told, shown, streamed, scraped, recorded] =
        [drawn, told, shown, streamed, scraped, recorded]
            .map(|count| count.load(Ordering::Relaxed));
    let (report, missed, disturbed) = (&laps.report, laps.missed(), laps.disturbed());
    let told_all = format!(
        "onlookers: {missed} missed of {}, and {} while the processor stood still (in {:.1} % of the cycles); wake-up p99 {} max {} us, busy p99 {} us; drawn {drawn} bytes, {told} events, {shown} pictures, {streamed} bytes to Foxglove, {scraped} scrapes, {recorded} commands recorded",
        report.cycles,
        report.overruns - missed,
        disturbed * 100.0,
        report.wake_ns.p99 / 1000,
        report.wake_ns.max / 1000,
        report.busy_ns.p99 / 1000,
    );
    tell(&told_all);
    assert_eq!(missed, 0, "releases missed while the processor ran");
    if disturbed > UNFIT || report.armed < cycles * 9 / 10 {
        return false;
    }
    let seconds = cycles / u64::from(RATE);
    // They were there, each at its pace: a view draws and tells several times a second.
    assert!(drawn > 1000 * seconds, "{told_all}");
    assert!(told.min(shown).min(scraped) > 2 * seconds, "{told_all}");
    // A cycle has some 8 kB as JSON, and an image 300.
    assert!(streamed > 1_000_000 * seconds, "{told_all}");
    assert!(recorded > cycles * 8 / 10, "{told_all}");
    true
}

#[test]
#[ignore = "a quarter of a minute: CI runs it in a line of its own"]
fn watching_serving_metrics_and_recording_cost_the_loop_nothing() {
    let _turn = turn();
    let is_installed = are_installed("onlookers", &["script=bsdutils"]);
    if !is_installed || !may_have_a_processor("onlookers") {
        return;
    }
    let cycles = repeats("onlookers, cycles at 250 Hz", 2500, 18_000) as u64;
    if !(0..RUNS).any(|_| costs_no_release(cycles)) {
        tell("onlookers: NOT SHOWN on this machine, which stood still too often");
    }
}
