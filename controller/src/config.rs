//! Configuration: TOML into raw numbers, flags over it, then checked into a [`Config`] whose existence means that it
//! is valid. Every key stands in [`KEYS`] with its range, which the checks go by and `CONFIGURATION.md` is made from.

use std::path::{Path, PathBuf};

use ipc::ClockMode;
use vpc::{Model, Settings};

use crate::arguments::Arguments;
use crate::realtime::RealtimeRequest;

mod check;
mod error;
mod keys;
mod raw;
#[cfg(test)]
mod tests;

use check::Checker;
use raw::Raw;

pub use error::ConfigError;
pub use keys::KEYS;

/// A valid configuration.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Config {
    /// Scene file.
    pub scene: PathBuf,
    /// Memory of motion: opened whenever one is named, so that an operator may change to a strategy that needs it;
    /// always present where the strategy of the start needs one.
    pub memory: Option<PathBuf>,
    /// Settings of the law, checked.
    pub settings: Settings,
    /// What starts a cycle.
    pub clock: ClockMode,
    /// Periods for which the last command may stand without new features; the camera brakes so early that it never
    /// stands longer.
    pub stale_periods: f64,
    /// What the supervisor goes by.
    pub safety: Safety,
    /// Directory of the shared-memory domain.
    pub domain: PathBuf,
    /// How far after the expected arrival of features the clock `phase` releases a cycle, ns.
    pub margin_ns: u64,
    /// What the loop's thread asks for; `None`: an ordinary thread.
    pub realtime: Option<RealtimeRequest>,
    /// Filter of the log.
    pub log_level: String,
    /// Whether log lines are JSON.
    pub log_json: bool,
    /// The flight record.
    pub flight: FlightConfig,
}

/// How the flight record is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightConfig {
    /// Where files are written.
    pub directory: PathBuf,
    /// Minutes in memory, at the scene's rate.
    pub minutes: f64,
    /// Files kept, at least one.
    pub keep: usize,
    /// Whether one is written when the daemon ends, too.
    pub at_exit: bool,
}

impl FlightConfig {
    /// Cycles kept in memory at this rate, Hz.
    pub fn cycles(&self, rate_hz: f64) -> usize {
        (self.minutes * 60.0 * rate_hz).round() as usize
    }
}

/// The part of the configuration that the supervisor goes by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Safety {
    /// Whether the controller starts armed.
    pub armed: bool,
    /// Time in which a twist at the limits is braked to zero, s.
    pub brake_s: f64,
    /// Time without usable features after which the camera is disarmed, s.
    pub lost_s: f64,
}

/// Stands for a file in messages about flags.
const COMMAND_LINE: &str = "command line";

/// The model of a word in configuration files.
pub(crate) fn model(name: &str) -> Option<Model> {
    [Model::TargetDepth, Model::AreaDepth, Model::Pose]
        .into_iter()
        .find(|model| model_name(*model) == name)
}

/// The word of a model in configuration files.
pub(crate) fn model_name(model: Model) -> &'static str {
    match model {
        Model::TargetDepth => "target-depth",
        Model::AreaDepth => "area-depth",
        Model::Pose => "pose",
    }
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole.
    ///
    /// # Errors
    /// [`ConfigError`] names file or flag, key, value and what is allowed.
    pub fn read(arguments: &Arguments) -> Result<Self, ConfigError> {
        let (text, path, directory) = source(arguments)?;
        Self::parse(&text, &path, &directory, arguments)
    }

    /// Checks the text of a configuration with flags over it; `path` is for messages, and paths in the text are
    /// relative to `directory`.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse(
        text: &str,
        path: &str,
        directory: &Path,
        arguments: &Arguments,
    ) -> Result<Self, ConfigError> {
        let raw = raw(text, path, directory, arguments)?;
        Checker { path, arguments }.config(raw)
    }

    /// The whole configuration that file and flags come to, defaults and all, as TOML of which [`Config::parse`] makes
    /// the same.
    ///
    /// # Errors
    /// As [`Config::read`]: only a valid configuration is shown.
    pub fn print(arguments: &Arguments) -> Result<String, ConfigError> {
        let (text, path, directory) = source(arguments)?;
        Self::effective(&text, &path, &directory, arguments)
    }

    /// [`Config::print`] of a text.
    ///
    /// # Errors
    /// As [`Config::parse`].
    pub fn effective(
        text: &str,
        path: &str,
        directory: &Path,
        arguments: &Arguments,
    ) -> Result<String, ConfigError> {
        let config = Self::parse(text, path, directory, arguments)?;
        let mut raw = raw(text, path, directory, arguments)?;
        raw.safety.armed = Some(config.safety.armed);
        raw.ipc.domain = Some(config.domain);
        raw.flight.directory = Some(config.flight.directory);
        toml::to_string(&raw).map_err(|e| ConfigError::Syntax {
            path: path.to_owned(),
            message: e.to_string(),
        })
    }
}

/// Where a configuration comes from, in messages: its file or the command line.
pub(crate) fn named(arguments: &Arguments) -> String {
    let file = arguments.config.as_ref();
    file.map_or(COMMAND_LINE.to_owned(), |file| file.display().to_string())
}

/// The text of the file that the command line names, its name, and the directory that its paths are relative to.
fn source(arguments: &Arguments) -> Result<(String, String, PathBuf), ConfigError> {
    let path = named(arguments);
    let Some(file) = &arguments.config else {
        return Ok((String::new(), path, PathBuf::new()));
    };
    let text = std::fs::read_to_string(file).map_err(|source| ConfigError::Read {
        path: path.clone(),
        source,
    })?;
    let directory = file.parent().unwrap_or(Path::new("")).to_owned();
    Ok((text, path, directory))
}

/// The tables of a text with the flags over them, unchecked.
fn raw(
    text: &str,
    path: &str,
    directory: &Path,
    arguments: &Arguments,
) -> Result<Raw, ConfigError> {
    let mut raw: Raw = toml::from_str(text).map_err(|e| ConfigError::Syntax {
        path: path.to_owned(),
        message: e.to_string().trim_end().to_owned(),
    })?;
    let files = [
        &mut raw.scene,
        &mut raw.memory,
        &mut raw.ipc.domain,
        &mut raw.flight.directory,
    ];
    for file in files.into_iter().flatten() {
        *file = directory.join(&*file);
    }
    raw.lay_over(arguments);
    Ok(raw)
}
