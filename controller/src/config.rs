//! Configuration: TOML into raw numbers, flags over it, then checked into a [`Config`] whose existence means that it
//! is valid.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use ipc::ClockMode;
use serde::Deserialize;
use vpc::{Model, Settings, Strategy};

use crate::arguments::Arguments;
use crate::exit::Exit;
use crate::realtime::Wish;

/// A valid configuration.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Config {
    /// Scene file.
    pub scene: PathBuf,
    /// Memory of motion; present where the strategy needs one.
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
    pub realtime: Option<Wish>,
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

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{path}: cannot read the configuration: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// It is not the TOML of a configuration: wrong syntax, an unknown key, a wrong type.
    #[error("{path}: {message}")]
    Syntax {
        /// The file.
        path: String,
        /// Line, column, and what was expected.
        message: String,
    },
    /// A key without a default is missing.
    #[error("{path}: {key} is missing; allowed: {allowed}")]
    Missing {
        /// The file, or the command line.
        path: String,
        /// The key.
        key: &'static str,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A value is out of its range.
    #[error("{path}: {key} = {value}; allowed: {allowed}")]
    Value {
        /// The file, or the command line.
        path: String,
        /// The key with its table, or the flag.
        key: String,
        /// What was found.
        value: String,
        /// What is allowed.
        allowed: String,
    },
}

impl ConfigError {
    /// The exit code that it asks for.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Read { .. } => Exit::NoInput,
            Self::Value { path, .. } | Self::Missing { path, .. } if path == COMMAND_LINE => {
                Exit::Usage
            }
            _ => Exit::Config,
        }
    }
}

