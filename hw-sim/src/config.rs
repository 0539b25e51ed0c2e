//! Configuration of the process: a file, then flags, then checks. A key and its flag are one
//! declaration.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{ArgMatches, Args, Parser, ValueEnum};
use fci::Version;
use markers::Family;
use panda::Model;
use scene::{Pose, Scene, read_starts};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml_schema::{Document, FileError};

use crate::eye::Sight;
use crate::motion::{HELP, Motion, MotionKeys};
use crate::rig::RigSettings;
use crate::robot::calibration::HandEye;
use crate::robot::control_unit::FciSettings;
use crate::robot::described;
use crate::robot::truth::Truth;
use crate::sensor::Flaws;

/// Emulates the camera of a scene, and what carries it, behind shared memory.
///
/// Publishes features, executes the twists that answer them, and judges the run. Says its verdict
/// on standard error, and prints it as one JSON line where standard output is no terminal. Exit
/// codes: 0 arrived, 1 not arrived, 64 usage, 66 a file is missing, 69 another camera is at work or
/// nobody answers, 78 configuration.
#[derive(Parser, Debug)]
#[command(name = "hw-sim", version, allow_negative_numbers = true)]
pub struct Arguments {
    /// Configuration file (TOML), documented in hw-sim/hw-sim.toml; flags win over it.
    #[arg(long)]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub keys: Keys,
    /// Run every start from that one on, one after another, each as a new run.
    #[arg(long, conflicts_with = "record")]
    pub all: bool,
    /// Begin again after the last start, until stopped; between two runs the camera rests at the
    /// goal.
    #[arg(long = "loop", conflicts_with = "record")]
    pub repeat: bool,
    /// Show a line of progress.
    #[arg(long)]
    pub progress: bool,
    /// Print each verdict as a JSON line also where standard output is a terminal.
    #[arg(long)]
    pub json: bool,
    /// Robot: send the 30 Hz staircase to the robot as it is, to see what it says.
    #[arg(long)]
    pub unshaped: bool,
}

