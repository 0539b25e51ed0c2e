//! Notifications with a clock that is moved by hand, heard at a socket of our own.

use std::path::PathBuf;

use super::*;

const PERIOD: Duration = Duration::from_millis(33);

fn parse(variables: &[(&str, &str)]) -> Result<Service, ServiceError> {
    let variable = |name: &str| {
        let found = variables.iter().find(|(key, _)| *key == name)?;
        Some(OsString::from(found.1))
    };
    Service::parse(variable, 7, PERIOD)
}

#[test]
fn without_a_manager_notifications_do_nothing() {
    let service = parse(&[("WATCHDOG_USEC", "1000000")]).unwrap();
    assert!(service.line.is_none() && service.watchdog.is_none());
}

#[test]
fn the_watchdog_of_another_process_is_not_fed() {
    let of = |pid| {
        let base = [("NOTIFY_SOCKET", "@vpc"), ("WATCHDOG_USEC", "2000000")];
        let service = parse(&[base[0], base[1], ("WATCHDOG_PID", pid)]).unwrap();
        service.watchdog
    };
    assert_eq!(of("7"), Some(Duration::from_secs(2)));
    assert_eq!(of("8"), None);
}

#[test]
fn a_malformed_variable_is_named_with_what_is_allowed() {
    let socket = ("NOTIFY_SOCKET", "/run/notify");
    let long = format!("/{}", "x".repeat(200));
    for (variables, words) in [
        (
            vec![("NOTIFY_SOCKET", "run/notify")],
            "NOTIFY_SOCKET = run/notify; allowed: an absolute",
        ),
        (
            vec![("NOTIFY_SOCKET", "")],
            "NOTIFY_SOCKET = ; allowed: an absolute",
        ),
        (
            vec![("NOTIFY_SOCKET", "vsock:2:1")],
            "NOTIFY_SOCKET = vsock:2:1; allowed",
        ),
        (vec![("NOTIFY_SOCKET", &*long)], "at most 107 bytes"),
        (
            vec![socket, ("WATCHDOG_USEC", "2s")],
            "WATCHDOG_USEC = 2s; allowed: a whole number",
        ),
        (
            vec![socket, ("WATCHDOG_USEC", "0")],
            "WATCHDOG_USEC = 0; allowed",
        ),
        (
            vec![socket, ("WATCHDOG_USEC", "-5")],
            "WATCHDOG_USEC = -5; allowed",
        ),
        (
            vec![("WATCHDOG_PID", "me")],
            "WATCHDOG_PID = me; allowed: a whole number",
        ),
        (
            vec![socket, ("WATCHDOG_USEC", "131999")],
            "WATCHDOG_USEC = 131999; allowed: 132000 on",
        ),
    ] {
        let message = parse(&variables).unwrap_err().to_string();
        assert!(message.contains(words), "{message}\nlacks {words}");
    }
}

#[test]
fn ready_is_said_once_and_not_before_the_loop_has_moved() {
    let start = Instant::now();
    let mut schedule = Schedule::new(None, start);
    assert!(!schedule.look(start, 0, false).ready);
    let due = schedule.look(start + PERIOD, 1, false);
    assert!(due.ready && !due.watchdog);
    schedule.done(start + PERIOD, due);
    assert!(!schedule.look(start + 2 * PERIOD, 2, false).ready);
}

#[test]
fn what_did_not_reach_the_manager_is_said_again() {
    let start = Instant::now();
    let mut schedule = Schedule::new(None, start);
    assert!(schedule.look(start, 1, true).ready);
    let due = schedule.look(start + PERIOD, 2, true);
    assert!(due.ready && due.stopping && due.status);
}

#[test]
fn a_loop_that_stands_still_is_never_fed_for() {
    let start = Instant::now();
    let interval = Duration::from_secs(2);
    let mut schedule = Schedule::new(Some(interval), start);
    let mut fed = Vec::new();
    let mut now = start;
    // Looks every 5 ms; the loop counts to 60, one each 33 ms, and hangs at 1.98 s.
    for look in 0..2000_u32 {
        now = start + look * Duration::from_millis(5);
        let due = schedule.look(now, u64::from(look * 5 / 33).min(60), false);
        if due.watchdog {
            fed.push(now - start);
        }
        schedule.done(now, due);
    }
    let hang = 60 * PERIOD;
    assert!(
        fed.iter().all(|at| *at <= hang + Duration::from_millis(5)),
        "{fed:?}"
    );
    let widest = fed.windows(2).map(|pair| pair[1] - pair[0]).max();
    assert!(fed.len() == 4 && widest <= Some(interval / 2), "{fed:?}");
    assert_eq!(
        schedule.standstill(now, STILL).map(|still| still.as_secs()),
        Some(8)
    );
}

