//! Every key of a configuration: what the checks go by, what refusals say, and what `CONFIGURATION.md` is made from.

use scene::{Key, Kind};

pub(super) const SCENE: Key = Key::new(
    "scene",
    Kind::Path,
    "",
    "a scene file, by the key `scene` or the flag --scene",
    "camera, pattern, goal, limits, occlusions; the control period comes from its `camera.rate_hz` (--scene)",
);
pub(super) const MEMORY: Key = Key::new(
    "memory",
    Kind::Path,
    "none; knn and gpr need one",
    "a memory of motion for the strategies knn and gpr, by the key `memory` or the flag --memory",
    "made by `vpc-memory build` for exactly this scene; opened whenever it is named, so that an operator can change to knn and gpr later (--memory)",
);
pub(super) const STRATEGY: Key = Key::new(
    "law.strategy",
    Kind::Word,
    "\"previous\"",
    "previous, knn, knn2 to knn64, gpr, ibvs",
    "where warm start and target come from: the cycle before; the nearest sample of the memory, or the mean of so many; regression; or the classic law without prediction (--strategy)",
);
pub(super) const NP: Key = Key::integer(
    "law.np",
    "3",
    (1.0, vpc::MAX_NP as f64),
    "1 to 40",
    "steps previewed (--np)",
);
pub(super) const NC: Key = Key::integer(
    "law.nc",
    "1",
    (1.0, vpc::MAX_NC as f64),
    "1 to 4, at most np",
    "free commands in the preview",
);
pub(super) const ITERATIONS: Key = Key::integer(
    "law.iterations",
    "10",
    (1.0, 1000.0),
    "1 to 1000",
    "most iterations of the solver",
);
pub(super) const TOLERANCE: Key = Key::number(
    "law.tolerance",
    "1e-3",
    (1e-15, 1.0),
    "1e-15 to 1",
    "optimality at which the solver stops",
);
pub(super) const MODEL: Key = Key::new(
    "law.model",
    Kind::Word,
    "\"pose\"",
    "target-depth, area-depth, pose",
    "how features are predicted: with the depths of the goal (the paper), with depths from the area, or by the pose of the known pattern",
);
pub(super) const TRIGGER: Key = Key::number(
    "law.trigger_px",
    "20.0",
    (0.0, 1e4),
    "0 to 1e4 px",
    "the memory is asked when a feature comes this close to an occlusion",
);
pub(super) const RELEASE: Key = Key::number(
    "law.release",
    "2.0",
    (1.0, 100.0),
    "1 to 100",
    "... and until every feature is this many times further away",
);
pub(super) const MARGIN_PX: Key = Key::number(
    "law.margin_px",
    "0.0",
    (0.0, 1e3),
    "0 to 1e3 px",
    "extra clearance kept from every border",
);
pub(super) const LAMBDA: Key = Key::number(
    "law.lambda",
    "0.5",
    (1e-6, 100.0),
    "1e-6 to 100 per s",
    "gain of ibvs",
);
pub(super) const DETOUR: Key = Key::new(
    "law.detour",
    Kind::Switch,
    "true",
    "true, false",
    "whether a stall beside an occlusion is left by a detour over a sample of the memory (knn, gpr)",
);
pub(super) const DELAY_COMPENSATION: Key = Key::new(
    "law.delay_compensation",
    Kind::Switch,
    "true",
    "true, false",
    "whether features are advanced from their exposure to now by the commands sent since",
);
pub(super) const CLOCK: Key = Key::new(
    "cycle.clock",
    Kind::Word,
    "\"fixed\"",
    "fixed, phase, lockstep",
    "what starts a cycle: a grid in time at the scene's rate; the same grid, following the camera's frames; or each features message (--clock)",
);
pub(super) const MARGIN_MS: Key = Key::number(
    "cycle.margin_ms",
    "1.0",
    (0.0, 20.0),
    "0 to 20 ms",
    "clock phase: a cycle begins this long after its features are expected",
);
pub(super) const STALE: Key = Key::number(
    "cycle.stale_periods",
    "3.0",
    (2.0, 1000.0),
    "2 to 1000 periods",
    "longest time that a command stands without new features",
);
pub(super) const ARMED: Key = Key::new(
    "safety.armed",
    Kind::Switch,
    "true in lockstep, else false",
    "true, false",
    "whether the controller starts armed; in lockstep no arm moves (--arm)",
);
pub(super) const BRAKE: Key = Key::number(
    "safety.brake_s",
    "0.15",
    (0.0, 0.15),
    "0 to 0.15 s",
    "time in which a twist at the limits is braked to zero; not in lockstep",
);
pub(super) const LOST: Key = Key::number(
    "safety.lost_s",
    "0.3",
    (0.1, 10.0),
    "0.1 to 10 s",
    "time without usable features, or without a word of the robot, after which the camera is disarmed; at least cycle.stale_periods and two periods; not in lockstep",
);
pub(super) const DOMAIN: Key = Key::new(
    "ipc.domain",
    Kind::Path,
    "/tmp/vpc-UID, the user's number",
    "a directory",
    "of the shared memory, the same for everybody who is to meet (--domain)",
);
pub(super) const PRIORITY: Key = Key::integer(
    "realtime.priority",
    "none: an ordinary thread",
    (1.0, 99.0),
    "1 to 99",
    "SCHED_FIFO priority of the loop, and locked memory; `vpcd --preflight` tells what the machine lacks for it",
);
pub(super) const CPU: Key = Key::integer(
    "realtime.cpu",
    "none: any",
    (0.0, 1023.0),
    "0 to 1023",
    "processor that the loop's thread stays on; needs realtime.priority",
);
pub(super) const LEVEL: Key = Key::new(
    "log.level",
    Kind::Word,
    "\"info\"",
    "off, error, warn, info, debug, trace",
    "least weight of what is logged, to the journal or standard error",
);
pub(super) const FORMAT: Key = Key::new(
    "log.format",
    Kind::Word,
    "\"text\"",
    "text, json",
    "of the log on standard error",
);
pub(super) const DIRECTORY: Key = Key::new(
    "flight.directory",
    Kind::Path,
    "the domain's name with `-flight`",
    "a directory",
    "where flight records are written; made where it is missing",
);
pub(super) const MINUTES: Key = Key::number(
    "flight.minutes",
    "5.0",
    (0.1, 60.0),
    "0.1 to 60 min",
    "time kept in memory, at the scene's rate; 1.6 KB a cycle, in all at most a quarter of the machine's memory",
);
pub(super) const KEEP: Key = Key::integer(
    "flight.keep",
    "10",
    (1.0, 1000.0),
    "1 to 1000 files",
    "files kept, the newest",
);
pub(super) const AT_EXIT: Key = Key::new(
    "flight.at_exit",
    Kind::Switch,
    "false",
    "true, false",
    "whether a record is written when the daemon ends, too",
);

/// Every key of a configuration of `vpcd`, in the order of `vpcd.toml`.
pub const KEYS: &[Key] = &[
    SCENE,
    MEMORY,
    STRATEGY,
    NP,
    NC,
    ITERATIONS,
    TOLERANCE,
    MODEL,
    TRIGGER,
    RELEASE,
    MARGIN_PX,
    LAMBDA,
    DETOUR,
    DELAY_COMPENSATION,
    CLOCK,
    MARGIN_MS,
    STALE,
    ARMED,
    BRAKE,
    LOST,
    DOMAIN,
    PRIORITY,
    CPU,
    LEVEL,
    FORMAT,
    DIRECTORY,
    MINUTES,
    KEEP,
    AT_EXIT,
];
