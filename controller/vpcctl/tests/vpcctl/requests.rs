//! `arm`, `disarm`, `stop`, `strategy`, `flight`.

use std::os::unix::fs::DirBuilderExt;
use std::path::Path;

use ipc::{Domain, Observer};
use messages::CycleRecord;
use testkit::Place;

use vpcctl::status::Status;
use vpcctl::watcher::Watcher;

use crate::stand_in::{Manner, StandIn};
use crate::{stderr, stdout, vpcctl};

#[test]
fn requests_are_answered_with_their_outcome() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let ask = |words: &[&str]| {
        // It waits for the answer alone.
        let words = [words, &["--timeout", "20"]].concat();
        let output = vpcctl(directory.path(), &words);
        (stdout(&output), output.status.code())
    };
    assert_eq!(
        ask(&["arm"]),
        ("arm: done; moving, strategy previous\n".into(), Some(0))
    );
    assert_eq!(
        ask(&["strategy", "knn5"]),
        ("strategy: done; moving, strategy knn5\n".into(), Some(0))
    );
    assert_eq!(
        ask(&["flight"]),
        ("flight: done; moving, strategy knn5\n".into(), Some(0))
    );
    assert_eq!(
        ask(&["disarm"]),
        (
            "disarm: done; disarmed (operator), strategy knn5\n".into(),
            Some(0)
        )
    );
}

#[test]
fn a_refusal_has_an_exit_code_of_its_own() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let output = vpcctl(directory.path(), &["strategy", "gpr", "--timeout", "20"]);
    assert_eq!(output.status.code(), Some(2));
    let line = stdout(&output);
    assert!(
        line.starts_with("strategy: refused: no memory of motion"),
        "{line}"
    );
}

#[test]
fn stop_needs_no_observers_place() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let domain = Domain::join(directory.path()).unwrap();
    let mut observers = Vec::new();
    while let Ok(observer) = Observer::open(&domain) {
        observers.push(observer);
    }
    assert!(observers.len() > 1);
    let mut recorders = Vec::new();
    while let Ok(recorder) = domain.subscriber::<CycleRecord>(1) {
        recorders.push(recorder);
    }
    // Status says what it does without.
    let watcher = Watcher::open(directory.path()).unwrap();
    let text = Status::new(&watcher).text(false);
    assert!(
        text.contains("vpc/cycles: all subscribers' slots are taken"),
        "{text}"
    );
    let output = vpcctl(directory.path(), &["stop", "--timeout", "20"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let line = stdout(&output);
    assert!(
        line.starts_with("stop: done after ") && line.ends_with(" ms; disarmed\n"),
        "{line}"
    );
}

#[test]
fn a_stop_that_cannot_be_told_is_done_all_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let mut shell = testkit::command("sh");
    shell.args([
        "-c",
        "exec \"$@\" >/dev/full",
        "sh",
        env!("CARGO_BIN_EXE_vpcctl"),
    ]);
    shell.arg("--domain").arg(directory.path());
    let output = shell.args(["stop", "--timeout", "20"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("stop: done"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_daemon_that_does_not_answer_is_told_from_none() {
    let directory = tempfile::tempdir().unwrap();
    let ask = || vpcctl(directory.path(), &["stop", "--timeout", "0.1"]);
    let nobody = ask();
    assert_eq!(nobody.status.code(), Some(3), "{}", stderr(&nobody));
    let manner = Manner {
        answers: false,
        cycles: true,
    };
    let _daemon = StandIn::start(directory.path(), manner);
    let deaf = ask();
    assert_eq!(deaf.status.code(), Some(4), "{}", stderr(&deaf));
    let process = format!("process {} did not answer", std::process::id());
    assert!(stderr(&deaf).contains(&process), "{}", stderr(&deaf));
}

#[test]
fn without_its_file_a_stop_is_what_the_daemon_says() {
    let directory = tempfile::tempdir().unwrap();
    let daemon = StandIn::sound(directory.path());
    std::fs::remove_file(directory.path().join(ipc::STOP_FILE)).unwrap();
    let ask = || vpcctl(directory.path(), &["stop", "--timeout", "0.2"]);
    let output = ask();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let process = std::process::id();
    let words = format!("stop: done, by a request; disarmed, says process {process}. ");
    assert!(stdout(&output).starts_with(&words), "{}", stdout(&output));
    drop(daemon);
    // One that says nothing has not stopped, for all that is known.
    let manner = Manner {
        answers: false,
        cycles: true,
    };
    let _daemon = StandIn::start(directory.path(), manner);
    std::fs::remove_file(directory.path().join(ipc::STOP_FILE)).unwrap();
    let output = ask();
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    for words in [
        "NOT known to have stopped",
        "cannot stop by it",
        "kill -TERM",
    ] {
        assert!(stderr(&output).contains(words), "{}", stderr(&output));
    }
}

#[test]
fn stop_reaches_a_daemon_that_starts_while_it_waits() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_owned();
    let stop = std::thread::spawn(move || vpcctl(&path, &["stop", "--timeout", "20"]));
    std::thread::sleep(std::time::Duration::from_millis(100));
    let _daemon = StandIn::sound(directory.path());
    let output = stop.join().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn nothing_is_created_where_no_domain_is() {
    let directory = tempfile::tempdir().unwrap();
    let missing = directory.path().join("missing");
    for words in [["status"].as_slice(), &["stop"], &["arm"]] {
        let output = vpcctl(&missing, words);
        assert_eq!(output.status.code(), Some(3), "{words:?}");
        assert!(stderr(&output).contains("no vpcd is at work"));
    }
    assert!(!missing.exists());
}

/// Root plays the owner, or is one: the domain of any other user who is no root is its own.
#[test]
fn the_domain_of_another_user_is_not_called_empty() {
    let place = Place::for_all_users();
    let domain = place.domain();
    std::fs::DirBuilder::new()
        .mode(0o700)
        .create(&domain)
        .unwrap();
    let _daemon = StandIn::sound(&domain);
    let is_root = rustix::process::geteuid().is_root();
    let program = place.path("vpcctl");
    // By another process: a child that a test forks meanwhile would hold a file that is written.
    let mut copy = testkit::command("cp");
    let copied = copy
        .arg(env!("CARGO_BIN_EXE_vpcctl"))
        .arg(&program)
        .status();
    assert!(copied.unwrap().success());
    for (directory, owner) in [
        (&*domain, "user 0"),
        (&domain.join("below"), "another user"),
    ] {
        for words in ["stop", "status", "arm", "disarm"] {
            let mut command = match is_root {
                true => testkit::command("setpriv"),
                false => testkit::command(&program),
            };
            if is_root {
                let nobody = ["--reuid=65534", "--regid=65534", "--clear-groups"];
                command.args(nobody).arg(&program);
            }
            command.arg("--domain").arg(if is_root {
                directory
            } else {
                Path::new("/root")
            });
            let output = command.arg(words).output().unwrap();
            assert_eq!(
                output.status.code(),
                Some(77),
                "{words}: {}",
                stderr(&output)
            );
            let said = stderr(&output);
            let words = format!(
                "that of {}; NOTHING WAS DONE",
                if is_root { owner } else { "user 0" }
            );
            assert!(said.contains(&words), "{said}");
        }
    }
}

#[test]
fn a_wrong_command_line_has_vpcds_exit_code() {
    let directory = tempfile::tempdir().unwrap();
    for words in [["dance"].as_slice(), &["strategy", "gpr3"]] {
        let output = vpcctl(directory.path(), words);
        assert_eq!(output.status.code(), Some(64), "{words:?}");
        assert!(!stderr(&output).is_empty());
    }
}