/// Paths are relative to the file. Most keys have a flag, which wins over the file.
#[derive(Args, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(title = "hw-sim", extend("required" = ["scene", "starts"]))]
pub struct Keys {
    /// The scene.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a file; also by --scene"))]
    pub scene: Option<PathBuf>,
    /// Start poses of the object in the camera frame (CSV: tx,ty,tz,rx,ry,rz).
    #[arg(long)]
    #[schemars(extend("x-allowed" = "a file; also by --starts"))]
    pub starts: Option<PathBuf>,
    /// Index of the start in `starts`.
    #[arg(long, default_value_t = 0)]
    #[schemars(extend("x-allowed" = "0 to the number of starts less one"))]
    pub start: u32,
    /// What paces the frames.
    #[arg(long, value_enum, default_value_t)]
    pub clock: Clock,
    /// Directory of the domain.
    #[arg(long)]
    #[schemars(extend("x-default" = "/tmp/vpc-UID"))]
    pub domain: Option<PathBuf>,
    /// File that records each frame as a JSON line.
    #[arg(long)]
    pub record: Option<PathBuf>,
    /// Standard deviation of each pixel coordinate.
    #[arg(long = "noise", default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 100), extend("x-unit" = "px"))]
    pub noise_px: f64,
    /// Frames between exposure and delivery; not with a robot.
    #[arg(long = "delay", default_value_t = 0)]
    #[schemars(range(min = 0, max = 100), extend("x-unit" = "frames"))]
    pub delay_frames: u32,
    /// Probability that a frame is lost.
    #[arg(long, default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 1))]
    pub drop: f64,
    /// Free camera: probability that a frame does not show one of its points.
    #[arg(long, default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 1))]
    pub hide: f64,
    /// Free camera: once, in the first two seconds, frames show no point for so long.
    #[arg(long, default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 60), extend("x-unit" = "s"))]
    pub blackout_s: f64,
    /// Seed of noise and losses.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Seconds until the run ends.
    #[arg(long = "time-limit")]
    #[schemars(range(min = 0.1, max = 86400), extend("x-unit" = "s", "x-default" = "the scene's time"))]
    pub time_limit_s: Option<f64>,
    /// How the pattern moves.
    #[arg(long, value_name = "KIND:NUMBERS", help = HELP)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 8))]
    pub motion: Vec<MotionKeys>,
    /// From a second after the arrival, time in which the following is measured.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 3600), extend("x-unit" = "s"))]
    pub follow_s: f64,
    /// What carries the camera.
    #[arg(long, value_enum, default_value_t)]
    pub robot: Body,
    /// Robot: what the camera sends.
    #[arg(long, value_enum, default_value_t)]
    pub camera: Sight,
    /// Rendered: family of the tags, by OpenCV's name.
    #[arg(long, default_value_t)]
    #[schemars(extend("x-allowed" = "as vpc-camera's"))]
    pub family: Family,
    /// Robot: time from the middle of an exposure to its delivery.
    #[arg(long, default_value_t = 110.0)]
    #[schemars(range(min = 0, max = 900), extend("x-unit" = "ms"))]
    pub latency_ms: f64,
    /// Robot: deviation of the latency to either side; at most the latency.
    #[arg(long, default_value_t = 0.0)]
    #[schemars(range(min = 0, max = 900), extend("x-unit" = "ms"))]
    pub jitter_ms: f64,
    /// Robot: exposure of a row.
    #[arg(long, default_value_t = 6.0)]
    #[schemars(range(min = 0, max = 33), extend("x-unit" = "ms"))]
    pub exposure_ms: f64,
    /// Robot: time from the first row to the last of a rolling shutter, when rendered.
    #[arg(long, default_value_t = 15.0)]
    #[schemars(range(min = 0, max = 33), extend("x-unit" = "ms"))]
    pub readout_ms: f64,
    /// Robot: time at the goal before the release.
    #[arg(long, default_value_t = 0.5)]
    #[schemars(range(min = 0, max = 60), extend("x-unit" = "s"))]
    pub dwell_s: f64,
    /// Robot: distance of the retreat.
    #[arg(long, default_value_t = 0.04)]
    #[schemars(range(min = 0, max = 0.3), extend("x-unit" = "m"))]
    pub retreat_m: f64,
    /// Panda: address of the vendor's interface (FCI), whose clients the robot obeys instead of
    /// `vpc/twist`.
    #[arg(long)]
    #[schemars(extend("x-allowed" = "an address and a port, such as 127.0.0.1:1337"))]
    pub fci: Option<SocketAddr>,
    /// Version of the FCI: 5 (Panda) or 10 (FR3).
    #[arg(long, default_value_t = 5)]
    #[schemars(range(min = 5, max = 10))]
    pub fci_version: u16,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub hand_eye: HandEye,
    #[arg(skip)]
    #[allow(missing_docs)]
    pub truth: Truth,
}

impl Default for Keys {
    /// The defaults of the flags.
    fn default() -> Self {
        Arguments::parse_from(["hw-sim"]).keys
    }
}

/// What carries the camera.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Body {
    /// The camera moves exactly as commanded, at once.
    #[default]
    Free,
    /// A Franka Panda behind its 1 kHz velocity interface.
    Panda,
    /// The arm that the scene names.
    Urdf,
}

impl Body {
    /// Whether a robot carries the camera.
    pub fn is_robot(self) -> bool {
        self != Self::Free
    }
}