/// Stands for a file in messages about flags.
const COMMAND_LINE: &str = "command line";

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Raw {
    scene: Option<PathBuf>,
    memory: Option<PathBuf>,
    law: RawLaw,
    cycle: RawCycle,
    safety: RawSafety,
    ipc: RawIpc,
    realtime: RawRealtime,
    log: RawLog,
    flight: RawFlight,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawFlight {
    directory: Option<PathBuf>,
    minutes: f64,
    keep: i64,
    at_exit: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawLaw {
    strategy: String,
    np: i64,
    nc: i64,
    iterations: i64,
    tolerance: f64,
    model: String,
    trigger_px: f64,
    release: f64,
    margin_px: f64,
    lambda: f64,
    delay_compensation: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawCycle {
    clock: String,
    stale_periods: f64,
    margin_ms: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawSafety {
    armed: Option<bool>,
    brake_s: f64,
    lost_s: f64,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct RawIpc {
    domain: Option<PathBuf>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct RawRealtime {
    priority: Option<i64>,
    cpu: Option<i64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawLog {
    level: String,
    format: String,
}

impl Default for RawLaw {
    fn default() -> Self {
        let settings = Settings::default();
        Self {
            strategy: settings.strategy.to_string(),
            np: settings.np as i64,
            nc: settings.nc as i64,
            iterations: i64::from(settings.effort.max_iterations),
            tolerance: settings.effort.tolerance,
            model: model_name(settings.model).to_owned(),
            trigger_px: settings.trigger_px,
            release: settings.release,
            margin_px: settings.margin_px,
            lambda: settings.lambda,
            delay_compensation: settings.delay_compensation,
        }
    }
}

impl Default for RawCycle {
    fn default() -> Self {
        Self {
            clock: "fixed".to_owned(),
            stale_periods: 3.0,
            margin_ms: 1.0,
        }
    }
}

impl Default for RawSafety {
    fn default() -> Self {
        Self {
            armed: None,
            brake_s: 0.15,
            lost_s: 0.3,
        }
    }
}

impl Default for RawFlight {
    fn default() -> Self {
        Self {
            directory: None,
            minutes: 5.0,
            keep: 10,
            at_exit: false,
        }
    }
}

impl Default for RawLog {
    fn default() -> Self {
        Self {
            level: "info".to_owned(),
            format: "text".to_owned(),
        }
    }
}

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
        match &arguments.config {
            Some(file) => {
                let path = file.display().to_string();
                let text = std::fs::read_to_string(file).map_err(|source| ConfigError::Read {
                    path: path.clone(),
                    source,
                })?;
                let directory = file.parent().unwrap_or(Path::new(""));
                Self::parse(&text, &path, directory, arguments)
            }
            None => Self::parse("", COMMAND_LINE, Path::new(""), arguments),
        }
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
        let mut raw: Raw = toml::from_str(text).map_err(|e| ConfigError::Syntax {
            path: path.to_owned(),
            message: e.to_string().trim_end().to_owned(),
        })?;
        let under = |file: &mut Option<PathBuf>| {
            if let Some(file) = file {
                *file = directory.join(&*file);
            }
        };
        under(&mut raw.scene);
        under(&mut raw.memory);
        under(&mut raw.ipc.domain);
        under(&mut raw.flight.directory);
        let checker = Checker { path, arguments };
        checker.lay_flags_over(&mut raw);
        checker.config(raw)
    }
}

/// Turns raw tables into checked ones; every refusal names where the value came from.
struct Checker<'a> {
    path: &'a str,
    arguments: &'a Arguments,
}

impl Checker<'_> {
    fn lay_flags_over(&self, raw: &mut Raw) {
        let flags = self.arguments.clone();
        raw.scene = flags.scene.or(raw.scene.take());
        raw.memory = flags.memory.or(raw.memory.take());
        raw.ipc.domain = flags.domain.or(raw.ipc.domain.take());
        if let Some(strategy) = flags.strategy {
            raw.law.strategy = strategy;
        }
        if let Some(np) = flags.np {
            raw.law.np = np;
        }
        if let Some(clock) = flags.clock {
            raw.cycle.clock = clock;
        }
        if flags.arm {
            raw.safety.armed = Some(true);
        }
    }

    fn refuse(&self, key: &str, value: impl Display, allowed: &str) -> ConfigError {
        let flag = match key {
            "law.strategy" if self.arguments.strategy.is_some() => Some("--strategy"),
            "law.np" if self.arguments.np.is_some() => Some("--np"),
            "cycle.clock" if self.arguments.clock.is_some() => Some("--clock"),
            _ => None,
        };
        ConfigError::Value {
            path: flag.map_or(self.path, |_| COMMAND_LINE).to_owned(),
            key: flag.unwrap_or(key).to_owned(),
            value: value.to_string(),
            allowed: allowed.to_owned(),
        }
    }

    fn config(&self, raw: Raw) -> Result<Config, ConfigError> {
        let settings = self.settings(&raw.law)?;
        let scene = raw.scene.ok_or(ConfigError::Missing {
            path: self.path.to_owned(),
            key: "scene",
            allowed: "a scene file, by the key `scene` or the flag --scene",
        })?;
        if settings.strategy.needs_memory() && raw.memory.is_none() {
            return Err(ConfigError::Missing {
                path: self.path.to_owned(),
                key: "memory",
                allowed: "a memory of motion for the strategies knn and gpr, by the key `memory` or the flag --memory",
            });
        }
        let stale = raw.cycle.stale_periods;
        if !(2.0..=1000.0).contains(&stale) {
            return Err(self.refuse("cycle.stale_periods", stale, "2 to 1000 periods"));
        }
        let clock = self.clock(&raw.cycle)?;
        let margin = raw.cycle.margin_ms;
        if !(0.0..=20.0).contains(&margin) {
            return Err(self.refuse("cycle.margin_ms", margin, "0 to 20 ms"));
        }
        let domain = raw.ipc.domain.unwrap_or_else(ipc::default_directory);
        Ok(Config {
            flight: self.flight(raw.flight, &domain)?,
            scene,
            memory: raw.memory,
            settings,
            clock,
            stale_periods: stale,
            safety: self.safety(&raw.safety, clock)?,
            domain,
            margin_ns: (margin * 1e6) as u64,
            realtime: self.realtime(&raw.realtime)?,
            log_level: self.log_level(raw.log.level)?,
            log_json: self.log_json(&raw.log.format)?,
        })
    }

    fn clock(&self, raw: &RawCycle) -> Result<ClockMode, ConfigError> {
        match raw.clock.as_str() {
            "fixed" => Ok(ClockMode::Fixed),
            "phase" => Ok(ClockMode::Phase),
            "lockstep" => Ok(ClockMode::Lockstep),
            other => Err(self.refuse("cycle.clock", other, "fixed, phase, lockstep")),
        }
    }

    fn realtime(&self, raw: &RawRealtime) -> Result<Option<Wish>, ConfigError> {
        let within = |key: &str, value: i64, least: i64, most: i64| {
            if (least..=most).contains(&value) {
                Ok(value)
            } else {
                Err(self.refuse(key, value, &format!("{least} to {most}")))
            }
        };
        let cpu = match raw.cpu {
            Some(cpu) => Some(within("realtime.cpu", cpu, 0, 1023)? as usize),
            None => None,
        };
        match raw.priority {
            Some(priority) => {
                let priority = within("realtime.priority", priority, 1, 99)? as i32;
                Ok(Some(Wish { priority, cpu }))
            }
            None if cpu.is_some() => Err(ConfigError::Missing {
                path: self.path.to_owned(),
                key: "realtime.priority",
                allowed: "1 to 99, where realtime.cpu is given",
            }),
            None => Ok(None),
        }
    }

    fn safety(&self, raw: &RawSafety, clock: ClockMode) -> Result<Safety, ConfigError> {
        if !(0.0..=0.15).contains(&raw.brake_s) {
            return Err(self.refuse("safety.brake_s", raw.brake_s, "0 to 0.15 s"));
        }
        if !(0.1..=10.0).contains(&raw.lost_s) {
            return Err(self.refuse("safety.lost_s", raw.lost_s, "0.1 to 10 s"));
        }
        Ok(Safety {
            // No arm moves in lockstep, where time waits for the answer.
            armed: raw.armed.unwrap_or(clock == ClockMode::Lockstep),
            brake_s: raw.brake_s,
            lost_s: raw.lost_s,
        })
    }

    fn flight(&self, raw: RawFlight, domain: &Path) -> Result<FlightConfig, ConfigError> {
        if !(0.1..=60.0).contains(&raw.minutes) {
            return Err(self.refuse("flight.minutes", raw.minutes, "0.1 to 60 min"));
        }
        let keep = usize::try_from(raw.keep)
            .ok()
            .filter(|keep| (1..=1000).contains(keep))
            .ok_or_else(|| self.refuse("flight.keep", raw.keep, "1 to 1000 files"))?;
        // Beside the domain, not in it: the domain is cleared away with its last user.
        let beside = || {
            let mut name = domain.as_os_str().to_owned();
            name.push("-flight");
            PathBuf::from(name)
        };
        Ok(FlightConfig {
            directory: raw.directory.unwrap_or_else(beside),
            minutes: raw.minutes,
            keep,
            at_exit: raw.at_exit,
        })
    }

    fn log_level(&self, level: String) -> Result<String, ConfigError> {
        match level.as_str() {
            "off" | "error" | "warn" | "info" | "debug" | "trace" => Ok(level),
            other => {
                let allowed = "off, error, warn, info, debug, trace";
                Err(self.refuse("log.level", other, allowed))
            }
        }
    }

    fn log_json(&self, format: &str) -> Result<bool, ConfigError> {
        match format {
            "text" => Ok(false),
            "json" => Ok(true),
            other => Err(self.refuse("log.format", other, "text, json")),
        }
    }

    /// The law's own check knows the ranges; here its names become keys.
    fn settings(&self, raw: &RawLaw) -> Result<Settings, ConfigError> {
        let strategy: Strategy = raw
            .strategy
            .parse()
            .map_err(|_| self.refuse("law.strategy", &raw.strategy, STRATEGIES))?;
        let model = model(&raw.model).ok_or_else(|| {
            self.refuse("law.model", &raw.model, "target-depth, area-depth, pose")
        })?;
        let count = |key: &str, value: i64, most: i64, allowed: &str| {
            if (1..=most).contains(&value) {
                Ok(value)
            } else {
                Err(self.refuse(key, value, allowed))
            }
        };
        let (np, nc) = (vpc::MAX_NP as i64, vpc::MAX_NC as i64);
        let iterations = count("law.iterations", raw.iterations, 1000, "1 to 1000")?;
        // The rest: a setting that the law may gain has its default until it gets a key here.
        #[allow(clippy::needless_update)]
        let settings = Settings {
            strategy,
            np: count("law.np", raw.np, np, "1 to 40")? as usize,
            nc: count("law.nc", raw.nc, nc.min(raw.np), "1 to 4, at most np")? as usize,
            effort: vpc::solver::Effort {
                max_iterations: iterations as u32,
                tolerance: raw.tolerance,
            },
            model,
            trigger_px: raw.trigger_px,
            release: raw.release,
            margin_px: raw.margin_px,
            lambda: raw.lambda,
            delay_compensation: raw.delay_compensation,
            ..Settings::default()
        };
        match settings.check() {
            Ok(()) => Ok(settings),
            Err(vpc::SettingsError::Range {
                name,
                value,
                allowed,
            }) => Err(self.refuse(&format!("law.{name}"), value, allowed)),
            Err(other) => Err(self.refuse("law", other, "what the scene's task allows")),
        }
    }
}

const STRATEGIES: &str = "previous, knn, knn2 to knn64, gpr, ibvs";

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str, arguments: &Arguments) -> Result<Config, ConfigError> {
        Config::parse(text, "/etc/v.toml", Path::new("/etc"), arguments)
    }

    fn refused(text: &str) -> String {
        let error = parse(text, &Arguments::default()).unwrap_err();
        assert_eq!(error.exit(), Exit::Config);
        error.to_string()
    }

    #[test]
    fn an_empty_file_with_a_scene_is_the_default() {
        let config = parse("scene = 's.toml'", &Arguments::default()).unwrap();
        assert_eq!(config.scene, Path::new("/etc/s.toml"));
        assert_eq!(config.settings, Settings::default());
        assert_eq!(
            (config.clock, config.stale_periods),
            (ClockMode::Fixed, 3.0)
        );
        assert_eq!(config.domain, ipc::default_directory());
    }

    #[test]
    fn flight_records_lie_beside_the_domain_or_where_the_file_says() {
        let directory = |text: &str| {
            let config = parse(text, &Arguments::default()).unwrap();
            config.flight.directory
        };
        let domain = "scene = 's'\n[ipc]\ndomain = '/run/d'\n";
        assert_eq!(directory(domain), Path::new("/run/d-flight"));
        let text = format!("{domain}[flight]\ndirectory = 'records'");
        assert_eq!(directory(&text), Path::new("/etc/records"));
    }

    #[test]
    fn flags_win_and_their_paths_are_their_own() {
        let flags = Arguments {
            scene: Some("other.toml".into()),
            strategy: Some("ibvs".into()),
            np: Some(30),
            clock: Some("lockstep".into()),
            ..Arguments::default()
        };
        let config = parse("scene = 's.toml'\n[law]\nnp = 5", &flags).unwrap();
        assert_eq!(config.scene, Path::new("other.toml"));
        assert_eq!(
            (config.settings.np, config.settings.strategy),
            (30, Strategy::Ibvs)
        );
        assert_eq!(config.clock, ClockMode::Lockstep);
    }

    #[test]
    fn a_refusal_names_file_key_value_and_range() {
        for (text, words) in [
            (
                "[law]\nnp = 41",
                "/etc/v.toml: law.np = 41; allowed: 1 to 40",
            ),
            ("[law]\nnp = -3", "law.np = -3; allowed: 1 to 40"),
            ("[law]\nnc = 4", "law.nc = 4; allowed: 1 to 4, at most np"),
            (
                "[law]\ntolerance = nan",
                "law.tolerance = NaN; allowed: 1e-15 to 1",
            ),
            (
                "[law]\ntrigger_px = -1.0",
                "law.trigger_px = -1; allowed: 0 to 1e4 px",
            ),
            (
                "[law]\nstrategy = 'knn65'",
                "law.strategy = knn65; allowed: previous, knn",
            ),
            (
                "[law]\nmodel = 'guess'",
                "law.model = guess; allowed: target-depth",
            ),
            (
                "[cycle]\nclock = 'sun'",
                "cycle.clock = sun; allowed: fixed, phase, lockstep",
            ),
            (
                "[cycle]\nstale_periods = 1.5",
                "cycle.stale_periods = 1.5; allowed: 2 to 1000",
            ),
            (
                "[safety]\nbrake_s = 0.2",
                "safety.brake_s = 0.2; allowed: 0 to 0.15 s",
            ),
            (
                "[safety]\nlost_s = -inf",
                "safety.lost_s = -inf; allowed: 0.1 to 10 s",
            ),
            (
                "[realtime]\npriority = 100",
                "realtime.priority = 100; allowed: 1 to 99",
            ),
            (
                "[realtime]\ncpu = 1",
                "realtime.priority is missing; allowed: 1 to 99, where realtime.cpu",
            ),
            (
                "[realtime]\npriority = 80\ncpu = -1",
                "realtime.cpu = -1; allowed: 0 to 1023",
            ),
            (
                "[cycle]\nmargin_ms = nan",
                "cycle.margin_ms = NaN; allowed: 0 to 20 ms",
            ),
            (
                "[flight]\nminutes = nan",
                "flight.minutes = NaN; allowed: 0.1 to 60 min",
            ),
            (
                "[flight]\nkeep = 0",
                "flight.keep = 0; allowed: 1 to 1000 files",
            ),
            ("[log]\nlevel = 'loud'", "log.level = loud; allowed: off"),
            (
                "[log]\nformat = 'xml'",
                "log.format = xml; allowed: text, json",
            ),
            (
                "[law]\nstrategy = 'gpr'",
                "/etc/v.toml: memory is missing; allowed: a memory",
            ),
        ] {
            let message = refused(&format!("scene = 's.toml'\n{text}"));
            assert!(message.contains(words), "{message}\nlacks {words}");
        }
        assert!(refused("").contains("/etc/v.toml: scene is missing"));
    }

    #[test]
    fn delay_compensation_is_on_and_can_be_switched_off() {
        let compensation = |text: &str| {
            let config = parse(&format!("scene = 's'\n{text}"), &Arguments::default()).unwrap();
            config.settings.delay_compensation
        };
        assert!(compensation(""));
        assert!(!compensation("[law]\ndelay_compensation = false"));
    }

    #[test]
    fn an_unknown_key_and_a_wrong_type_are_shown_in_their_line() {
        let message = refused("scene = 's.toml'\n[law]\nnpp = 3");
        assert!(
            message.contains("line 3") && message.contains("unknown field `npp`"),
            "{message}"
        );
        let message = refused("scene = 's.toml'\n[law]\nnp = 'three'");
        assert!(
            message.contains("line 3") && message.contains("invalid type"),
            "{message}"
        );
    }

    #[test]
    fn a_wrong_flag_is_an_error_of_usage() {
        let flags = Arguments {
            np: Some(0),
            ..Arguments::default()
        };
        let error = parse("scene = 's.toml'", &flags).unwrap_err();
        assert_eq!(error.exit(), Exit::Usage);
        assert_eq!(
            error.to_string(),
            "command line: --np = 0; allowed: 1 to 40"
        );
    }

    #[test]
    fn only_lockstep_starts_armed_unless_it_is_asked_for() {
        let armed = |text: &str, arguments: &Arguments| {
            let text = format!("scene = 's'\n{text}");
            parse(&text, arguments).unwrap().safety.armed
        };
        let none = Arguments::default();
        assert!(!armed("", &none));
        assert!(armed("[cycle]\nclock = 'lockstep'", &none));
        assert!(!armed(
            "[cycle]\nclock = 'lockstep'\n[safety]\narmed = false",
            &none
        ));
        assert!(armed("[safety]\narmed = true", &none));
        let flag = Arguments {
            arm: true,
            ..Arguments::default()
        };
        assert!(armed("[safety]\narmed = false", &flag));
    }
}
