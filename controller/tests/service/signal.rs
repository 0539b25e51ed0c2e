//! A second request to stop does no harm.

use rustix::process::Signal;

use crate::fixture::{Manager, Place, eventually};
use crate::frozen::{Frozen, thread};

/// Whether a signal to the process waits to be taken.
fn is_pending(pid: u32) -> bool {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = text
        .lines()
        .find(|line| line.starts_with("ShdPnd:"))
        .unwrap();
    line.trim_start_matches("ShdPnd:")
        .trim()
        .chars()
        .any(|digit| digit != '0')
}

#[test]
fn further_requests_to_stop_do_not_cut_the_stop_short() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), None);
    manager.until("READY=1");
    // The loop stands, so that the stop takes as long as we please.
    let frozen = Frozen::freeze(thread(daemon.id(), "vpcd"));
    daemon.signal(Signal::TERM);
    manager.until("STOPPING=1");
    for signal in [Signal::TERM, Signal::INT, Signal::TERM] {
        daemon.signal(signal);
        eventually("the signal is taken", || {
            (!is_pending(daemon.id())).then_some(())
        });
    }
    drop(frozen);
    let (code, log) = daemon.ended().log();
    assert_eq!(code, 0, "{log}");
    assert!(log.contains("stopped"), "{log}");
}
