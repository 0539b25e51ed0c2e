//! The tables of a configuration file: every key with its default, range and meaning.

use std::path::PathBuf;

use messages::ClockMode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use vpc::Settings;

use decision::Safety as Chosen;

/// Paths are relative to the file. A flag wins over the file.
#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "vpcd")]
pub struct Tables {
    /// The scene; its `camera.rate_hz` is the control rate.
    #[schemars(extend("x-allowed" = "a file; also by --scene"))]
    pub scene: PathBuf,
    /// The memory of motion that `vpc-memory build` made for exactly this scene. knn and gpr need
    /// one; foresight mostly does without. Flag: --memory.
    pub memory: Option<PathBuf>,
    #[serde(default = "Settings::daemon")]
    pub law: Settings,
    #[serde(default)]
    pub cycle: Cycle,
    #[serde(default)]
    pub safety: Safety,
    #[serde(default)]
    pub ipc: Ipc,
    #[serde(default)]
    pub realtime: Realtime,
    #[serde(default)]
    pub log: Log,
    #[serde(default)]
    pub flight: Flight,
}

/// When a cycle runs.
#[derive(Deserialize, Serialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct Cycle {
    /// What starts a cycle. Flag: --clock.
    pub clock: Clock,
    /// With clock `phase`: delay from the expected features to the cycle's begin.
    #[default = 1.0]
    #[schemars(range(min = 0, max = 20), extend("x-unit" = "ms"))]
    pub margin_ms: f64,
    /// Validity of a command without new features; at most 1 s or 3 periods, except in lockstep. A
    /// robot in real time obeys no command longer than 100 ms.
    #[default(Chosen::default().stale_periods)]
    #[schemars(range(min = 2, max = 1000), extend("x-unit" = "periods"))]
    pub stale_periods: f64,
}

/// The values of `cycle.clock`.
#[derive(Clone, Copy, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Clock {
    /// The monotonic clock, at the scene's rate.
    #[default]
    Fixed,
    /// The same, aligned with the camera's frames.
    Phase,
    /// Each features message.
    Lockstep,
}

impl From<Clock> for ClockMode {
    fn from(clock: Clock) -> Self {
        match clock {
            Clock::Fixed => Self::Fixed,
            Clock::Phase => Self::Phase,
            Clock::Lockstep => Self::Lockstep,
        }
    }
}

/// When the supervisor arms, brakes and disarms.
#[derive(Deserialize, Serialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct Safety {
    /// Whether the controller starts armed. Flag: --arm.
    #[schemars(extend("x-default" = "true in lockstep, else false"))]
    pub armed: Option<bool>,
    /// Time to brake from the velocity limits to zero; 0: at once. The scene's limits of
    /// acceleration override it. No effect in lockstep.
    #[default(Chosen::default().brake_s)]
    #[schemars(range(min = 0, max = 0.15), extend("x-unit" = "s"))]
    pub brake_s: f64,
    /// Longest time for which the camera goes on while points are hidden; 0: it brakes at once.
    #[default(Chosen::default().blind_s)]
    #[schemars(range(min = 0, max = 1), extend("x-unit" = "s"))]
    pub blind_s: f64,
    /// Time without usable features or robot messages after which the controller disarms; at least
    /// two periods more than `cycle.stale_periods`. No effect in lockstep.
    #[default(Chosen::default().lost_s)]
    #[schemars(range(min = 0.1, max = 10), extend("x-unit" = "s"))]
    pub lost_s: f64,
    /// Whether motion waits for a first robot state. Either way, a robot that has sent one must
    /// keep sending and must execute the commands.
    #[schemars(extend("x-default" = "optional in lockstep, else required"))]
    pub robot: Option<Presence>,
    /// What the controller does from its arrival on.
    #[serde(with = "AfterArrival")]
    pub after_arrival: decision::AfterArrival,
}

/// What the controller does from the cycle after its arrival on.
#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "decision::AfterArrival", rename_all = "kebab-case")]
pub enum AfterArrival {
    /// Follow the pattern.
    Follow,
    /// Stand until an operator arms.
    Hold,
    /// Disarm.
    Disarm,
}

/// The values of `safety.robot`.
#[derive(Clone, Copy, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Presence {
    /// Nothing moves without it.
    Required,
    /// Something that says nothing may carry the camera.
    Optional,
}

/// The shared memory.
#[derive(Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ipc {
    /// Directory of the domain, the same for all programs. Flag: --domain.
    #[schemars(extend("x-default" = "/tmp/vpc-UID"))]
    pub domain: Option<PathBuf>,
}

/// Real-time scheduling.
#[derive(Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Realtime {
    /// SCHED_FIFO priority of the loop, with locked memory; none: an ordinary thread. `vpcd
    /// --preflight` lists what the machine lacks for it.
    #[schemars(range(min = 1, max = 99))]
    pub priority: Option<i32>,
    /// Processor of the loop; needs `realtime.priority`.
    #[schemars(range(min = 0, max = 1023))]
    pub cpu: Option<usize>,
}

/// The log goes to the systemd journal if standard error is the journal, else to standard error.
#[derive(Deserialize, Serialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct Log {
    /// Least severity that is logged.
    #[default = "info"]
    #[schemars(extend("enum" = ["off", "error", "warn", "info", "debug", "trace"]))]
    pub level: String,
    /// Format of lines on standard error.
    #[default = "text"]
    #[schemars(extend("enum" = ["text", "json"]))]
    pub format: String,
}

/// The flight record holds the loop's last minutes in memory; a fault or a request writes it.
#[derive(Deserialize, Serialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct Flight {
    /// Directory for flight records; created if missing.
    #[schemars(extend("x-default" = "the domain's name with `-flight`"))]
    pub directory: Option<PathBuf>,
    /// Time kept; must fit in a quarter of the machine's memory.
    #[default = 5.0]
    #[schemars(range(min = 0.1, max = 60), extend("x-unit" = "min"))]
    pub minutes: f64,
    /// Number of newest files to keep.
    #[default = 10]
    #[schemars(range(min = 1, max = 1000), extend("x-unit" = "files"))]
    pub keep: usize,
    /// Whether a record is also written at exit.
    pub at_exit: bool,
}
