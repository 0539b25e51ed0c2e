//! What the daemon says to a service manager, heard at a socket of our own.

use std::io::ErrorKind;
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

use rustix::process::Signal;

use crate::fixture::{
    Frozen, Manager, Place, count, ended, not_run, scene_file, sleeps, spin, thread, vpcd,
};

/// 15 periods of the loop.
const WATCHDOG: Duration = Duration::from_millis(500);
/// One period of the loop.
const PERIOD: Duration = Duration::from_nanos(33_333_333);
/// Trials of one hang: a machine that stands still delays the last feed of a daemon that did not
/// hang yet.
const TRIALS: u32 = 3;
/// Phases of the cycle at which it hangs.
const PHASES: u32 = 2;

/// Cycles that a status line counts.
fn cycles(status: &str) -> u64 {
    let (before, _) = status.split_once(" cycles").unwrap();
    let (_, number) = before.rsplit_once(' ').unwrap();
    number.parse().unwrap()
}

#[test]
fn ready_comes_once_and_only_after_the_loop_has_made_a_cycle() {
    let place = Place::new();
    // Half a second to the first release of the grid.
    let text = std::fs::read_to_string(scene_file()).unwrap();
    let slow = text.replace("rate_hz = 30.0", "rate_hz = 2.0");
    assert_ne!(slow, text);
    let scene = place.file("slow.toml", slow);
    let manager = Manager::new(&place);
    let mut command = vpcd();
    command
        .arg("--scene")
        .arg(scene)
        .arg("--domain")
        .arg(place.domain());
    let daemon = manager.manage(command, None);
    let first = manager.next();
    assert_eq!(
        first,
        "STATUS=starting; 0 cycles, 0 held, 0 overruns, 0 records lost\n"
    );
    let mut messages = manager.until("READY=1");
    messages.extend(manager.until("STATUS=disarmed"));
    messages.extend(manager.until("STATUS=disarmed"));
    assert_eq!(count(&messages, "READY=1"), 1, "{messages:?}");
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
}

#[test]
fn the_status_tells_state_counters_and_the_end() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), None);
    manager.until("READY=1");
    let statuses: Vec<_> = (0..3)
        .map(|_| manager.until("STATUS=").pop().unwrap())
        .collect();
    for status in &statuses {
        assert!(status.starts_with("STATUS=holding: no robot; "), "{status}");
        assert!(
            status.ends_with(" held, 0 overruns, 0 records lost\n")
                || !status.contains(" 0 overruns"),
            "{status}"
        );
    }
    assert!(
        cycles(&statuses[0]) < cycles(&statuses[1]) && cycles(&statuses[1]) < cycles(&statuses[2])
    );
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let last = manager.drain();
    assert_eq!(count(&last, "STOPPING=1"), 1, "{last:?}");
    assert_eq!(count(&last, "READY=1"), 0, "{last:?}");
}

#[test]
fn a_run_that_ends_by_itself_is_announced_as_well() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let mut command = place.vpcd();
    command.args(["--cycles", "5"]);
    let (code, log) = manager.manage(command, None).ended().log();
    assert_eq!(code, 0, "{log}");
    let messages = manager.drain();
    assert_eq!(count(&messages, "READY=1"), 1, "{messages:?}");
    assert_eq!(count(&messages, "STOPPING=1"), 1, "{messages:?}");
}

#[test]
fn in_lockstep_a_waiting_loop_is_ready_and_alive() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let mut command = place.vpcd();
    command.args(["--clock", "lockstep"]);
    let _daemon = manager.manage(command, Some(WATCHDOG));
    manager.until("READY=1");
    manager.until("WATCHDOG=1");
}

#[test]
fn the_watchdog_is_fed_more_than_twice_in_each_interval() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let _daemon = manager.manage(place.vpcd(), Some(WATCHDOG));
    manager.until("READY=1");
    manager.until("STATUS=");
    // Two status lines later two seconds are over, which are four intervals.
    let mut messages = manager.until("STATUS=");
    messages.extend(manager.until("STATUS="));
    let fed = count(&messages, "WATCHDOG=1");
    assert!((8..=17).contains(&fed), "{messages:?}");
}

