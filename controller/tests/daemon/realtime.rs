//! What a process says that does not get real time. That it gets all of it where it may
//! `cargo xtask measure realtime` shows.

use std::process::Command;

use serde_json::Value;

use crate::fixture::{Place, ended, not_run, scene_file, vpcd, vpcd_in};

/// A command without the right to real time: as we are where we have none, else without the
/// capabilities. None if they cannot be dropped.
fn without_rights(command: &Command) -> Option<Command> {
    if !rustix::process::geteuid().is_root() {
        let mut same = testkit::command(command.get_program());
        same.args(command.get_args());
        return Some(same);
    }
    let mut less = testkit::command("setpriv");
    less.args(["--bounding-set", "-sys_nice,-ipc_lock", "--", "prlimit"]);
    less.args(["--rtprio=0", "--memlock=8388608", "--"]);
    less.arg(command.get_program()).args(command.get_args());
    let mut probe = testkit::command("setpriv");
    probe.args([
        "--bounding-set",
        "-sys_nice,-ipc_lock",
        "--",
        "prlimit",
        "--version",
    ]);
    let works = probe.output().is_ok_and(|output| output.status.success());
    works.then_some(less)
}

fn config(place: &Place) -> std::path::PathBuf {
    let text = format!(
        "scene = '{}'\n[realtime]\npriority = 10\ncpu = 0\n",
        scene_file().display()
    );
    place.file("v.toml", text)
}

fn report(place: &Place) -> Value {
    let text = std::fs::read_to_string(place.path("report.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// Three cycles of a daemon that asks for real time, with a report.
fn three_cycles(place: &Place) -> Command {
    let mut command = vpcd_in(place);
    command.arg("--config").arg(config(place));
    command.args(["--cycles", "3", "--report"]);
    command.arg(place.path("report.json"));
    command
}

#[test]
fn without_the_right_real_time_is_degraded_and_says_so_once() {
    let place = Place::new();
    let Some(command) = without_rights(&three_cycles(&place)) else {
        return not_run(
            "less rights",
            "setpriv and prlimit cannot take capabilities away",
        );
    };
    let (code, log) = ended(command);
    assert_eq!(code, 0, "{log}");
    assert_eq!(log.matches("DEGRADED").count(), 1, "{log}");
    for words in [
        "no SCHED_FIFO at priority 10",
        "LimitRTPRIO=",
        "the limit is 8192 KiB",
    ] {
        assert!(log.contains(words), "{log}\nlacks {words}");
    }
    let report = report(&place);
    // Asked for, no SCHED_FIFO, memory not locked; the processor is anybody's to choose.
    assert_eq!(
        (&report["realtime"], &report["cycles"]),
        (&11.into(), &3.into())
    );
    assert_eq!(report["locked_kib"], 0);
}

#[test]
fn a_processor_that_is_not_there_is_told() {
    let place = Place::new();
    let mut command = vpcd_in(&place);
    let text = format!(
        "scene = '{}'\n[realtime]\npriority = 10\ncpu = 1000\n",
        scene_file().display()
    );
    command.arg("--config").arg(place.file("v.toml", text));
    let (code, log) = ended({
        command.args(["--cycles", "1"]);
        command
    });
    assert_eq!(code, 0, "{log}");
    assert!(log.contains("not on processor 1000"), "{log}");
}

#[test]
fn a_report_that_cannot_be_written_is_73() {
    let place = Place::new();
    let mut command = vpcd_in(&place);
    command.args(["--cycles", "1", "--report"]);
    command.arg(place.path("missing/report.json"));
    let (code, log) = ended(command);
    assert_eq!(code, 73, "{log}");
    assert!(log.contains("missing/report.json: cannot write"), "{log}");
}

#[test]
fn the_preflight_names_what_is_lacking_and_how_to_give_it() {
    let mut command = vpcd();
    command.args(["--preflight", "--json"]);
    let Some(mut command) = without_rights(&command) else {
        return not_run(
            "less rights",
            "setpriv and prlimit cannot take capabilities away",
        );
    };
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["fit"], false);
    let checks = found["checks"].as_array().unwrap();
    for (name, remedy) in [
        ("real-time priority", "LimitRTPRIO=80"),
        ("locked memory", "LimitMEMLOCK=infinity"),
    ] {
        let check = checks.iter().find(|check| check["name"] == name).unwrap();
        assert_eq!(check["state"], "lack", "{check}");
        assert!(
            check["remedy"].as_str().unwrap().contains(remedy),
            "{check}"
        );
    }
    // As a table for people: the same lacks, each with its remedy below, and how to measure.
    let mut command = vpcd();
    command.arg("--preflight");
    let output = without_rights(&command).unwrap().output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.matches("LACK").count() >= 2 && text.contains("-> LimitRTPRIO=80"),
        "{text}"
    );
    assert!(text.contains("NOT FIT for real time"), "{text}");
    assert!(text.contains("cargo xtask measure"), "{text}");
}
