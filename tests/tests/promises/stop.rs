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
    CAMERA_PRIORITY, EndOnDrop, PERIOD_NS, Place, Running, Witness, eventually, is_still, program,
    repeats, tell, turn,
};
use crate::machine::on_time;
use crate::stall::{fairly, in_time};

/// From the asking to the first zero twist, ns.
const ZERO_NS: u64 = 3 * PERIOD_NS;
/// From the start of `vpcctl stop` to its end, ns.
const BACK_NS: u64 = 200_000_000;
/// Requests that a flooder sends in a millisecond.
const FLOOD: u64 = 10;
/// Watchers of the page.
const WATCHERS: usize = 64;

#[test]
fn a_stop_gets_through_floods_full_places_and_a_held_lock() {
    let _turn = turn();
    let mut worst = [0; 2];
    for round in 0..repeats("stops under attack", 3, 50) {
        let took = fairly(&format!("stop {round}"), || attacked(round));
        worst = std::array::from_fn(|k| worst[k].max(took[k]));
    }
    tell(format!(
        "stop under attack: zero after {} ms at most, vpcctl back after {} ms at most",
        worst[0] / 1_000_000,
        worst[1] / 1_000_000
    ));
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
        witness.set_in_motion();
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
        assert!(stopped.status.success(), "{stopped:?}");
        let asked_ns = asked_ns(&directory)?;
        std::thread::sleep(Duration::from_nanos(2 * PERIOD_NS));
        let commands = witness.commands();
        let mut after = commands
            .iter()
            .filter(|command| command.stamp.published_ns >= asked_ns);
        let zero = after
            .find(|command| is_still(command))
            .context("no zero twist")?;
        assert!(after.all(is_still), "it moves on");
        assert!(
            commands.iter().any(|command| !is_still(command)),
            "nothing moved before"
        );
        startup.unlock()?;
        drop(page);
        let zero_ns = in_time("zero", asked_ns, zero.stamp.published_ns, ZERO_NS)?;
        let back_ns = in_time("vpcctl back", begin_ns, back_ns, BACK_NS)?;
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
