//! Configuration: a TOML file, overridden by flags and checked into a [`Config`], which is always
//! valid. Every key is declared in `tables.rs`, those of `[law]` in
//! `vpc::Settings`; `CONFIGURATION.md` and `vpcd.schema.json` are made from them.

use std::path::{Path, PathBuf};

use messages::ClockMode;
use program::Exit;
use scene::Scene;
use toml_schema::Document;
use vpc::{Settings, SettingsError};

use crate::arguments::Arguments;
use crate::realtime::RealtimeRequest;
use decision::{Rules, Safety};

mod tables;
#[cfg(test)]
mod tests;

use tables::{Presence, Tables};

pub use toml_schema::FileError as ConfigError;

/// Longest time without new features for which commands may be valid, s, and the periods that are
/// always allowed.
const MOST_STALE_S: f64 = 1.0;
const LEAST_STALE_PERIODS: f64 = 3.0;

/// A valid configuration.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Config {
    /// Scene file.
    pub scene: PathBuf,
    /// Memory of motion: opened whenever one is named, so that an operator may change to a strategy
    /// that needs it; always present where the strategy of the start needs one.
    pub memory: Option<PathBuf>,
    /// Settings of the law, checked.
    pub settings: Settings,
    /// What starts a cycle.
    pub clock: ClockMode,
    /// Settings of the supervisor and of the gate.
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

/// Returns the JSON Schema of a configuration file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Tables>()
}

/// The exit code of `vpcd` after an error of its configuration.
pub(crate) fn exit(error: &ConfigError) -> Exit {
    match error {
        ConfigError::Value { path, .. } if path == toml_schema::COMMAND_LINE => Exit::Usage,
        error => Exit::from(error),
    }
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole,
    /// and that scene and memory can be read.
    ///
    /// # Errors
    /// [`ConfigError`] names file or flag, key, value and what is allowed.
    pub fn read(arguments: &Arguments) -> Result<Self, ConfigError> {
        Ok(Self::read_whole(arguments)?.0)
    }

    /// As [`Config::read`], with what [`Config::print`] returns, both of one reading.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn read_whole(arguments: &Arguments) -> Result<(Self, String), ConfigError> {
        let (tables, config, document) = source(arguments)?;
        document.readable(&["scene", "memory"])?;
        Ok((config, printed(tables, arguments)?))
    }

    /// Checks the text of a configuration with flags over it; `path` is for messages, and paths in
    /// the text are relative to `directory`.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse(
        text: &str,
        path: &str,
        directory: &Path,
        arguments: &Arguments,
    ) -> Result<Self, ConfigError> {
        Ok(laid_over(Document::parse(text, path)?, directory, arguments)?.1)
    }

    /// The rules of the control step on this scene; `source` names the configuration.
    ///
    /// # Errors
    /// [`ConfigError::Value`] if commands would be valid for too long.
    pub fn rules(&self, scene: &Scene, source: &str) -> Result<Rules, ConfigError> {
        let most = (MOST_STALE_S / scene.sampling_time()).max(LEAST_STALE_PERIODS);
        let periods = self.safety.stale_periods;
        if self.clock != ClockMode::Lockstep && periods > most {
            let rate_hz = scene.camera.rate_hz;
            let allowed = format!("at most {most} at the scene's {rate_hz} Hz, {MOST_STALE_S} s");
            let key = "cycle.stale_periods";
            return Err(ConfigError::value(source, key, periods, allowed));
        }
        Ok(Rules::new(scene, &self.settings, &self.safety, self.clock))
    }

    /// Returns the whole configuration that file and flags come to, with all defaults and absolute
    /// paths, as TOML that is read as the same in any directory.
    ///
    /// # Errors
    /// As [`Config::read`]: only a valid configuration is printed.
    pub fn print(arguments: &Arguments) -> Result<String, ConfigError> {
        printed(source(arguments)?.0, arguments)
    }
}

/// These tables as TOML, with absolute paths.
fn printed(mut tables: Tables, arguments: &Arguments) -> Result<String, ConfigError> {
    let paths = [
        &mut tables.memory,
        &mut tables.ipc.domain,
        &mut tables.flight.directory,
    ];
    for path in paths.into_iter().flatten().chain([&mut tables.scene]) {
        // Only the empty path has no absolute one; it is no file either way.
        *path = std::path::absolute(&*path).unwrap_or_default();
    }
    toml::to_string(&tables).map_err(|error| ConfigError::Syntax {
        path: named(arguments),
        message: error.to_string(),
    })
}

