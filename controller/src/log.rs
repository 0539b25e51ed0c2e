//! The log goes to the journal if standard error is connected to it, and else to standard error.
//! The loop itself never logs.

use std::io::{IsTerminal, Write};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::fstat;
use tracing_journald::{Priority, PriorityMappings};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::config::Config;
use crate::lossy::Lossy;

/// The log of this process. When it goes, lines on their way are given a tenth of a second.
#[derive(Debug)]
pub struct Log(Option<Lossy>);

impl Log {
    /// Lines lost so far because standard error was not read; the journal counts its own losses.
    pub fn lost(&self) -> u64 {
        self.0.as_ref().map_or(0, Lossy::lost)
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        if let Some(lossy) = &self.0 {
            lossy.flush();
        }
    }
}

/// Starts logging as configured.
///
/// # Errors
/// If the writer's thread cannot be started.
pub fn start(config: &Config) -> std::io::Result<Log> {
    // The level was checked; a filter is never read from the environment.
    let filter = EnvFilter::new(&config.log_level);
    if let Some(journal) = journal() {
        // Already started in this process (tests): the first one stays.
        let _ = tracing_subscriber::registry()
            .with(filter)
            .with(journal)
            .try_init();
        return Ok(Log(None));
    }
    let lossy = Lossy::new(std::io::stderr())?;
    let builder = fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(lossy.clone());
    let _ = if config.log_json {
        builder.json().try_init()
    } else {
        builder.with_target(false).try_init()
    };
    Ok(Log(Some(lossy)))
}

/// Writes a failure to standard error, before or after the log; in the journal with the priority of
/// an error. An unread pipe does not delay the end of the process.
pub fn complain(message: &str) {
    let priority = if is_journal() { "<3>" } else { "" };
    let lines: String = format!("vpcd: {message}")
        .lines()
        .map(|line| format!("{priority}{line}\n"))
        .collect();
    let mut error = std::io::stderr();
    let mut writable = [PollFd::new(&error, PollFlags::OUT)];
    let patience = Timespec {
        tv_sec: 0,
        tv_nsec: 100_000_000,
    };
    if poll(&mut writable, Some(&patience)).is_ok_and(|ready| ready > 0) {
        // A failure to write to standard error has no other place to go.
        let _ = error.write_all(lines.as_bytes());
    }
}

/// The journal with its fields, which carry our name: `VPCD_CYCLE=`. None if it cannot be
/// reached.
fn journal() -> Option<tracing_journald::Layer> {
    let layer = is_journal()
        .then(tracing_journald::layer)
        .and_then(Result::ok)?;
    let priorities = PriorityMappings {
        info: Priority::Informational,
        debug: Priority::Debug,
        ..PriorityMappings::new()
    };
    let layer = layer
        .with_field_prefix(Some("VPCD".to_owned()))
        .with_syslog_identifier("vpcd".to_owned())
        .with_priority_mappings(priorities);
    Some(layer)
}

/// Whether standard error is the stream that `JOURNAL_STREAM` names, and was not redirected since.
fn is_journal() -> bool {
    let Some(stream) = std::env::var_os("JOURNAL_STREAM") else {
        return false;
    };
    let Ok(found) = fstat(std::io::stderr()) else {
        return false;
    };
    stream.to_str() == Some(&format!("{}:{}", found.st_dev, found.st_ino))
}
