//! Notifications to the service manager: readiness, status and watchdog, after `sd_notify(3)`.
//!
//! The ordinary thread sends them; the loop only counts its cycles in [`Progress`]. The ordinary
//! thread sends a watchdog message only if the loop has moved since it last looked. So the messages
//! stop at once when either thread hangs, and the loop pays one atomic addition for them.

use std::ffi::OsString;
use std::fmt::Display;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tracing::{error, warn};

use crate::reload::Again;
use crate::shutdown::Stop;

/// Time between two status lines.
const STATUS: Duration = Duration::from_secs(1);
/// Watchdog messages in a watchdog interval: each may be late by more than half of it.
const FEEDS: u32 = 4;
/// Periods of the loop that the shortest watchdog interval must hold.
const LEAST_PERIODS: u32 = 4;
/// Shortest standstill of the loop that is logged.
const STILL: Duration = Duration::from_millis(500);

/// Why the service manager cannot be notified.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ServiceError {
    /// A variable of the environment is malformed.
    #[error("environment: {name} = {value}; allowed: {allowed}")]
    Value {
        name: &'static str,
        value: String,
        allowed: String,
    },
    #[error("NOTIFY_SOCKET: {0}")]
    Socket(#[from] io::Error),
}

/// Cycles that the loop has made. The loop adds, the ordinary thread reads.
#[derive(Clone, Debug, Default)]
pub struct Progress(Arc<AtomicU64>);

impl Progress {
    /// Counts one more cycle. Neither allocates nor waits.
    pub fn advance(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Cycles so far. Relaxed: no other data is published with the count.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// What the environment says about the service manager.
#[derive(Debug, Default)]
pub struct Service {
    line: Option<Socket>,
    watchdog: Option<Duration>,
}

impl Service {
    /// Reads `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID`. Without a service manager,
    /// notifications do nothing.
    ///
    /// # Errors
    /// [`ServiceError`] names a malformed variable, or a watchdog interval that a loop with this
    /// period cannot meet.
    pub fn by_environment(period: Duration) -> Result<Self, ServiceError> {
        Self::parse(|name| std::env::var_os(name), std::process::id(), period)
    }

    fn parse(
        variable: impl Fn(&str) -> Option<OsString>,
        pid: u32,
        period: Duration,
    ) -> Result<Self, ServiceError> {
        let line = variable("NOTIFY_SOCKET")
            .map(|name| Socket::to(&name))
            .transpose()?;
        let number = |name: &'static str| {
            variable(name)
                .map(|value| {
                    let number = value.to_str().and_then(|text| text.parse::<u64>().ok());
                    number.filter(|number| *number > 0).ok_or_else(|| {
                        refuse(name, value.to_string_lossy(), "a whole number from 1 on")
                    })
                })
                .transpose()
        };
        let interval = number("WATCHDOG_USEC")?.map(Duration::from_micros);
        // The variables are inherited: the watchdog may be meant for the process that started us.
        let is_for_us = number("WATCHDOG_PID")?.is_none_or(|meant| meant == u64::from(pid));
        let watchdog = interval.filter(|_| is_for_us && line.is_some());
        let least = LEAST_PERIODS * period;
        if let Some(short) = watchdog.filter(|interval| *interval < least) {
            let allowed = format!(
                "{} on, which is {LEAST_PERIODS} periods of the loop (WatchdogSec= in the unit)",
                least.as_micros()
            );
            return Err(refuse("WATCHDOG_USEC", short.as_micros(), &allowed));
        }
        Ok(Self { line, watchdog })
    }

    /// Sends a failure as the status that `systemctl status` shows after the daemon ended.
    pub fn leave(&self, failure: &str) {
        if let Some(line) = &self.line {
            // The exit code and standard error say it as well.
            let _ = line.say(&format!("STATUS={}", one_line(failure)));
        }
    }
}

fn refuse(name: &'static str, value: impl Display, allowed: &str) -> ServiceError {
    ServiceError::Value {
        name,
        value: value.to_string(),
        allowed: allowed.to_owned(),
    }
}

/// A line feed would begin another message.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The socket of the service manager. Never waits: a manager that does not read must not stop us.
#[derive(Debug)]
struct Socket {
    socket: UnixDatagram,
    manager: SocketAddr,
}

impl Socket {
    fn to(name: &OsString) -> Result<Self, ServiceError> {
        let manager = match name.as_bytes() {
            [b'@', rest @ ..] if !rest.is_empty() => SocketAddr::from_abstract_name(rest),
            [b'/', _, ..] => SocketAddr::from_pathname(Path::new(name)),
            _ => Err(io::Error::from(io::ErrorKind::InvalidInput)),
        };
        let allowed = "an absolute path, or @ and an abstract name, at most 107 bytes";
        let manager =
            manager.map_err(|_| refuse("NOTIFY_SOCKET", name.to_string_lossy(), allowed))?;
        let socket = UnixDatagram::unbound()?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, manager })
    }

    fn say(&self, message: &str) -> io::Result<()> {
        // Not connected: a manager that restarted has a new socket under the old name.
        let sent = self.socket.send_to_addr(message.as_bytes(), &self.manager);
        sent.map(|_| ())
    }
}

/// What to send to systemd now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Due {
    ready: bool,
    status: bool,
    watchdog: bool,
    stopping: bool,
}

