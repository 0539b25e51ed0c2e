//! Flags of `cargo table`, which are keywords in Python.

use std::fmt::Display;
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};
use hw_sim::motion::{HELP, Motion, MotionKeys};
use hw_sim::robot::truth::Truth;
use hw_sim::sensor::Flaws;
use scene::Scene;
use toml::Value;
use toml_schema::{Document, FileError};
use vpc::Settings;

use crate::run::World;
use crate::spec::Spec;

/// Settings of the law, and errors of the camera.
#[derive(Args, Clone, Debug)]
pub struct Common {
    /// Strategies with their preview windows: previous, knn, knn2 to knn64, gpr,
    /// foresight, ibvs.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "ibvs,previous:3,previous:30,knn:3,gpr:3,foresight:3"
    )]
    pub strategies: Vec<Spec>,
    /// Use late features as they are, without compensating the delay.
    #[arg(long)]
    pub no_compensation: bool,
    /// Pixel noise, standard deviation, px.
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    pub noise: f64,
    /// Probability that a frame is lost.
    #[arg(long, value_name = "P", default_value_t = 0.0)]
    pub drop: f64,
    /// The law believes that pattern and goal are 1 + E times as large and as far as they are.
    #[arg(
        long,
        value_name = "E",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub depth_error: f64,
    /// The law believes that the pattern stands still.
    #[arg(long)]
    pub no_drift: bool,
    /// How the pattern moves.
    #[arg(long, value_name = "KIND:NUMBERS", help = HELP)]
    pub motion: Vec<MotionKeys>,
    /// From a second after the arrival, measure for so long how well the camera follows.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    pub follow_s: f64,
    /// Seed of noise and losses; each start adds its index.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Constraints hold at the sampling instants only, as in the paper.
    #[arg(long)]
    pub at_samples_only: bool,
    /// Rate of the camera instead of the scene's, Hz.
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
    /// Keys of the law.
    #[command(flatten)]
    pub law: LawFlags,
    /// Time in which the command goes from zero to its limits, s, where the scene gives no limits
    /// of acceleration: 0.15 as `vpcd` has it on a real clock; 0: at once, as in the paper.
    #[arg(long, value_name = "S", default_value_t = Settings::default().brake_s)]
    pub brake_s: f64,
}

/// The keys of the law that are flags of `cargo table`, too, each with its flag.
const KEYS: [(&str, &str); 6] = [
    ("model", "model"),
    ("change_share", "change-share"),
    ("filter_s", "filter-s"),
    ("filter_px", "filter-px"),
    ("step_s", "step-s"),
    ("foresight_steps", "foresight-steps"),
];

/// The law's settings as flags. The declaration of a key gives the flag's meaning, default and
/// range.
#[derive(Clone, Copy, Debug)]
pub struct LawFlags(Settings);

