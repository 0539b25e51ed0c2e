//! Observers cost the loop nothing: `vpcctl watch`, `serve` with a page that reads and looks at the
//! camera's images, `serve --foxglove` with a client that reads all and one that reads nothing,
//! `metrics` with a collector that scrapes, and `record`, all at once beside the daemon at 250 Hz.
//! The loop makes no heap call, page fault or blocking call from wake to send, and misses no release
//! unless the reference is late (`paced`).
//!
//! Views and metrics start while the camera is in motion: they receive from the daemon's ordinary
//! thread only. `record` receives the loop's own commands, and a new subscriber costs the loop some
//! heap calls once (`Report::WARM_UP`), so it starts first. `VPC_WITHOUT=warm-up` starts it with
//! the others, to see the counters count. The counts are the daemon's own, as in `faultless`.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use crate::fixture::{Running, eventually, program};
use crate::load::EndOnDrop;
use crate::machine::{is_without, may_be_real_time};
use crate::paced::{Laps, Track};
use crate::reference::Class;
use crate::sheet::Sheet;

/// The daemon's rate, Hz.
const RATE: u32 = 250;
/// Cycles before the views come: the camera is in motion by then.
const BEFORE: u32 = 500;
/// Most of the cycles in which the reference may be late by a quarter of the period.
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

/// Runs the daemon for `cycles` cycles among onlookers.
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

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    if !sheet.has(&["script=bsdutils"]) {
        return;
    }
    let cycles = sheet.repeats(2500, 18_000) as u64;
    let class = Class::of_vpcd();
    let Some((laps, seen)) = sheet.round(&[class], "run", || Ok(run(cycles))) else {
        return;
    };
    let report = &laps.report;
    let missed = laps.missed();
    let own: Vec<_> = missed.iter().filter(|m| !m.is_the_machines).collect();
    let disturbed = laps.disturbed();
    sheet.figure("cycles", report.cycles as f64, "");
    sheet.bar("cycles that missed a release", own.len() as f64, "", 0.0);
    let machines = missed.len() - own.len();
    sheet.figure("those in which the reference was late", machines as f64, "");
    sheet.figure("wake-up p99", report.wake_ns.p99 as f64 / 1e3, "us");
    sheet.figure("busy p99", report.busy_ns.p99 as f64 / 1e3, "us");
    sheet.figure("cycles disturbed", disturbed * 100.0, "%");
    let counted = [
        ("page faults", report.minor_faults + report.major_faults),
        ("blocking calls", report.blocked),
        ("heap calls", report.allocations),
    ];
    let is_real_time = may_be_real_time();
    for (name, count) in counted {
        sheet.bar(name, count as f64, "", 0.0);
        // Without real time memory is not locked.
        if is_real_time || name != "page faults" {
            sheet.check(count == 0, || format!("{count} {name}"));
        }
    }
    sheet.check(own.is_empty(), || {
        format!("releases missed, first {:?}", own[0])
    });
    // They were there, each at its pace: a view draws and tells several times a second, a cycle has
    // some 8 kB as JSON, and an image 300.
    let seconds = cycles / u64::from(RATE);
    let paces = [
        ("bytes drawn", &seen.drawn, 1000 * seconds),
        ("events", &seen.told, 2 * seconds),
        ("pictures", &seen.shown, 2 * seconds),
        ("bytes to Foxglove", &seen.streamed, 1_000_000 * seconds),
        ("scrapes", &seen.scraped, 2 * seconds),
        ("commands recorded", &seen.recorded, cycles * 8 / 10),
    ];
    for (name, count, least) in paces {
        let count = count.load(Ordering::Relaxed);
        sheet.figure(name, count as f64, "");
        // Observers are ordinary: a busy machine keeps them from it.
        if count < least {
            sheet.lacks(format!("only {count} {name}"));
        }
    }
    if !is_real_time {
        sheet.lacks("no right to real time (vpcd --preflight)");
    }
    if disturbed > UNFIT || report.armed < cycles * 9 / 10 {
        let share = disturbed * 100.0;
        sheet.lacks(format!(
            "the reference was late in {share:.0} % of the cycles"
        ));
    }
}
