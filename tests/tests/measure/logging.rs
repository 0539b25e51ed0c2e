//! A log that cannot be written: a full disk, an unread pipe. The loop misses no release, lost
//! lines are counted, and the daemon ends in time.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use ipc::now_ns;
use messages::{Action, Outcome, Request};
use rustix::process::Signal;
use serde_json::Value;

use crate::fixture::{Place, Running, Witness, classes, eventually};
use crate::judge::{Miss, in_time};
use crate::reference::Class;
use crate::sheet::Sheet;

/// From SIGTERM to the end of the process, ns.
const END_NS: u64 = 500_000_000;

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
fn run(log: Stdio) -> anyhow::Result<Value> {
    let place = Place::new();
    let path = place.path("report.json");
    let mut command = place.vpcd("[log]\nlevel = 'debug'");
    command.arg("--report").arg(&path).stderr(log);
    let mut witness = Witness::new(&place);
    let daemon = Running::start(command);
    let _camera = Running::start(place.hw_sim(0));
    witness.set_in_motion()?;
    let before = witness.records().last().map_or(0, |record| record.overruns);
    let talk_ns = now_ns();
    make_it_talk(&mut witness);
    // It still answers.
    assert_eq!(witness.ask(Action::Status), Outcome::Done);
    let asked_ns = now_ns();
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    in_time("ended", Class::Ordinary, asked_ns, now_ns(), END_NS)?;
    let report = report(&path);
    let missed = count(&report, "overruns") - before;
    if missed > 0 {
        let what = format!("{missed} releases missed");
        return Err(Miss::upset(what, Class::of_vpcd(), talk_ns, now_ns()).into());
    }
    assert_eq!(report["lost_records"], 0, "{report}");
    Ok(report)
}

fn count(report: &Value, name: &str) -> u64 {
    report[name].as_u64().unwrap()
}

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let full = || Ok(std::fs::File::create("/dev/full")?.into());
    lossy("full disk", sheet, full);
    let (unread, pipe) = std::io::pipe().unwrap();
    lossy("unread pipe", sheet, || Ok(pipe.into()));
    drop(unread);
    sheet.round(&classes(), "a failure that nobody reads", || {
        fails_unread();
        Ok(())
    });
    sheet.round(&classes(), "somebody reads again", || {
        tells_of_losses();
        Ok(())
    });
}

/// A log that loses lines: no release is missed.
fn lossy(name: &str, sheet: &mut Sheet, log: impl FnOnce() -> anyhow::Result<Stdio>) {
    if let Some(report) = sheet.round(&classes(), name, || run(log()?)) {
        let lost = count(&report, "lost_lines");
        sheet.figure(&format!("{name}: lines lost"), lost as f64, "");
        sheet.check(lost > 100, || format!("{name}: {lost} lines lost"));
        sheet.bar(&format!("{name}: releases missed"), 0.0, "", 0.0);
    }
}

/// An end of a pipe that is full to the brim: a failure ends the daemon as soon as it would.
fn fails_unread() {
    let place = Place::new();
    let (unread, pipe) = std::io::pipe().unwrap();
    rustix::fs::fcntl_setfl(&pipe, rustix::fs::OFlags::NONBLOCK).unwrap();
    while rustix::io::write(&pipe, &[b'x'; 4096]).is_ok() {}
    rustix::fs::fcntl_setfl(&pipe, rustix::fs::OFlags::empty()).unwrap();
    let mut command = place.vpcd("[law]\nnp = 0");
    command.stderr(pipe);
    assert_eq!(Running::start(command).ended().code, Some(78));
    drop(unread);
}

/// Losses end when somebody reads again.
fn tells_of_losses() {
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
