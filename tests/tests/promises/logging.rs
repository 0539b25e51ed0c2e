//! A log that cannot be written: a full disk, an unread pipe. The loop misses no release, lost
//! lines are counted, and the daemon ends in time.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::ensure;
use ipc::now_ns;
use messages::{Action, Outcome, Request};
use rustix::process::Signal;
use serde_json::Value;

use crate::fixture::{Place, Running, Witness, eventually, tell, turn};
use crate::stall::{fairly, in_time};

/// Requests that break the contract: each is a line of the log.
const NOISE: usize = 20_000;

fn report(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Sends requests that break the contract, as many at a time as the daemon takes.
fn make_it_talk(witness: &mut Witness) {
    for id in 0..NOISE {
        let mut request = Request::new(id as u64, Action::Status);
        request.action = 1000;
        witness.say(&request);
        if id % 8 == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Runs the daemon with its standard error going to `log` while a client makes it talk; its report.
fn run(place: &Place, log: Stdio) -> anyhow::Result<Value> {
    let path = place.path("report.json");
    let mut command = place.vpcd("[log]\nlevel = 'debug'");
    command.arg("--report").arg(&path).stderr(log);
    let mut witness = Witness::new(place);
    let daemon = Running::start(command);
    let _camera = Running::start(place.hw_sim(0));
    witness.set_in_motion();
    make_it_talk(&mut witness);
    // It still answers.
    assert_eq!(witness.ask(Action::Status), Outcome::Done);
    let asked_ns = now_ns();
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    in_time("ended", asked_ns, now_ns(), 500_000_000)?;
    Ok(report(&path))
}

/// Releases missed and records lost.
fn misses(report: &Value) -> (u64, u64) {
    (
        report["overruns"].as_u64().unwrap(),
        report["lost_records"].as_u64().unwrap(),
    )
}

#[test]
fn a_full_disk_and_an_unread_pipe_cost_no_cycle() {
    let _turn = turn();
    fairly("logs that nobody takes", compare);
}

fn compare() -> anyhow::Result<()> {
    let place = Place::new();
    let file = std::fs::File::create(place.path("vpcd.log")).unwrap();
    let read = run(&place, file.into())?;
    let place = Place::new();
    let full = std::fs::File::create("/dev/full").unwrap();
    let full = run(&place, full.into())?;
    let place = Place::new();
    let (unread, pipe) = std::io::pipe().unwrap();
    let piped = run(&place, pipe.into())?;
    drop(unread);
    tell(format!(
        "missed releases and lost records: file {:?}, full disk {:?}, unread pipe {:?}; lines lost {}, {}, {}",
        misses(&read),
        misses(&full),
        misses(&piped),
        read["lost_lines"],
        full["lost_lines"],
        piped["lost_lines"]
    ));
    for other in [&full, &piped] {
        ensure!(misses(other).0 <= misses(&read).0, "{other} against {read}");
        assert_eq!(misses(other).1, 0, "{other}");
        assert!(other["lost_lines"].as_u64().unwrap() > 100, "{other}");
    }
    Ok(())
}

#[test]
fn a_failure_is_no_less_a_failure_when_nobody_reads_of_it() {
    let _turn = turn();
    let place = Place::new();
    let (unread, pipe) = std::io::pipe().unwrap();
    // Full to the brim.
    rustix::fs::fcntl_setfl(&pipe, rustix::fs::OFlags::NONBLOCK).unwrap();
    while rustix::io::write(&pipe, &[b'x'; 4096]).is_ok() {}
    rustix::fs::fcntl_setfl(&pipe, rustix::fs::OFlags::empty()).unwrap();
    let mut command = place.vpcd("[law]\nnp = 0");
    command.stderr(pipe);
    let born = Instant::now();
    assert_eq!(Running::start(command).ended().code, Some(78));
    assert!(
        born.elapsed() < Duration::from_secs(2),
        "{:?}",
        born.elapsed()
    );
    drop(unread);
}

#[test]
fn losses_end_when_somebody_reads_again() {
    use std::io::{BufRead, BufReader};
    let _turn = turn();
    let place = Place::new();
    let (reader, pipe) = std::io::pipe().unwrap();
    let mut command = place.vpcd("[log]\nlevel = 'debug'");
    command.stderr(pipe);
    let mut witness = Witness::new(&place);
    let daemon = Running::start(command);
    assert_eq!(witness.ask(Action::Status), Outcome::Done);
    make_it_talk(&mut witness);
    let mut lines = BufReader::new(reader).lines();
    let told = eventually("a line about what was lost", || {
        lines
            .next()?
            .ok()
            .filter(|line| line.contains("lines of the log lost"))
    });
    assert!(told.starts_with("vpcd: "), "{told}");
    daemon.kill();
}