/// What paces the frames.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// The camera's rate on the monotonic clock.
    #[default]
    Fixed,
    /// A frame for each answer; with `fci`, a millisecond for each command of the client.
    Lockstep,
}

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The scene.
    pub scene: Scene,
    /// Its file, for messages and recordings.
    pub scene_file: String,
    /// Where the object is at first, run after run, with the number of each start.
    pub starts: Vec<(usize, Pose)>,
    /// Whether to begin again after the last of them.
    pub repeat: bool,
    /// Which clock paces the run.
    pub clock: Clock,
    /// Directory of the domain.
    pub domain: PathBuf,
    /// Where to record.
    pub record: Option<PathBuf>,
    /// Flaws of the camera.
    pub flaws: Flaws,
    /// How the pattern moves, from the begin of a run on.
    pub motion: Motion,
    /// How long the following is measured after the arrival, s; 0: the run ends there.
    pub follow_s: f64,
    /// Whether to show progress.
    pub progress: bool,
    /// Whether to print JSON on a terminal, too.
    pub json: bool,
    /// What carries the camera.
    pub robot: Body,
    /// The robot's cell, where a robot does; its time limit is that of every carrier.
    pub rig: RigSettings,
}

/// The vendor's interface, and what it does not go with.
fn fci(
    document: &Document,
    keys: &Keys,
    arguments: &Arguments,
) -> Result<Option<FciSettings>, FileError> {
    let Some(address) = keys.fci else {
        return Ok(None);
    };
    let version = keys.fci_version.to_string().parse();
    let version = version
        .map_err(|_| document.refuse("fci_version", keys.fci_version, "5 or 10".to_owned()))?;
    let needs = |is_met: bool, what: &str| match is_met {
        true => Ok(()),
        false => Err(document.refuse("fci", address, format!("with {what} only"))),
    };
    needs(keys.robot == Body::Panda, "robot = \"panda\"")?;
    needs(
        !arguments.all && !arguments.repeat,
        "one start: without --all and --loop",
    )?;
    needs(
        !arguments.unshaped,
        "commands of a client: without --unshaped",
    )?;
    Ok(Some(FciSettings {
        address,
        version,
        desk_decimals: keys.truth.desk_decimals,
        is_lockstep: keys.clock == Clock::Lockstep,
    }))
}

/// Returns the JSON Schema of a configuration file.
pub fn schema() -> serde_json::Value {
    toml_schema::schema::<Keys>()
}

impl Config {
    /// Reads the file that the command line names, lays the flags over it, and checks the whole.
    ///
    /// # Errors
    /// [`FileError`] names the file or flag, key, value and what is allowed.
    pub fn load(matches: &ArgMatches) -> Result<Self, FileError> {
        let arguments: Arguments = toml_schema::arguments(matches)?;
        let (file, paths) = (arguments.config.as_deref(), ["scene", "starts"]);
        let document = Document::with_flags::<Arguments>(file, &paths, &arguments.keys, matches)?;
        let keys: Keys = document.check()?;
        document.readable(&paths)?;
        Self::of(&document, keys, &arguments)
    }

