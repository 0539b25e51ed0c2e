//! What the daemon says to a service manager, heard at a socket of our own. When it says what,
//! `controller/src/service/tests.rs` tests with a clock that is moved by hand.

use std::time::Duration;

use crate::fixture::{Manager, Place, ended};

/// How many messages hold a line.
fn count(messages: &[String], line: &str) -> usize {
    let lines = messages.iter().flat_map(|message| message.lines());
    lines.filter(|found| *found == line).count()
}

/// In lockstep its loop waits for a camera, and is alive all the same.
#[test]
fn a_manager_is_told_of_readiness_life_and_end() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let mut command = place.vpcd();
    command.args(["--clock", "lockstep"]);
    let daemon = manager.manage(command, Some(Duration::from_millis(500)));
    let first = manager.next();
    assert!(first.starts_with("READY=1\n") || first.starts_with("STATUS=starting; 0 cycles"));
    let mut said = vec![first];
    said.extend(manager.until("WATCHDOG=1"));
    said.extend(manager.until("STATUS="));
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let end = manager.drain();
    assert_eq!(count(&end, "STOPPING=1"), 1, "{end:?}");
    said.extend(end);
    assert_eq!(count(&said, "READY=1"), 1, "{said:?}");
    // Its log says the same where no manager listens.
    let mut command = place.vpcd();
    command.args(["--cycles", "3"]);
    command.env("NOTIFY_SOCKET", place.path("nobody"));
    let (code, log) = ended(command);
    assert_eq!(code, 0, "{log}");
    let words = "does not listen at NOTIFY_SOCKET";
    assert_eq!(log.matches(words).count(), 1, "{log}");
}

#[test]
fn a_wrong_environment_is_78_and_a_failure_is_left_behind_as_the_status() {
    let place = Place::new();
    let mut command = place.vpcd();
    command.env("NOTIFY_SOCKET", "@vpcd-test-nobody");
    command.env("WATCHDOG_USEC", "1000");
    let (code, message) = ended(command);
    assert_eq!(code, 78, "{message}");
    assert!(
        message.contains("WATCHDOG_USEC = 1000; allowed: 133333"),
        "{message}"
    );

    let manager = Manager::new(&place);
    let config = place.file("v.toml", "scene = 's.toml'\n[law]\nnpp = 3\n");
    let mut command = place.vpcd();
    command.arg("--config").arg(config);
    let (code, message) = manager.manage(command, None).ended().log();
    assert_eq!(code, 78, "{message}");
    let said = manager.drain();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(
        said[0].starts_with("STATUS=") && said[0].contains("unknown field `npp`"),
        "{said:?}"
    );
    assert_eq!(said[0].lines().count(), 1, "{said:?}");
}
