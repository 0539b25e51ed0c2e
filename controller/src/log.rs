//! The log goes to standard error; the loop itself never logs.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt;

use crate::config::Config;

/// Starts logging as configured.
pub fn start(config: &Config) {
    // The level was checked; a filter is never read from the environment.
    let filter = EnvFilter::new(&config.log_level);
    let builder = fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    // Already started in this process (tests): the first one stays.
    let _ = if config.log_json {
        builder.json().try_init()
    } else {
        builder.with_target(false).try_init()
    };
}
