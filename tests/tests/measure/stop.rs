//! A stop gets through what keeps every request waiting: floods of requests, no place left, a
//! process that holds the lock on joining, a page full of watchers.

use std::fs::File;
use std::io::Write;
use std::net::TcpStream;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, ensure};
use ipc::{Domain, OpenError, OperatorPorts, STOP_FILE, now_ns};
use messages::{Action, Message, Request};

use crate::fixture::{
    CAMERA_PRIORITY, PERIOD_NS, Place, Running, Witness, classes, eventually, is_still, on_time,
    program,
};
use crate::judge::{Miss, in_time};
use crate::load::EndOnDrop;
use crate::reference::Class;
use crate::sheet::Sheet;

/// From the asking to the first zero twist, ns.
const ZERO_NS: u64 = 3 * PERIOD_NS;
/// From the start of `vpcctl stop` to its end, ns.
const BACK_NS: u64 = 200_000_000;
/// Requests that a flooder sends in a millisecond.
const FLOOD: u64 = 10;
/// Watchers of the page.
const WATCHERS: usize = 64;

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    for round in 0..sheet.repeats(3, 50) {
        let what = format!("stop {round}");
        if let Some([zero_ns, back_ns]) = sheet.round(&classes(), &what, || attacked(round)) {
            sheet.longest("zero after", zero_ns, ZERO_NS);
            sheet.longest("vpcctl back after", back_ns, BACK_NS);
        }
    }
}

/// One stop of a moving camera under attack: how long until the zero twist, and until `vpcctl` is
/// back, ns.
fn attacked(round: usize) -> anyhow::Result<[u64; 2]> {
    let place = Place::new();
    let directory = place.domain();
    let mut witness = Witness::new(&place);
    let _daemon = Running::start(place.vpcd(""));
    let page = watched_page(&place)?;
    let end = AtomicBool::new(false);
    std::thread::scope(|threads| {
        let _end = EndOnDrop(&end);
        let mut flooders = 0;
        // Until no place is left.
        loop {
            let domain = Domain::join(&directory)?;
            match OperatorPorts::open(&domain) {
                Ok(_) => drop(domain),
                Err(OpenError::Taken { .. } | OpenError::Full { .. }) => break,
                Err(error) => return Err(error.into()),
            }
            let (directory, end) = (&directory, &end);
            let (ready, is_ready) = std::sync::mpsc::channel();
            threads.spawn(move || {
                let domain = Domain::join(directory).unwrap();
                let mut operator = OperatorPorts::open(&domain).unwrap();
                ready.send(()).unwrap();
                flood(&mut operator, end);
            });
            is_ready.recv()?;
            flooders += 1;
        }
        // The witness has a place of its own.
        ensure!(
            flooders == Request::QOS.publishers - 1,
            "{flooders} flooders"
        );
        let _camera = Running::start(on_time(place.hw_sim(round % 100), CAMERA_PRIORITY));
        witness.set_in_motion()?;
        let startup = File::open(directory.join("startup"))?;
        startup.lock()?;
        std::thread::sleep(Duration::from_nanos(4 * PERIOD_NS));

        let begin_ns = now_ns();
        let stopped = testkit::command(program("vpcctl"))
            .arg("--domain")
            .arg(&directory)
            .arg("stop")
            .output()?;
        let back_ns = now_ns();
        let what = || format!("vpcctl stop: {stopped:?}");
        Miss::unless(stopped.status.success(), what, Class::Ordinary, begin_ns)?;
        let asked_ns = asked_ns(&directory)?;
        let mut commands = Vec::new();
        let zero_ns = eventually("a zero twist", || {
            commands.extend(witness.commands());
            let mut after = commands
                .iter()
                .filter(|command| command.stamp.published_ns >= asked_ns);
            let zero = after.find(|command| is_still(command))?;
            Some(zero.stamp.published_ns)
        });
        std::thread::sleep(Duration::from_nanos(2 * PERIOD_NS));
        commands.extend(witness.commands());
        let mut since = commands
            .iter()
            .filter(|command| command.stamp.published_ns >= zero_ns);
        assert!(since.all(is_still), "it moves on");
        assert!(
            commands.iter().any(|command| !is_still(command)),
            "nothing moved before"
        );
        startup.unlock()?;
        drop(page);
        let zero_ns = in_time("zero", Class::of_vpcd(), asked_ns, zero_ns, ZERO_NS)?;
        let back_ns = in_time("vpcctl back", Class::Ordinary, begin_ns, back_ns, BACK_NS)?;
        Ok([zero_ns, back_ns])
    })
}

/// When the last stop was asked for, which `vpcctl` writes behind its process id.
fn asked_ns(directory: &std::path::Path) -> anyhow::Result<u64> {
    let content = std::fs::read(directory.join(STOP_FILE))?;
    let text = String::from_utf8_lossy(&content[..32]).into_owned();
    let text = text.trim_end_matches('\0');
    let (_, ns) = text.split_once(' ').context("no time")?;
    Ok(ns.parse()?)
}

fn flood(operator: &mut OperatorPorts, end: &AtomicBool) {
    // Other ones than the witness has, who would take an answer for its own.
    let mut id = 1 << 32;
    while !end.load(Ordering::Relaxed) {
        for _ in 0..FLOOD {
            id += 1;
            let request = Request::new(id, Action::Status);
            operator.requests.publish(&request).unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The page, with as many watchers as can be.
fn watched_page(place: &Place) -> anyhow::Result<(Running, Vec<TcpStream>)> {
    let mut command = testkit::command(program("vpcctl"));
    command.arg("--domain").arg(place.domain());
    command.args(["serve", "--listen", "127.0.0.1:0", "--control"]);
    let mut page = Running::start(command.stdout(Stdio::piped()));
    let line = page.line("live view at");
    let address = line
        .split("http://")
        .nth(1)
        .and_then(|rest| rest.split('/').next())
        .context("no address")?
        .to_owned();
    let watchers = eventually("watchers", || {
        let connect = |_| {
            let mut stream = TcpStream::connect(&address).ok()?;
            write!(stream, "GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n").ok()?;
            Some(stream)
        };
        (0..WATCHERS).map(connect).collect::<Option<Vec<_>>>()
    });
    Ok((page, watchers))
}