/// What was sent and seen so far; pure, so that tests move the clock by hand.
#[derive(Debug)]
struct Schedule {
    /// Time between two watchdog messages.
    feed: Option<Duration>,
    is_ready: bool,
    is_stopping: bool,
    fed: Option<Instant>,
    told: Option<Instant>,
    count: u64,
    moved: Instant,
}

impl Schedule {
    fn new(watchdog: Option<Duration>, now: Instant) -> Self {
        Self {
            feed: watchdog.map(|interval| interval / FEEDS),
            is_ready: false,
            is_stopping: false,
            fed: None,
            told: None,
            count: 0,
            moved: now,
        }
    }

    fn look(&mut self, now: Instant, count: u64, stop: bool) -> Due {
        let has_moved = count != self.count;
        if has_moved {
            (self.count, self.moved) = (count, now);
        }
        let is_old = |last: Option<Instant>, most: Duration| {
            last.is_none_or(|last| now.saturating_duration_since(last) >= most)
        };
        Due {
            ready: has_moved && !self.is_ready,
            watchdog: has_moved && self.feed.is_some_and(|feed| is_old(self.fed, feed)),
            status: is_old(self.told, STATUS),
            stopping: stop && !self.is_stopping,
        }
    }

    /// Notes that what was due has reached the manager.
    fn done(&mut self, now: Instant, due: Due) {
        self.is_ready |= due.ready;
        self.is_stopping |= due.stopping;
        if due.watchdog {
            self.fed = Some(now);
        }
        if due.status {
            self.told = Some(now);
        }
    }

    /// How long the loop has been standing still, if for longer than is normal.
    fn standstill(&self, now: Instant, most: Duration) -> Option<Duration> {
        let still = now.saturating_duration_since(self.moved);
        (still >= most).then_some(still)
    }
}

/// Notifies the service manager from the ordinary thread.
#[derive(Debug)]
pub struct Notifier {
    line: Option<Socket>,
    schedule: Schedule,
    /// Standstill that is logged.
    longest_standstill: Duration,
    is_still: bool,
    is_cut: bool,
    progress: Progress,
    stop: Stop,
    again: Again,
}

impl Default for Notifier {
    /// A notifier that does nothing.
    fn default() -> Self {
        Self::new(
            Service::default(),
            Duration::ZERO,
            Progress::default(),
            Stop::default(),
            Again::default(),
            Instant::now(),
        )
    }
}

impl Notifier {
    /// A notifier for a loop of this period that begins `now`, counts in `progress` and ends by
    /// `stop`.
    pub fn new(
        service: Service,
        period: Duration,
        progress: Progress,
        stop: Stop,
        again: Again,
        now: Instant,
    ) -> Self {
        Self {
            line: service.line,
            schedule: Schedule::new(service.watchdog, now),
            longest_standstill: STILL.max(LEAST_PERIODS * period),
            is_still: false,
            is_cut: false,
            progress,
            stop,
            again,
        }
    }

    /// One look at the loop, every few milliseconds; says what is due. `status` is asked once a
    /// second.
    pub fn tend(&mut self, now: Instant, status: impl FnOnce() -> String) {
        self.say_due(now, status, self.stop.is_asked());
        self.log_standstill(now);
    }

    /// The last status, after the loop has ended for whatever reason.
    pub fn end(&mut self, now: Instant, status: impl FnOnce() -> String) {
        self.schedule.told = None;
        self.say_due(now, status, true);
    }

    fn say_due(&mut self, now: Instant, status: impl FnOnce() -> String, stop: bool) {
        let due = self.schedule.look(now, self.progress.count(), stop);
        let Some(line) = &self.line else {
            return;
        };
        let mut message = String::new();
        let stopping = match self.again.is_asked() {
            true => format!("RELOADING=1\nMONOTONIC_USEC={}\n", ipc::now_ns() / 1000),
            false => "STOPPING=1\n".to_owned(),
        };
        for (is_due, word) in [
            (due.ready, "READY=1\n"),
            (due.stopping, &*stopping),
            (due.watchdog, "WATCHDOG=1\n"),
        ] {
            if is_due {
                message.push_str(word);
            }
        }
        if due.status {
            let still = match self.schedule.standstill(now, self.longest_standstill) {
                Some(still) => format!("LOOP STANDS STILL for {:.1} s; ", still.as_secs_f64()),
                None => String::new(),
            };
            message.push_str(&format!("STATUS={still}{}\n", one_line(&status())));
        }
        if message.is_empty() {
            return;
        }
        match line.say(&message) {
            Ok(()) => {
                self.schedule.done(now, due);
                self.is_cut = false;
            }
            // Said again at the next occasion.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => (),
            Err(error) if !self.is_cut => {
                warn!(%error, "the service manager does not listen at NOTIFY_SOCKET: {error}");
                self.is_cut = true;
            }
            Err(_) => (),
        }
    }

    fn log_standstill(&mut self, now: Instant) {
        let still = self.schedule.standstill(now, self.longest_standstill);
        if still.is_some() != self.is_still {
            self.is_still = still.is_some();
            let cycle = self.schedule.count;
            match still {
                Some(_) => error!(
                    cycle,
                    "the loop stands still; the watchdog is no longer fed"
                ),
                None => warn!(cycle, "the loop moves again"),
            }
        }
    }
}

#[cfg(test)]
mod tests;
