//! The tables of a configuration as TOML has them, with their defaults, before any check.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use vpc::Settings;

use super::model_name;
use crate::arguments::Arguments;

#[derive(Deserialize, Serialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Raw {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<PathBuf>,
    pub law: RawLaw,
    pub cycle: RawCycle,
    pub safety: RawSafety,
    pub ipc: RawIpc,
    pub realtime: RawRealtime,
    pub log: RawLog,
    pub flight: RawFlight,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawFlight {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub directory: Option<PathBuf>,
    pub minutes: f64,
    pub keep: i64,
    pub at_exit: bool,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawLaw {
    pub strategy: String,
    pub np: i64,
    pub nc: i64,
    pub iterations: i64,
    pub tolerance: f64,
    pub model: String,
    pub trigger_px: f64,
    pub release: f64,
    pub margin_px: f64,
    pub lambda: f64,
    pub detour: bool,
    pub delay_compensation: bool,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawCycle {
    pub clock: String,
    pub stale_periods: f64,
    pub margin_ms: f64,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawSafety {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub armed: Option<bool>,
    pub brake_s: f64,
    pub lost_s: f64,
}

#[derive(Deserialize, Serialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawIpc {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub domain: Option<PathBuf>,
}

#[derive(Deserialize, Serialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawRealtime {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub priority: Option<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu: Option<i64>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RawLog {
    pub level: String,
    pub format: String,
}

impl Default for RawLaw {
    fn default() -> Self {
        let settings = Settings::default();
        Self {
            strategy: settings.strategy.to_string(),
            np: settings.np as i64,
            nc: settings.nc as i64,
            iterations: i64::from(settings.solver.max_iterations),
            tolerance: settings.solver.tolerance,
            model: model_name(settings.model).to_owned(),
            trigger_px: settings.trigger_px,
            release: settings.hysteresis,
            margin_px: settings.margin_px,
            lambda: settings.lambda,
            detour: settings.detour,
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

impl Raw {
    /// Lays the flags of the command line over the file's values.
    pub(super) fn lay_over(&mut self, arguments: &Arguments) {
        let flags = arguments.clone();
        self.scene = flags.scene.or(self.scene.take());
        self.memory = flags.memory.or(self.memory.take());
        self.ipc.domain = flags.domain.or(self.ipc.domain.take());
        if let Some(strategy) = flags.strategy {
            self.law.strategy = strategy;
        }
        if let Some(np) = flags.np {
            self.law.np = np;
        }
        if let Some(clock) = flags.clock {
            self.cycle.clock = clock;
        }
        if flags.arm {
            self.safety.armed = Some(true);
        }
    }
}