impl Args for LawFlags {
    fn augment_args(command: Command) -> Command {
        let schema = toml_schema::schema::<Settings>();
        KEYS.into_iter().fold(command, |command, (key, flag)| {
            let meaning = schema["properties"][key]["description"].as_str();
            let default = &schema["properties"][key]["default"];
            let help = format!("{} [default: {default}]", meaning.unwrap_or_default());
            command.arg(Arg::new(key).long(flag).help(help))
        })
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for LawFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let refused = |error: FileError| clap::Error::raw(ErrorKind::ValueValidation, error);
        let mut document = Document::read(None).map_err(refused)?;
        for (key, flag) in KEYS {
            let value = matches.get_one::<String>(key).map(|text| {
                let number = text.parse().map(Value::Integer);
                let number = number.or_else(|_| text.parse().map(Value::Float));
                number.unwrap_or_else(|_| Value::String(text.clone()))
            });
            document.set(key, &format!("--{flag}"), value);
        }
        document.check().map(Self).map_err(refused)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Common {
    /// The law's settings for one of the strategies.
    pub fn settings(&self, spec: Spec) -> Settings {
        Settings {
            strategy: spec.strategy,
            np: spec.np,
            delay_compensation: !self.no_compensation,
            drift_compensation: !self.no_drift,
            intersample: !self.at_samples_only,
            brake_s: self.brake_s,
            ..self.law.0
        }
    }

    /// The scene as the law of a free camera believes it to be: the same images, from pattern and
    /// goal of another size.
    pub fn believed(&self, scene: &Scene) -> Scene {
        let wrong = Truth {
            depth: self.depth_error,
            ..Truth::default()
        };
        wrong.scene(scene)
    }

    /// How the pattern moves.
    pub fn motion(&self) -> Motion {
        Motion::new(&self.motion)
    }

    /// Whether the table shows how well the camera follows.
    pub fn is_following(&self) -> bool {
        self.follow_s > 0.0
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names flag, value and range.
    pub fn check(&self) -> anyhow::Result<()> {
        check("--noise", self.noise, 0.0, 100.0)?;
        check("--drop", self.drop, 0.0, 1.0)?;
        check("--follow-s", self.follow_s, 0.0, 3600.0)?;
        check("--brake-s", self.brake_s, 0.0, 10.0)?;
        check("--rate", self.rate.unwrap_or(30.0), 1.0, 1000.0)?;
        check("--depth-error", self.depth_error, -0.9, 9.0)
    }
}

/// The camera that flies freely.
#[derive(Args, Clone, Debug)]
pub struct FreeFlags {
    /// Frames between exposure and delivery.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=60))]
    pub delay: u16,
    /// The camera moves by G times its command.
    #[arg(long, value_name = "G", default_value_t = 1.0)]
    pub gain: f64,
    /// Probability that a frame does not show one of its points.
    #[arg(long, value_name = "P", default_value_t = 0.0)]
    pub hide: f64,
    /// Once, in the first two seconds, frames show no point for so long.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    pub blackout_s: f64,
}

impl FreeFlags {
    /// Checks the ranges.
    ///
    /// # Errors
    /// Names flag, value and range.
    pub fn check(&self) -> anyhow::Result<()> {
        check("--gain", self.gain, 0.0, 10.0)?;
        check("--hide", self.hide, 0.0, 1.0)?;
        check("--blackout-s", self.blackout_s, 0.0, 60.0)
    }

    /// What the run from this start goes through.
    pub fn world(&self, common: &Common, start: usize) -> World {
        let flaws = Flaws {
            noise_px: common.noise,
            delay_frames: usize::from(self.delay),
            drop: common.drop,
            hide: self.hide,
            blackout_s: self.blackout_s,
            seed: common.seed + start as u64,
        };
        World {
            motion: common.motion(),
            gain: self.gain,
            follow_s: common.follow_s,
            ..World::from(flaws)
        }
    }
}

/// The robot and its law.
#[derive(Args, Clone, Debug)]
pub struct RobotFlags {
    /// Time from the middle of an exposure to the delivery of its features, ms.
    #[arg(long, value_name = "MS", default_value_t = 110.0)]
    pub delay_ms: f64,
    /// Largest deviation of this delay to either side, ms.
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    pub jitter_ms: f64,
    /// Relative error of the focal lengths: the true ones are 1 + E times as large.
    #[arg(
        long,
        value_name = "E",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub focal_error: f64,
    /// Error of the hand-eye calibration: distance, in another direction for each start, cm.
    #[arg(long, value_name = "CM", default_value_t = 0.0)]
    pub hand_eye_cm: f64,
    /// Error of the hand-eye calibration: angle, about another axis for each start, deg.
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    pub hand_eye_deg: f64,
    /// Ask the memory when a feature comes this close to an occlusion, px.
    #[arg(long, value_name = "PX", default_value_t = 30.0)]
    pub trigger: f64,
    /// Ask the memory until every feature is X times the distance of --trigger away.
    #[arg(long, value_name = "X", default_value_t = 2.0)]
    pub hysteresis: f64,
    /// Clearance that the law keeps from every border, px; 0 in the paper.
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    pub margin: f64,
    /// The law takes the markers for points: it does not know the scene's marker_size.
    #[arg(long)]
    pub ignore_marker_size: bool,
    /// Send the 30 Hz commands to the robot without shaping them to 1 kHz.
    #[arg(long)]
    pub unshaped: bool,
    /// Begin in postures near the ends of the joints' ranges and near singular postures, drawn by
    /// this seed: as many as there are starts, which are not used.
    #[arg(long, value_name = "SEED")]
    pub edge: Option<u64>,
    /// Between the law and the bridge is the rule of MoveIt Servo: it slows down by the Jacobian's
    /// condition number, and stops at the joints' ends.
    #[arg(long)]
    pub servo_rule: bool,
    /// A row more: ViSP's joint-limit task on classic visual servoing, which commands the joints of
    /// the scene's arm. Its calibration is true, its images have no noise.
    #[arg(long, requires = "edge")]
    pub joint_task: bool,
    /// Arm file, in place of the scene's: the law is told of it, and `--robot urdf` is such a one.
    #[arg(long, value_name = "FILE")]
    pub arm: Option<PathBuf>,
    /// Tell the law of no arm, although the scene has one.
    #[arg(long)]
    pub ignore_arm: bool,
    /// Run only this start.
    #[arg(long, value_name = "INDEX")]
    pub only: Option<usize>,
}

impl RobotFlags {
    /// Checks the ranges.
    ///
    /// # Errors
    /// Names flag, value and range.
    pub fn check(&self, starts: usize) -> anyhow::Result<()> {
        check("--delay-ms", self.delay_ms, 0.0, 900.0)?;
        check("--jitter-ms", self.jitter_ms, 0.0, self.delay_ms)?;
        check("--focal-error", self.focal_error, -0.5, 0.5)?;
        check("--hand-eye-cm", self.hand_eye_cm, 0.0, 20.0)?;
        check("--hand-eye-deg", self.hand_eye_deg, 0.0, 30.0)?;
        check(
            "--only",
            self.only.unwrap_or(0) as f64,
            0.0,
            starts as f64 - 1.0,
        )
    }
}

/// Checks that the value of a flag is in its range.
///
/// # Errors
/// Names flag, value and range.
pub fn check(flag: &str, value: f64, least: f64, most: f64) -> anyhow::Result<()> {
    anyhow::ensure!(
        (least..=most).contains(&value),
        "{flag} = {value}; allowed: {least} to {most}"
    );
    Ok(())
}

/// The value of a flag that is given by its name.
#[derive(Clone, Debug)]
pub enum Given {
    /// Of a switch.
    Switch(bool),
    /// The words of any other; several where it may be given several times.
    Words(Vec<String>),
}

/// The flags of a body, and those of all, by their names as keywords: `delay_ms` is `--delay-ms`.
/// Of all that there are, `is_allowed` says which may be given.
///
/// # Errors
/// What is unknown or out of its range, and what is allowed.
pub fn of_keywords<Body: Args>(
    given: &[(String, Given)],
    is_allowed: impl Fn(&str) -> bool,
) -> Result<(Common, Body), String> {
    let command = Command::new("keywords").no_binary_name(true);
    let command = Body::augment_args(Common::augment_args(command));
    let names = command.get_arguments().map(|flag| flag.get_id().as_str());
    let names: Vec<_> = names.filter(|name| is_allowed(name)).collect();
    let flag = |name: &str| format!("--{}", name.replace('_', "-"));
    let mut words = Vec::new();
    for (name, value) in given {
        if !names.contains(&name.as_str()) {
            return Err(format!("keyword `{name}`; allowed: {}", names.join(", ")));
        }
        match value {
            Given::Switch(is_on) => words.extend(is_on.then(|| flag(name))),
            Given::Words(all) => {
                words.extend(all.iter().map(|word| format!("{}={word}", flag(name))));
            }
        }
    }
    let read = |command: Command| {
        let matches = command.try_get_matches_from(words)?;
        let common = Common::from_arg_matches(&matches)?;
        Ok((common, Body::from_arg_matches(&matches)?))
    };
    let (common, body) = read(command.clone()).map_err(|error: clap::Error| as_keywords(error))?;
    common.check().map_err(as_keywords)?;
    Ok((common, body))
}

/// A message of the command line, with keywords in place of its flags.
pub fn as_keywords(error: impl Display) -> String {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    let line = line.strip_prefix("error: ").unwrap_or(line);
    let words = line.split(' ').map(|word| match word.split_once("--") {
        Some((before, flag)) => format!("{before}{}", flag.replace('-', "_")),
        None => word.to_owned(),
    });
    words.collect::<Vec<_>>().join(" ")
}

/// Flags with the defaults of the command line.
pub fn defaults<F: Args + FromArgMatches>() -> F {
    let matches = F::augment_args(Command::new("defaults")).get_matches_from(["defaults"]);
    F::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, value: Given) -> Result<(Common, RobotFlags), String> {
        of_keywords(&[(name.to_owned(), value)], |name| name != "only")
    }

    fn word(text: &str) -> Given {
        Given::Words(vec![text.to_owned()])
    }

    #[test]
    fn keywords_are_the_flags() {
        let (common, flags) = read("depth_error", word("-1e-1")).unwrap();
        assert_eq!((common.depth_error, flags.delay_ms), (-0.1, 110.0));
        let (common, _) = read("no_drift", Given::Switch(true)).unwrap();
        assert!(common.no_drift && !read("no_drift", Given::Switch(false)).unwrap().0.no_drift);
        let two = ["conveyor:0.1", "turn:0.2"].map(str::to_owned).to_vec();
        let (common, _) = read("motion", Given::Words(two)).unwrap();
        assert_eq!(common.motion.len(), 2);
    }

    #[test]
    fn a_bad_keyword_is_named_with_what_is_allowed() {
        for (name, text, message) in [
            ("only", "1", "keyword `only`; allowed: strategies, no_comp"),
            ("noise", "101", "noise = 101; allowed: 0 to 100"),
            ("depth_error", "-1", "depth_error = -1; allowed: -0.9 to 9"),
            ("delay_ms", "x", "invalid value 'x' for 'delay_ms <MS>': in"),
        ] {
            let refused = read(name, word(text)).unwrap_err();
            assert!(refused.starts_with(message), "{refused}");
        }
    }
}
