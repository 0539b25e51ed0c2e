//! The tables of a configuration file: every key with its default, range and meaning.

use std::path::PathBuf;

use messages::ClockMode;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use vpc::Settings;

use decision::Safety as Chosen;

/// Paths are relative to the file. A flag of the command line wins over the file.
#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "vpcd")]
pub struct Tables {
    /// The scene file: camera, pattern, goal, limits, occlusions. The control period is that of its
    /// `camera.rate_hz`.
    #[schemars(extend("x-allowed" = "a scene file, by the key `scene` or the flag --scene"))]
    pub scene: PathBuf,
    /// The memory of motion, made by `vpc-memory build` for exactly this scene. The strategies knn
    /// and gpr need one; foresight finds far more ways with one. It is opened whenever it is named,
    /// so that an operator can change the strategy later. Flag: --memory.
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
    /// With clock `phase`, a cycle begins this long after its features are expected.
    #[default = 1.0]
    #[schemars(range(min = 0, max = 20), extend("x-unit" = "ms"))]
    pub margin_ms: f64,
    /// Longest time that a command is valid without new features; at most 1 s or 3 periods, except
    /// in lockstep. A robot in real time obeys no command for longer than 100 ms.
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
    /// The same, following the camera's frames.
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
    /// Time in which a twist at the limits is braked to zero. Without limits of acceleration in the
    /// scene no command changes faster, and the law plans so; with them a brake may take longer. 0:
    /// at once. Without effect in lockstep.
    #[default(Chosen::default().brake_s)]
    #[schemars(range(min = 0, max = 0.15), extend("x-unit" = "s"))]
    pub brake_s: f64,
    /// Time without usable features, or without a message of the robot, after which the controller
    /// disarms; at least two periods more than `cycle.stale_periods`; without effect in lockstep.
    #[default(Chosen::default().lost_s)]
    #[schemars(range(min = 0.1, max = 10), extend("x-unit" = "s"))]
    pub lost_s: f64,
    /// Whether the camera stands still until a robot has told its state (`required`). A robot that
    /// was heard must go on telling it, and carry out what it is told, either way.
    #[schemars(extend("x-default" = "optional in lockstep, else required"))]
    pub robot: Option<Presence>,
    /// What the controller does from its arrival on: it follows the pattern (`follow`), stands
    /// until an operator arms (`hold`), or disarms (`disarm`).
    #[serde(with = "AfterArrival")]
    pub after_arrival: decision::AfterArrival,
}

/// What the controller does from the cycle after its arrival on.
#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "decision::AfterArrival", rename_all = "kebab-case")]
pub enum AfterArrival {
    /// It follows the pattern.
    Follow,
    /// It stands until an operator arms.
    Hold,
    /// It disarms.
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
    /// Directory of the domain, the same for camera, controller, robot and observers. Flag:
    /// --domain.
    #[schemars(extend("x-default" = "/tmp/vpc-UID, the user's number"))]
    pub domain: Option<PathBuf>,
}

/// Real-time scheduling.
#[derive(Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Realtime {
    /// SCHED_FIFO priority of the loop, which also locks the memory; without it the loop is an
    /// ordinary thread. `vpcd --preflight` lists what the machine lacks for it.
    #[schemars(range(min = 1, max = 99))]
    pub priority: Option<i32>,
    /// Processor to which the loop's thread is pinned; needs `realtime.priority`.
    #[schemars(range(min = 0, max = 1023))]
    pub cpu: Option<usize>,
}

/// The log: to the systemd journal if standard error is the journal, else to standard error.
#[derive(Deserialize, Serialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct Log {
    /// Least severity of what is logged.
    #[default = "info"]
    #[schemars(extend("enum" = ["off", "error", "warn", "info", "debug", "trace"]))]
    pub level: String,
    /// Format of lines on standard error.
    #[default = "text"]
    #[schemars(extend("enum" = ["text", "json"]))]
    pub format: String,
}

/// The flight record: the last minutes of the loop, kept in memory and written on a fault or on
/// request.
#[derive(Deserialize, Serialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields, default)]
pub struct Flight {
    /// Directory for flight records; created if it is missing.
    #[schemars(extend("x-default" = "the domain's name with `-flight`"))]
    pub directory: Option<PathBuf>,
    /// Time kept; must fit in a quarter of the machine's memory at the scene's rate.
    #[default = 5.0]
    #[schemars(range(min = 0.1, max = 60), extend("x-unit" = "min"))]
    pub minutes: f64,
    /// Number of newest files to keep.
    #[default = 10]
    #[schemars(range(min = 1, max = 1000), extend("x-unit" = "files"))]
    pub keep: usize,
    /// Whether a record is also written when the daemon ends.
    pub at_exit: bool,
}