#[test]
fn without_a_watchdog_nothing_is_fed() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let _daemon = manager.manage(place.vpcd(), None);
    let mut messages = manager.until("READY=1");
    messages.extend(manager.until("STATUS=holding"));
    assert_eq!(count(&messages, "WATCHDOG=1"), 0, "{messages:?}");
}

#[test]
fn a_loop_that_hangs_is_not_fed_and_the_status_says_so() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), Some(WATCHDOG));
    manager.until("READY=1");
    manager.until("WATCHDOG=1");
    let frozen = Frozen::freeze(thread(daemon.id(), "vpcd"));
    manager.drain();
    // The ordinary thread goes on talking, for two intervals and more; it may have had one feed
    // left to send.
    let mut messages = manager.until("STATUS=LOOP STANDS STILL");
    messages.extend(manager.until("STATUS=LOOP STANDS STILL"));
    let fed = count(&messages, "WATCHDOG=1");
    assert!(
        fed == 0 || (fed == 1 && messages[0].contains("WATCHDOG=1")),
        "{messages:?}"
    );
    drop(frozen);
    manager.until("WATCHDOG=1");
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    assert!(
        log.contains("the loop stands still") && log.contains("the loop moves again"),
        "{log}"
    );
}

#[test]
fn an_ordinary_thread_that_hangs_does_not_feed() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), Some(WATCHDOG));
    manager.until("READY=1");
    manager.until("WATCHDOG=1");
    let (looping, recorder) = (thread(daemon.id(), "vpcd"), thread(daemon.id(), "recorder"));
    let frozen = Frozen::freeze(recorder);
    manager.drain();
    let before = sleeps(daemon.id(), looping);
    assert_eq!(manager.within(3 * WATCHDOG), None);
    let after = sleeps(daemon.id(), looping);
    assert!(
        after > before + 10,
        "the loop stood as well: {before}, {after}"
    );
    drop(frozen);
    manager.until("WATCHDOG=1");
}

#[test]
fn a_stopped_process_does_not_feed() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), Some(WATCHDOG));
    manager.until("READY=1");
    manager.until("WATCHDOG=1");
    daemon.signal(Signal::STOP);
    std::thread::sleep(WATCHDOG / 4);
    manager.drain();
    assert_eq!(manager.within(2 * WATCHDOG), None);
    daemon.signal(Signal::CONT);
    manager.until("WATCHDOG=1");
}

/// How long it is listened to: the stillness is told once a second, when it is half a second old.
const HEARD: Duration = Duration::from_millis(2000);

/// What the daemon is put into.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Hang {
    /// The loop's thread stands still.
    Still,
    /// The loop's thread is in an endless loop.
    Endless,
    /// SIGSTOP.
    Stopped,
}

/// How long after the hang began the last feed was heard; zero if none was.
fn last_feed(hang: Hang, phase: u32) -> Duration {
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), Some(WATCHDOG));
    manager.until("READY=1");
    manager.until("WATCHDOG=1");
    // Shortly before the next feed.
    std::thread::sleep(WATCHDOG / 4 - PERIOD * phase / PHASES);
    let looping = thread(daemon.id(), "vpcd");
    manager.drain();
    let _frozen = match hang {
        Hang::Still => Some(Frozen::freeze(looping)),
        Hang::Endless => {
            if !spin(looping) {
                not_run("an endless loop", "unknown processor");
                return Duration::ZERO;
            }
            None
        }
        Hang::Stopped => {
            daemon.signal(Signal::STOP);
            None
        }
    };
    let begun = Instant::now();
    let (mut last, mut told) = (Duration::ZERO, 0);
    while begun.elapsed() < HEARD {
        if let Some(message) = manager.within(WATCHDOG / 8) {
            let at = begun.elapsed();
            if message.lines().any(|line| line == "WATCHDOG=1") {
                last = at;
            }
            told += usize::from(message.contains("STATUS=LOOP STANDS STILL"));
        }
    }
    // Silence is not for want of somebody to talk.
    assert_eq!(told > 0, hang != Hang::Stopped, "{hang:?}");
    last
}

/// At several phases of the cycle: two periods of the loop after it hangs nothing vouches for it
/// any more.
fn stops_in_two_periods(hang: Hang) {
    for phase in 0..PHASES {
        let mut trials = (0..TRIALS).map(|_| last_feed(hang, phase));
        assert!(
            trials.any(|last| last <= 2 * PERIOD),
            "{hang:?}, phase {phase}: fed for more than {:?} in each of {TRIALS} trials",
            2 * PERIOD
        );
    }
}

