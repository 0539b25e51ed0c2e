//! Flags of `cargo table`.

use clap::{Args, FromArgMatches};
use vpc::{Model, Settings};

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
    /// Seed of noise and losses; each start adds its index.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How the law predicts features: pose, area-depth, target-depth.
    #[arg(long, value_parser = model, default_value = "pose")]
    pub model: Model,
    /// Constraints hold at the sampling instants only, as in the paper.
    #[arg(long)]
    pub at_samples_only: bool,
    /// Weight of the change of the command, as a share of R; 0 in the paper.
    #[arg(long, value_name = "X", default_value_t = Settings::default().change_share)]
    pub change_share: f64,
    /// Time constant of the filter of the features, s; 0: none, as in the paper.
    #[arg(long, value_name = "S", default_value_t = Settings::default().filter_s)]
    pub filter_s: f64,
    /// Greatest distance of a filtered feature from the measured one, px.
    #[arg(long, value_name = "PX", default_value_t = Settings::default().filter_px)]
    pub filter_px: f64,
    /// Length of a step of the preview, s; where the camera's period or a stop takes longer, that.
    #[arg(long, value_name = "S", default_value_t = Settings::default().step_s)]
    pub step_s: f64,
    /// Rate of the camera instead of the scene's, Hz.
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
    /// Most steps that foresight simulates in a cycle.
    #[arg(long, value_name = "N", default_value_t = Settings::default().foresight_steps)]
    pub foresight_steps: u32,
    /// Time in which the command goes from zero to its limits, s, where the scene gives no limits
    /// of acceleration: 0.15 as `vpcd` has it on a real clock; 0: at once, as in the paper.
    #[arg(long, value_name = "S", default_value_t = Settings::default().brake_s)]
    pub brake_s: f64,
}

/// A model by its name in configuration files.
fn model(word: &str) -> Result<Model, &'static str> {
    match word {
        "pose" => Ok(Model::Pose),
        "area-depth" => Ok(Model::AreaDepth),
        "target-depth" => Ok(Model::TargetDepth),
        _ => Err("allowed: pose, area-depth, target-depth"),
    }
}

impl Common {
    /// The law's settings for one of the strategies.
    pub fn settings(&self, spec: Spec) -> Settings {
        let settings = spec.settings();
        Settings {
            delay_compensation: !self.no_compensation,
            model: self.model,
            foresight_steps: self.foresight_steps,
            brake_s: self.brake_s,
            change_share: self.change_share,
            filter_s: self.filter_s,
            step_s: self.step_s,
            filter_px: self.filter_px,
            solver: vpc::SolverOptions {
                intersample: !self.at_samples_only,
                ..settings.solver
            },
            ..settings
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names flag, value and range.
    pub fn check(&self) -> anyhow::Result<()> {
        check("--noise", self.noise, 0.0, 100.0)?;
        check("--drop", self.drop, 0.0, 1.0)?;
        check("--brake-s", self.brake_s, 0.0, 10.0)?;
        check("--rate", self.rate.unwrap_or(30.0), 1.0, 1000.0)?;
        check("--depth-error", self.depth_error, -0.9, 9.0)
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

fn check(flag: &str, value: f64, least: f64, most: f64) -> anyhow::Result<()> {
    anyhow::ensure!(
        (least..=most).contains(&value),
        "{flag} = {value}; allowed: {least} to {most}"
    );
    Ok(())
}

/// Flags with the defaults of the command line.
pub fn defaults<F: Args + FromArgMatches>() -> F {
    let matches = F::augment_args(clap::Command::new("defaults")).get_matches_from(["defaults"]);
    F::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}
