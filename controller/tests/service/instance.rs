//! One daemon a domain, and the second one is told who the first is.

use rustix::process::Signal;

use crate::fixture::{Manager, Place, ended};

#[test]
fn a_second_daemon_is_69_and_names_the_first_which_goes_on() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let first = manager.manage(place.vpcd(), None);
    manager.until("READY=1");
    let domain = place.domain().canonicalize().unwrap();
    let words = format!(
        "domain {}: another vpcd is at work, process {};",
        domain.display(),
        first.id()
    );
    let (code, message) = ended(place.vpcd());
    assert_eq!(code, 69, "{message}");
    assert!(message.contains(&words), "{message}\nlacks {words}");
    // Also one that is stopped.
    first.signal(Signal::STOP);
    let (code, message) = ended(place.vpcd());
    assert_eq!(code, 69, "{message}");
    assert!(message.contains(&words), "{message}\nlacks {words}");
    first.signal(Signal::CONT);
    manager.drain();
    manager.until("STATUS=holding");
    let (code, log) = first.terminated().log();
    assert_eq!(code, 0, "{log}");
}

#[test]
fn after_a_kill_the_domain_is_free() {
    let place = Place::new();
    for _ in 0..3 {
        let manager = Manager::new(&place);
        let daemon = manager.manage(place.vpcd(), None);
        manager.until("READY=1");
        daemon.signal(Signal::KILL);
        let (code, _) = daemon.ended().log();
        assert_eq!(code, -1);
        std::fs::remove_file(place.path("notify")).unwrap();
    }
}