#[test]
fn two_periods_after_a_standstill_nothing_is_fed() {
    stops_in_two_periods(Hang::Still);
}

#[test]
fn two_periods_into_an_endless_loop_nothing_is_fed() {
    stops_in_two_periods(Hang::Endless);
}

#[test]
fn two_periods_after_sigstop_nothing_is_fed() {
    stops_in_two_periods(Hang::Stopped);
}

#[test]
fn the_watchdog_of_another_process_is_not_ours_to_feed() {
    let place = Place::new();
    let manager = Manager::new(&place);
    let mut command = place.vpcd();
    command.env("WATCHDOG_PID", "1");
    let _daemon = manager.manage(command, Some(WATCHDOG));
    let mut messages = manager.until("READY=1");
    messages.extend(manager.until("STATUS=holding"));
    assert_eq!(count(&messages, "WATCHDOG=1"), 0, "{messages:?}");
}

#[test]
fn a_manager_that_does_not_listen_delays_nothing() {
    let place = Place::new();
    let manager = Manager::new(&place);
    // Fill its queue, until it takes nothing from a newcomer; each sender has a limit of its own.
    loop {
        let talker = UnixDatagram::unbound().unwrap();
        talker.set_nonblocking(true).unwrap();
        let mut sent = 0;
        let full = loop {
            match talker.send_to(b"X=1", place.path("notify")) {
                Ok(_) => sent += 1,
                Err(error) => break error,
            }
        };
        assert_eq!(full.kind(), ErrorKind::WouldBlock);
        if sent == 0 {
            break;
        }
    }
    let daemon = manager.manage(place.vpcd(), Some(WATCHDOG));
    let looping = thread(daemon.id(), "vpcd");
    let recorder = thread(daemon.id(), "recorder");
    // Both sleep a lot while they start.
    std::thread::sleep(2 * WATCHDOG);
    let before = (sleeps(daemon.id(), looping), sleeps(daemon.id(), recorder));
    std::thread::sleep(2 * WATCHDOG);
    assert!(sleeps(daemon.id(), looping) > before.0 + 10);
    assert!(sleeps(daemon.id(), recorder) > before.1 + 10);
    manager.until("READY=1");
}

#[test]
fn a_manager_that_is_not_there_is_a_warning() {
    let place = Place::new();
    let mut command = place.vpcd();
    command
        .args(["--cycles", "10"])
        .env("NOTIFY_SOCKET", place.path("nobody"));
    let (code, log) = ended(command);
    assert_eq!(code, 0, "{log}");
    assert_eq!(
        log.matches("does not listen at NOTIFY_SOCKET").count(),
        1,
        "{log}"
    );
}

#[test]
fn without_a_manager_nobody_is_told() {
    let place = Place::new();
    let mut command = place.vpcd();
    command
        .args(["--cycles", "10"])
        .env("WATCHDOG_USEC", "500000");
    let (code, log) = ended(command);
    assert_eq!(code, 0, "{log}");
    assert!(!log.contains("NOTIFY_SOCKET"), "{log}");
}

#[test]
fn a_malformed_environment_is_78_and_named() {
    let place = Place::new();
    for (name, value, words) in [
        (
            "NOTIFY_SOCKET",
            "somewhere",
            "NOTIFY_SOCKET = somewhere; allowed: an absolute path",
        ),
        (
            "WATCHDOG_USEC",
            "2s",
            "WATCHDOG_USEC = 2s; allowed: a whole number from 1 on",
        ),
        (
            "WATCHDOG_USEC",
            "1000",
            "WATCHDOG_USEC = 1000; allowed: 133333",
        ),
        (
            "WATCHDOG_PID",
            "-1",
            "WATCHDOG_PID = -1; allowed: a whole number from 1 on",
        ),
    ] {
        let mut command = place.vpcd();
        command.args(["--cycles", "1"]);
        command
            .env("NOTIFY_SOCKET", "@vpcd-test-nobody")
            .env(name, value);
        let (code, message) = ended(command);
        assert_eq!(code, 78, "{message}");
        assert!(message.contains(words), "{message}\nlacks {words}");
    }
}

#[test]
fn a_failure_is_left_behind_as_the_status() {
    let place = Place::new();
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