/// Where a configuration comes from, in messages: its file or the command line.
pub(crate) fn named(arguments: &Arguments) -> String {
    let file = arguments.config.as_ref();
    file.map_or(toml_schema::COMMAND_LINE.to_owned(), |file| {
        file.display().to_string()
    })
}

/// The file that the command line names, with flags over it.
fn source(arguments: &Arguments) -> Result<(Tables, Config, Document), ConfigError> {
    let file = arguments.config.as_deref();
    let directory = file.and_then(Path::parent).unwrap_or(Path::new(""));
    laid_over(Document::read(file)?, directory, arguments)
}

/// The tables with every default filled in, what they come to, and where they come from.
fn laid_over(
    mut document: Document,
    directory: &Path,
    flags: &Arguments,
) -> Result<(Tables, Config, Document), ConfigError> {
    document.relative_to(
        directory,
        &["scene", "memory", "ipc.domain", "flight.directory"],
    );
    let path = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
    document.set("scene", "--scene", path(&flags.scene));
    document.set("memory", "--memory", path(&flags.memory));
    document.set("ipc.domain", "--domain", path(&flags.domain));
    document.set("law.strategy", "--strategy", flags.strategy.clone());
    document.set("law.np", "--np", flags.np);
    document.set("cycle.clock", "--clock", flags.clock.clone());
    document.set("safety.armed", "--arm", flags.arm.then_some(true));

    let mut tables: Tables = document.check()?;
    let clock = ClockMode::from(tables.cycle.clock);
    // No arm moves in lockstep, where time waits for the answer.
    let armed = *tables
        .safety
        .armed
        .get_or_insert(clock == ClockMode::Lockstep);
    let robot = tables.safety.robot.get_or_insert(match clock {
        ClockMode::Lockstep => Presence::Optional,
        ClockMode::Fixed | ClockMode::Phase => Presence::Required,
    });
    let needs_robot = *robot == Presence::Required;
    let domain = tables
        .ipc
        .domain
        .get_or_insert_with(ipc::default_directory)
        .clone();
    // Beside the domain, which is removed with its last user.
    let mut beside = domain.clone().into_os_string();
    beside.push("-flight");
    let directory = tables.flight.directory.get_or_insert(beside.into()).clone();
    // Lockstep keeps the paper's steps.
    let brake_s = match clock {
        ClockMode::Lockstep => 0.0,
        ClockMode::Fixed | ClockMode::Phase => tables.safety.brake_s,
    };
    let config = Config {
        scene: tables.scene.clone(),
        memory: tables.memory.clone(),
        settings: check(
            &document,
            Settings {
                brake_s,
                blind_s: tables.safety.blind_s,
                ..tables.law
            },
        )?,
        clock,
        safety: Safety {
            armed,
            brake_s: tables.safety.brake_s,
            blind_s: tables.safety.blind_s,
            lost_s: tables.safety.lost_s,
            stale_periods: tables.cycle.stale_periods,
            needs_robot,
            after_arrival: tables.safety.after_arrival,
        },
        domain,
        margin_ns: (tables.cycle.margin_ms * 1e6) as u64,
        realtime: realtime(&document, &tables.realtime)?,
        log_level: tables.log.level.clone(),
        log_json: tables.log.format == "json",
        flight: FlightConfig {
            directory,
            minutes: tables.flight.minutes,
            keep: tables.flight.keep,
            at_exit: tables.flight.at_exit,
        },
    };
    if config.settings.strategy.needs_memory() && config.memory.is_none() {
        let allowed = "a memory of motion for the strategies knn and gpr, by the key `memory` or the flag --memory";
        return Err(document.missing("memory", allowed));
    }
    Ok((tables, config, document))
}

/// Checks what the schema does not say.
fn check(document: &Document, settings: Settings) -> Result<Settings, ConfigError> {
    match settings.check() {
        Ok(()) => Ok(settings),
        Err(SettingsError::Range {
            name,
            value,
            allowed,
        }) => Err(document.refuse(&format!("law.{name}"), value, allowed)),
        Err(error) => Err(document.refuse("law", error, "what the law allows")),
    }
}

fn realtime(
    document: &Document,
    table: &tables::Realtime,
) -> Result<Option<RealtimeRequest>, ConfigError> {
    match (table.priority, table.cpu) {
        (None, Some(_)) => {
            let allowed = "1 to 99, where realtime.cpu is given";
            Err(document.missing("realtime.priority", allowed))
        }
        (priority, cpu) => Ok(priority.map(|priority| RealtimeRequest { priority, cpu })),
    }
}
