//! The log goes to the journal where standard error is connected to it, and to standard error elsewhere; the loop
//! itself never logs.

use std::io::IsTerminal;

use rustix::fs::fstat;
use tracing_journald::{Priority, PriorityMappings};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::config::Config;

/// Starts logging as configured.
pub fn start(config: &Config) {
    // The level was checked; a filter is never read from the environment.
    let filter = EnvFilter::new(&config.log_level);
    if let Some(journal) = journal() {
        // Already started in this process (tests): the first one stays.
        let _ = tracing_subscriber::registry()
            .with(filter)
            .with(journal)
            .try_init();
        return;
    }
    let builder = fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    let _ = if config.log_json {
        builder.json().try_init()
    } else {
        builder.with_target(false).try_init()
    };
}

/// Writes a failure to standard error, before or after the log; in the journal with the priority of an error.
pub fn complain(message: &str) {
    let priority = if is_journal() { "<3>" } else { "" };
    for line in format!("vpcd: {message}").lines() {
        eprintln!("{priority}{line}");
    }
}

/// The journal with its fields, which carry our name: `VPCD_CYCLE=`. None where it cannot be reached.
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
