//! From raw tables to checked ones; every refusal names where the value came from.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use ipc::ClockMode;
use scene::Key;
use vpc::{Settings, Strategy};

use super::raw::{Raw, RawCycle, RawFlight, RawLaw, RawRealtime, RawSafety};
use super::{COMMAND_LINE, Config, ConfigError, FlightConfig, Safety, keys, model};
use crate::arguments::Arguments;
use crate::realtime::RealtimeRequest;

/// Checks the values of one file, or of the command line alone.
pub(super) struct Checker<'a> {
    pub path: &'a str,
    pub arguments: &'a Arguments,
}

impl Checker<'_> {
    pub(super) fn config(&self, raw: Raw) -> Result<Config, ConfigError> {
        let settings = self.settings(&raw.law)?;
        let scene = raw.scene.ok_or_else(|| self.missing(&keys::SCENE))?;
        if settings.strategy.needs_memory() && raw.memory.is_none() {
            return Err(self.missing(&keys::MEMORY));
        }
        let stale_periods = self.number(&keys::STALE, raw.cycle.stale_periods)?;
        let clock = self.clock(&raw.cycle)?;
        let margin_ms = self.number(&keys::MARGIN_MS, raw.cycle.margin_ms)?;
        let domain = raw.ipc.domain.unwrap_or_else(ipc::default_directory);
        Ok(Config {
            flight: self.flight(raw.flight, &domain)?,
            scene,
            memory: raw.memory,
            settings,
            clock,
            stale_periods,
            safety: self.safety(&raw.safety, clock)?,
            domain,
            margin_ns: (margin_ms * 1e6) as u64,
            realtime: self.realtime(&raw.realtime)?,
            log_level: self.word(&keys::LEVEL, raw.log.level)?,
            log_json: self.word(&keys::FORMAT, raw.log.format)? == "json",
        })
    }

    fn missing(&self, key: &Key) -> ConfigError {
        ConfigError::Missing {
            path: self.path.to_owned(),
            key: key.name,
            allowed: key.allowed,
        }
    }

    fn refuse(&self, key: &Key, value: impl Display) -> ConfigError {
        let flag = match key.name {
            "law.strategy" if self.arguments.strategy.is_some() => Some("--strategy"),
            "law.np" if self.arguments.np.is_some() => Some("--np"),
            "cycle.clock" if self.arguments.clock.is_some() => Some("--clock"),
            _ => None,
        };
        ConfigError::Value {
            path: flag.map_or(self.path, |_| COMMAND_LINE).to_owned(),
            key: flag.unwrap_or(key.name).to_owned(),
            value: value.to_string(),
            allowed: key.allowed.to_owned(),
        }
    }

    fn number(&self, key: &Key, value: f64) -> Result<f64, ConfigError> {
        if key.admits(value) {
            Ok(value)
        } else {
            Err(self.refuse(key, value))
        }
    }

    /// Ranges of whole numbers are far from where floating point rounds them.
    fn integer(&self, key: &Key, value: i64) -> Result<i64, ConfigError> {
        if key.admits(value as f64) {
            Ok(value)
        } else {
            Err(self.refuse(key, value))
        }
    }

    fn word(&self, key: &Key, value: String) -> Result<String, ConfigError> {
        if key.allowed.split(", ").any(|word| word == value) {
            Ok(value)
        } else {
            Err(self.refuse(key, value))
        }
    }

    fn clock(&self, raw: &RawCycle) -> Result<ClockMode, ConfigError> {
        match raw.clock.as_str() {
            "fixed" => Ok(ClockMode::Fixed),
            "phase" => Ok(ClockMode::Phase),
            "lockstep" => Ok(ClockMode::Lockstep),
            other => Err(self.refuse(&keys::CLOCK, other)),
        }
    }

    fn realtime(&self, raw: &RawRealtime) -> Result<Option<RealtimeRequest>, ConfigError> {
        let integer = |key, value: Option<i64>| value.map(|x| self.integer(key, x)).transpose();
        let cpu = integer(&keys::CPU, raw.cpu)?.map(|cpu| cpu as usize);
        match integer(&keys::PRIORITY, raw.priority)? {
            Some(priority) => Ok(Some(RealtimeRequest {
                priority: priority as i32,
                cpu,
            })),
            None if cpu.is_some() => Err(ConfigError::Missing {
                path: self.path.to_owned(),
                key: keys::PRIORITY.name,
                allowed: "1 to 99, where realtime.cpu is given",
            }),
            None => Ok(None),
        }
    }

    fn safety(&self, raw: &RawSafety, clock: ClockMode) -> Result<Safety, ConfigError> {
        Ok(Safety {
            // No arm moves in lockstep, where time waits for the answer.
            armed: raw.armed.unwrap_or(clock == ClockMode::Lockstep),
            brake_s: self.number(&keys::BRAKE, raw.brake_s)?,
            lost_s: self.number(&keys::LOST, raw.lost_s)?,
        })
    }

    fn flight(&self, raw: RawFlight, domain: &Path) -> Result<FlightConfig, ConfigError> {
        // Beside the domain, not in it: the domain is cleared away with its last user.
        let beside = || {
            let mut name = domain.as_os_str().to_owned();
            name.push("-flight");
            PathBuf::from(name)
        };
        Ok(FlightConfig {
            minutes: self.number(&keys::MINUTES, raw.minutes)?,
            keep: self.integer(&keys::KEEP, raw.keep)? as usize,
            directory: raw.directory.unwrap_or_else(beside),
            at_exit: raw.at_exit,
        })
    }

    fn settings(&self, raw: &RawLaw) -> Result<Settings, ConfigError> {
        let strategy: Strategy = raw
            .strategy
            .parse()
            .map_err(|_| self.refuse(&keys::STRATEGY, &raw.strategy))?;
        let model = model(&raw.model).ok_or_else(|| self.refuse(&keys::MODEL, &raw.model))?;
        let iterations = self.integer(&keys::ITERATIONS, raw.iterations)?;
        let np = self.integer(&keys::NP, raw.np)?;
        let nc = self.integer(&keys::NC, raw.nc)?;
        if nc > np {
            return Err(self.refuse(&keys::NC, nc));
        }
        // The rest: a setting that the law may gain has its default until it gets a key here.
        #[allow(clippy::needless_update)]
        let settings = Settings {
            strategy,
            np: np as usize,
            nc: nc as usize,
            effort: vpc::solver::Effort {
                max_iterations: iterations as u32,
                tolerance: self.number(&keys::TOLERANCE, raw.tolerance)?,
            },
            model,
            trigger_px: self.number(&keys::TRIGGER, raw.trigger_px)?,
            release: self.number(&keys::RELEASE, raw.release)?,
            margin_px: self.number(&keys::MARGIN_PX, raw.margin_px)?,
            lambda: self.number(&keys::LAMBDA, raw.lambda)?,
            detour: raw.detour,
            delay_compensation: raw.delay_compensation,
            ..Settings::default()
        };
        // The law has the last word on its settings.
        settings.check().map_err(|error| ConfigError::Value {
            path: self.path.to_owned(),
            key: "law".to_owned(),
            value: error.to_string(),
            allowed: "what the law allows".to_owned(),
        })?;
        Ok(settings)
    }
}