#[test]
fn a_status_is_one_line() {
    assert_eq!(
        one_line("v.toml:\n  | np = x\nWATCHDOG=1"),
        "v.toml: | np = x WATCHDOG=1"
    );
}

/// Time between two looks of the ordinary thread.
const LOOK: Duration = Duration::from_millis(5);
/// 15 periods of the loop.
const WATCHDOG: Duration = Duration::from_millis(500);

/// A notifier whose clock is moved by hand, its loop, and the service manager that it talks to.
struct Talk {
    notifier: Notifier,
    manager: UnixDatagram,
    progress: Progress,
    stop: Stop,
    again: Again,
    now: Instant,
    /// The next cycle of the loop.
    next: Instant,
    socket: PathBuf,
    _place: tempfile::TempDir,
}

impl Talk {
    fn begin(watchdog: Option<Duration>) -> Self {
        let place = tempfile::tempdir().unwrap();
        let socket = place.path().join("notify");
        let manager = listen(&socket);
        let service = Service {
            line: Some(Socket::to(&socket.clone().into_os_string()).unwrap()),
            watchdog,
        };
        let (progress, stop, again) = (Progress::default(), Stop::default(), Again::default());
        let begin = Instant::now();
        Self {
            notifier: Notifier::new(
                service,
                PERIOD,
                progress.clone(),
                stop.clone(),
                again.clone(),
                begin,
            ),
            manager,
            progress,
            stop,
            again,
            now: begin,
            next: begin + PERIOD,
            socket,
            _place: place,
        }
    }

    /// One look; the lines that are heard.
    fn look(&mut self) -> Vec<String> {
        let status = || format!("moving; {} cycles", self.progress.count());
        self.notifier.tend(self.now, status);
        self.heard()
    }

    fn heard(&self) -> Vec<String> {
        let mut buffer = [0; 4096];
        let mut lines = Vec::new();
        while let Ok(length) = self.manager.recv(&mut buffer) {
            let text = std::str::from_utf8(&buffer[..length]).unwrap();
            lines.extend(text.lines().map(str::to_owned));
        }
        lines
    }

    /// Looks for so long at a loop that works, or that hangs: lines with the time at which each
    /// was heard, since this began.
    fn watch(&mut self, time: Duration, works: bool) -> Vec<(Duration, String)> {
        let since = self.now;
        let mut heard = Vec::new();
        while self.now < since + time {
            self.now += LOOK;
            while works && self.next <= self.now {
                self.progress.advance();
                self.next += PERIOD;
            }
            let at = self.now - since;
            heard.extend(self.look().into_iter().map(|line| (at, line)));
        }
        self.next = self.next.max(self.now);
        heard
    }
}

/// The manager's end, which never waits.
fn listen(socket: &Path) -> UnixDatagram {
    let manager = UnixDatagram::bind(socket).unwrap();
    manager.set_nonblocking(true).unwrap();
    manager
}

/// When lines that begin like this were heard.
fn at(heard: &[(Duration, String)], words: &str) -> Vec<Duration> {
    let found = heard.iter().filter(|(_, line)| line.starts_with(words));
    found.map(|(at, _)| *at).collect()
}

#[test]
fn readiness_is_told_once_and_the_status_once_a_second() {
    let mut talk = Talk::begin(None);
    assert_eq!(talk.look(), ["STATUS=moving; 0 cycles"]);
    let heard = talk.watch(Duration::from_secs(5), true);
    // 33 ms, by looks 5 ms apart.
    assert_eq!(at(&heard, "READY=1"), [Duration::from_millis(35)]);
    let told = at(&heard, "STATUS=moving; ");
    assert_eq!(told, [1, 2, 3, 4, 5].map(Duration::from_secs));
    // Nobody asked for a watchdog.
    assert_eq!(at(&heard, "WATCHDOG=1"), []);
}