    fn of(document: &Document, keys: Keys, arguments: &Arguments) -> Result<Self, FileError> {
        let fci = fci(document, &keys, arguments)?;
        let (scene_path, starts_path) = (
            keys.scene.unwrap_or_default(),
            keys.starts.unwrap_or_default(),
        );
        let scene = Scene::read(&scene_path)?;
        let starts = read_starts(&starts_path)?;
        if keys.start as usize >= starts.len() {
            let allowed = format!("0 to {} ({})", starts.len() - 1, starts_path.display());
            return Err(document.refuse("start", keys.start, allowed));
        }
        let many = if arguments.all { usize::MAX } else { 1 };
        let starts = starts
            .into_iter()
            .enumerate()
            .skip(keys.start as usize)
            .take(many);
        if keys.jitter_ms > keys.latency_ms {
            let allowed = format!("0 to {} ms, the latency", keys.latency_ms);
            return Err(document.refuse("jitter_ms", keys.jitter_ms, allowed));
        }
        if keys.camera == Sight::Rendered {
            let refuse = |allowed: &str| document.refuse("camera", "rendered", allowed.to_owned());
            if !keys.robot.is_robot() {
                return Err(refuse("ideal; rendered with robot = \"panda\" or \"urdf\""));
            }
            if scene.marker_size <= 0.0 {
                return Err(refuse(
                    "ideal; rendered where the scene gives pattern.marker_size",
                ));
            }
        }
        if !keys.truth.lens(&scene).is_invertible() {
            let allowed = "a lens that shows no point of the image twice";
            let found = format!("{:?}", keys.truth.distortion);
            return Err(document.refuse("truth.distortion", found, allowed));
        }
        if keys.robot.is_robot() && keys.delay_frames > 0 {
            let allowed = "0 with a robot, whose camera has latency_ms";
            return Err(document.refuse("delay_frames", keys.delay_frames, allowed));
        }
        for (key, value) in [("hide", keys.hide), ("blackout_s", keys.blackout_s)] {
            if keys.robot.is_robot() && value > 0.0 {
                return Err(document.refuse(key, value, "0 with a robot"));
            }
        }
        for (index, motion) in keys.motion.iter().enumerate() {
            if let Some((key, value, allowed)) = motion.stray() {
                return Err(document.refuse(&format!("motion[{index}].{key}"), value, allowed));
            }
        }
        let flaws = Flaws {
            noise_px: keys.noise_px,
            delay_frames: keys.delay_frames as usize,
            drop: keys.drop,
            hide: keys.hide,
            blackout_s: keys.blackout_s,
            seed: keys.seed,
        };
        let mut rig = RigSettings::new(&scene);
        rig.is_live = keys.clock == Clock::Fixed;
        rig.time_limit_s = keys.time_limit_s.unwrap_or(scene.success.time_s);
        let ns = |ms: f64| (ms * 1e6).round() as u64;
        rig.sequence.dwell_ns = ns(keys.dwell_s * 1e3);
        rig.sequence.retreat_m = keys.retreat_m;
        match (keys.robot, &scene.arm) {
            (Body::Urdf, None) => {
                let allowed = "urdf with a scene whose key `arm` names one";
                return Err(document.refuse("robot", "urdf", allowed));
            }
            (Body::Urdf, Some(_)) if keys.hand_eye != HandEye::default() => {
                let allowed = "none with robot = \"urdf\": the arm file has the camera";
                let found = format!("{:?}", keys.hand_eye);
                return Err(document.refuse("hand_eye", found, allowed));
            }
            (Body::Urdf, Some(arm)) => rig.arm = described::settings(arm, &scene.goal),
            _ => rig.arm.hand_eye = keys.hand_eye,
        }
        rig.arm.truth = keys.truth;
        rig.arm.fci = fci;
        if fci.is_some_and(|fci| fci.version == Version::V10) {
            rig.arm.robot.model = Model::Fr3;
        }
        if arguments.unshaped {
            rig.arm.is_shaped = false;
        }
        let eye = &mut rig.eye;
        eye.family = keys.family;
        (eye.sight, eye.noise_px, eye.seed) = (keys.camera, flaws.noise_px, flaws.seed);
        (eye.exposure_ns, eye.readout_ns) = (ns(keys.exposure_ms), ns(keys.readout_ms));
        (eye.latency.latency_ns, eye.latency.jitter_ns) = (ns(keys.latency_ms), ns(keys.jitter_ms));
        (eye.latency.drop, eye.latency.seed) = (flaws.drop, flaws.seed);
        Ok(Self {
            scene_file: scene_path.display().to_string(),
            starts: starts.collect(),
            repeat: arguments.repeat,
            clock: keys.clock,
            domain: keys.domain.unwrap_or_else(ipc::default_directory),
            record: keys.record,
            flaws,
            motion: Motion::new(&keys.motion),
            follow_s: keys.follow_s,
            progress: arguments.progress,
            json: arguments.json,
            robot: keys.robot,
            rig,
            scene,
        })
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn load(text: &str) -> Result<Config, String> {
        let directory = tempfile::TempDir::new().unwrap();
        let file = directory.path().join("hw-sim.toml");
        let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../ipc/scene/scenes/");
        let base = format!(
            "scene = \"{scenes}paper-sim.toml\"\nstarts = \"{scenes}paper-sim-starts.csv\"\n"
        );
        std::fs::write(&file, base + text).unwrap();
        let matches = Arguments::command().get_matches_from([
            "hw-sim".as_ref(),
            "--config".as_ref(),
            file.as_os_str(),
        ]);
        Config::load(&matches).map_err(|e| e.to_string())
    }

    #[test]
    fn flags_win_over_the_file_only_where_they_are_given() {
        let directory = tempfile::TempDir::new().unwrap();
        let file = directory.path().join("hw-sim.toml");
        let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../ipc/scene/scenes/paper-sim");
        let text = format!(
            "scene = \"{scenes}.toml\"\nstarts = \"{scenes}-starts.csv\"\nseed = 7\nnoise_px = 0.5\n"
        );
        std::fs::write(&file, text).unwrap();
        let load = |flags: &[&str]| {
            let given = ["hw-sim", "--config", file.to_str().unwrap()];
            let given = given.iter().chain(flags);
            Config::load(&Arguments::command().get_matches_from(given))
        };
        // The seed's default is given as a flag, and the noise is not.
        let config = load(&["--seed", "1"]).unwrap();
        assert_eq!((config.flaws.seed, config.flaws.noise_px), (1, 0.5));
        let message = load(&["--noise", "101"]).unwrap_err().to_string();
        assert_eq!(message, "command line: --noise = 101; allowed: 0 to 100 px");
    }

    #[test]
    fn the_defaults_are_the_scenes() {
        let config = load("").unwrap();
        assert_eq!(
            (config.clock, config.rig.time_limit_s),
            (Clock::Fixed, 15.0)
        );
        assert_eq!(
            config.flaws,
            Flaws {
                seed: 1,
                ..Flaws::default()
            }
        );
    }

    #[test]
    fn motions_come_from_the_file_or_from_flags() {
        let text = "follow_s = 5.0\n[[motion]]\nkind = \"circle\"\nradius_m = 0.05\nspeed_m_s = 0.1\n\
                    [[motion]]\nkind = \"conveyor\"\nturn_rad_s = 0.2\n";
        let config = load(text).unwrap();
        let flags = ["circle:0.05:0.1", "turn:0.2"].map(|text| text.parse().unwrap());
        assert_eq!(config.motion, Motion::new(&flags));
        assert_eq!(config.follow_s, 5.0);
        assert!(load("").unwrap().motion.is_rest());
        let directory = tempfile::TempDir::new().unwrap();
        let file = directory.path().join("hw-sim.toml");
        let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../ipc/scene/scenes/paper-sim");
        let base = format!("scene = \"{scenes}.toml\"\nstarts = \"{scenes}-starts.csv\"\n");
        std::fs::write(&file, base + text).unwrap();
        let given = ["hw-sim", "--config", file.to_str().unwrap()];
        let given = given.into_iter().chain(["--motion", "push:2:0.03"]);
        let config = Config::load(&Arguments::command().get_matches_from(given)).unwrap();
        let push = "push:2:0.03".parse().unwrap();
        assert_eq!(
            (config.motion, config.follow_s),
            (Motion::new(&[push]), 5.0)
        );
    }

    #[test]
    fn calibration_and_truth_reach_the_cell() {
        let config = load(
            "robot = \"panda\"\nlatency_ms = 50.0\nnoise_px = 0.3\n[hand_eye]\ntranslation = [0.1, 0.0, 0.0]\n\
             rotation_deg = [0.0, 0.0, 90.0]\n[truth]\nhand_eye_m = [0.0, 0.01, 0.0]\ndepth = 0.1\n",
        )
        .unwrap();
        assert_eq!(config.robot, Body::Panda);
        let rig = config.rig;
        assert_eq!(rig.arm.hand_eye.translation, [0.1, 0.0, 0.0]);
        assert_eq!(rig.arm.truth.depth, 0.1);
        assert_eq!(
            (rig.eye.latency.latency_ns, rig.eye.noise_px),
            (50_000_000, 0.3)
        );
        // One centimetre along the camera's y axis, which is the flange's -x here.
        let believed = rig.arm.hand_eye.flange_from_camera();
        let mount = rig.arm.truth.flange_from_camera(&believed);
        assert!((mount.translation.vector - nalgebra::Vector3::new(0.09, 0.0, 0.0)).norm() < 1e-12);
        assert_eq!(load("").unwrap().rig.arm.truth, Truth::default());
    }

    #[test]
    fn refusals_name_key_value_and_range() {
        for (text, words) in [
            ("noise_px = nan", ["noise_px", "NaN", "0 to 100"]),
            ("drop = 1.5", ["drop", "1.5", "0 to 1"]),
            ("start = 100", ["start", "100", "0 to 99"]),
            (
                "time_limit_s = -1.0",
                ["time_limit_s", "-1", "0.1 to 86400"],
            ),
            ("speed = 1", ["speed", "unknown field", "delay_frames"]),
            ("clock = \"slow\"", ["clock", "slow", "lockstep"]),
            ("robot = \"kuka\"", ["robot", "kuka", "panda"]),
            ("robot = \"urdf\"", ["robot", "urdf", "`arm`"]),
            ("latency_ms = 1e4", ["latency_ms", "10000", "0 to 900"]),
            ("jitter_ms = 111.0", ["jitter_ms", "111", "0 to 110"]),
            (
                "[truth]\nfocal = 0.9",
                ["truth.focal", "0.9", "-0.5 to 0.5"],
            ),
            (
                "[truth]\ndesk_decimals = 16",
                ["truth.desk_decimals", "16", "0 to 15"],
            ),
            ("[truth]\ngloss = 256.0", ["truth.gloss", "256", "0 to 255"]),
            (
                "[truth]\nsharpening = -0.1",
                ["truth.sharpening", "-0.1", "0 to 5"],
            ),
            ("[truth]\ndemosaic = 1", ["demosaic", "1", "boolean"]),
            (
                "[truth]\nhand_eye_m = [0.0, nan, 0.0]",
                ["truth.hand_eye_m", "NaN", "-0.2 to 0.2"],
            ),
            (
                "[truth]\ndistortion = [-0.9, 0.0, 0.0, 0.0, 0.0]",
                ["truth.distortion", "-0.9", "twice"],
            ),
            (
                "robot = \"panda\"\ncamera = \"rendered\"",
                ["camera = rendered", "ideal", "pattern.marker_size"],
            ),
            (
                "camera = \"rendered\"",
                ["camera = rendered", "ideal", "robot = \"panda\""],
            ),
            (
                "[[motion]]\nkind = \"circle\"\nspeed_m_s = 3.0",
                ["motion[0].speed_m_s", "3", "0 to 1 m/s"],
            ),
            (
                "[[motion]]\nkind = \"spin\"",
                ["motion[0].kind", "spin", "conveyor, circle"],
            ),
            (
                "[[motion]]\nkind = \"hand\"\nby_m = [0.1, 0.0, 0.0]",
                ["motion[0].by_m", "[0.1,0.0,0.0]", "bandwidth_hz"],
            ),
            (
                "[[motion]]\nkind = \"push\"\nby_m = [0.1, 2.0, 0.0]",
                ["motion[0].by_m", "2", "-1 to 1 m"],
            ),
            ("follow_s = -1.0", ["follow_s", "-1", "0 to 3600 s"]),
            (
                "robot = \"panda\"\nhide = 0.3",
                ["hide", "0.3", "0 with a robot"],
            ),
            (
                "robot = \"panda\"\nblackout_s = 0.5",
                ["blackout_s", "0.5", "0 with a robot"],
            ),
            (
                "robot = \"panda\"\ndelay_frames = 3",
                ["delay_frames", "3", "latency_ms"],
            ),
        ] {
            let message = load(text).unwrap_err();
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}