#[test]
fn the_watchdog_is_fed_more_than_twice_in_each_interval() {
    let mut talk = Talk::begin(Some(WATCHDOG));
    let mut fed = at(&talk.watch(Duration::from_secs(60), true), "WATCHDOG=1");
    fed.insert(0, Duration::ZERO);
    assert!(fed.len() > 60 * 4 && fed.len() <= 60 * 8, "{}", fed.len());
    let mut pairs = fed.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(pairs.all(|apart| 2 * apart < WATCHDOG), "{fed:?}");
}

/// At every phase of the cycle and of the feed.
#[test]
fn a_loop_that_hangs_is_not_fed_for_and_the_status_says_so() {
    for phase in 0..125 {
        let mut talk = Talk::begin(Some(WATCHDOG));
        talk.watch(
            Duration::from_secs(1) + phase * Duration::from_millis(2),
            true,
        );
        let heard = talk.watch(Duration::from_secs(3), false);
        let fed = at(&heard, "WATCHDOG=1");
        assert!(fed.iter().all(|at| *at <= LOOK), "phase {phase}: {fed:?}");
        // For half a second it may still be waiting.
        let told = at(&heard, "STATUS=");
        let still = at(&heard, "STATUS=LOOP STANDS STILL for ");
        assert_eq!((told.len(), still.len() >= 2), (3, true), "{heard:?}");
        assert!(still[0] >= STILL, "{heard:?}");
        assert!(talk.notifier.is_still);
        // It moves again.
        let heard = talk.watch(WATCHDOG, true);
        assert!(!at(&heard, "WATCHDOG=1").is_empty() && !talk.notifier.is_still);
    }
}

#[test]
fn the_end_is_told_once_with_the_last_status() {
    let mut talk = Talk::begin(None);
    talk.watch(Duration::from_millis(100), true);
    talk.stop.ask();
    let heard = talk.watch(Duration::from_millis(500), true);
    assert_eq!(at(&heard, "STOPPING=1"), [LOOK]);
    assert_eq!(at(&heard, "READY=1"), []);
    // The last status is told though the second is not over.
    talk.notifier.end(talk.now, || "stopped".to_owned());
    assert_eq!(talk.heard(), ["STATUS=stopped"]);
}

#[test]
fn who_ends_without_being_asked_says_so_too() {
    let mut talk = Talk::begin(None);
    talk.watch(Duration::from_millis(100), true);
    talk.notifier.end(talk.now, || "stopped".to_owned());
    assert_eq!(talk.heard(), ["STOPPING=1", "STATUS=stopped"]);
}

#[test]
fn who_begins_again_is_reloading_and_not_stopping() {
    let mut talk = Talk::begin(None);
    talk.again.ask(tempfile::tempfile().unwrap());
    talk.stop.ask();
    let heard = talk.watch(Duration::from_millis(100), true);
    assert_eq!(at(&heard, "RELOADING=1"), [LOOK]);
    assert_eq!(at(&heard, "MONOTONIC_USEC="), [LOOK]);
    assert_eq!(at(&heard, "STOPPING=1"), []);
}

#[test]
fn a_manager_that_does_not_read_delays_nothing_and_is_told_later() {
    let mut talk = Talk::begin(Some(WATCHDOG));
    // Until its queue takes nothing from a newcomer; each sender has a limit of its own.
    loop {
        let talker = UnixDatagram::unbound().unwrap();
        talker.set_nonblocking(true).unwrap();
        let sent = (0..).find(|_| talker.send_to(b"X=1", &talk.socket).is_err());
        if sent == Some(0) {
            break;
        }
    }
    talk.progress.advance();
    // Returns, though nobody takes what it says.
    talk.notifier.tend(talk.now, String::new);
    let waits = talk.heard();
    assert!(waits.iter().all(|line| line == "X=1"), "{waits:?}");
    // Nothing of it was taken for said.
    let heard = talk.watch(2 * PERIOD, true);
    assert_eq!(at(&heard, "READY=1").len(), 1, "{heard:?}");
    assert_eq!(at(&heard, "WATCHDOG=1").len(), 1, "{heard:?}");
}

#[test]
fn a_manager_that_comes_again_under_the_same_name_is_told() {
    let mut talk = Talk::begin(None);
    std::fs::remove_file(&talk.socket).unwrap();
    talk.progress.advance();
    assert_eq!(talk.look(), [""; 0]);
    // Once, and not again with each look.
    assert!(talk.notifier.is_cut);
    talk.manager = listen(&talk.socket);
    talk.progress.advance();
    assert_eq!(talk.look(), ["READY=1", "STATUS=moving; 2 cycles"]);
    assert!(!talk.notifier.is_cut);
}
