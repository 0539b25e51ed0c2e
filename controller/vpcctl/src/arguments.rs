//! The command line.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use messages::{MAX_NEIGHBOURS, StrategyCode};

use crate::check_bridge::CheckBridgeArguments;
use crate::init::InitArguments;
use crate::plot::PlotArguments;
use crate::record::RecordArguments;
use crate::teach::TeachArguments;
use crate::units::seconds;
use crate::visit::VisitArguments;

/// Watch and command vpcd, the visual predictive controller.
///
/// Exit codes: 0 moving, arrived, done; 1 the camera stands (status), or something must be fixed
/// (doctor, check-bridge), or the camera has not arrived (visit); 2 the request was refused, or
/// files are there already (init), or what is seen is no goal (teach), or the daemon does not take
/// it up; 3 no daemon; 4 the daemon does not answer; 5 disarmed (status); 64 command line; 65 a
/// file is wrong; 66 a file is missing; 69 shared memory, slot or address not available; 70 failure
/// of vpcctl; 77 the domain is another user's, and nothing was done.
#[derive(Clone, Debug, Parser)]
#[command(name = "vpcctl", version, max_term_width = 100)]
pub struct Arguments {
    /// Directory of the daemon's shared-memory domain. [default: /tmp/vpc-UID]
    #[arg(long, value_name = "DIR", global = true)]
    pub domain: Option<PathBuf>,

    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

impl Arguments {
    /// The domain's directory.
    pub fn directory(&self) -> PathBuf {
        self.domain.clone().unwrap_or_else(ipc::default_directory)
    }
}

/// What to do.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Print the daemon's state on one screen.
    Status(StatusArguments),
    /// Show the daemon's state live in the terminal; keys command it.
    Watch(WatchArguments),
    /// Let the controller move the camera.
    Arm(ArmArguments),
    /// Brake to zero and stay there until the next arm.
    Disarm(RequestArguments),
    /// Stop at once, without braking, and stay there until the next arm.
    Stop(StopArguments),
    /// Ask the robot's bridge to clear the robot's errors; the controller stays disarmed.
    Recover(RecoverArguments),
    /// Change the strategy.
    Strategy(StrategyArguments),
    /// Make the daemon write its flight record, and print the file.
    Flight(RequestArguments),
    /// Find out what is wrong with this machine or setup, and how to fix it.
    Doctor(DoctorArguments),
    /// Write a folder of configuration files for a robot: scene, camera, bridge, controller and
    /// emulator. Nothing is overwritten.
    Init(InitArguments),
    /// Play vpcd to the program that carries out twists, and judge what it reports: the camera
    /// moves some centimetres along its x axis and back.
    CheckBridge(CheckBridgeArguments),
    /// Write a scene with the goal that the camera sees now, or let the daemon take it up. Hold the
    /// camera there, still.
    Teach(TeachArguments),
    /// Bring the camera to the goals of several scenes, one after the other: the daemon begins
    /// again with each, and is armed.
    Visit(VisitArguments),
    /// Serve or print metrics in the Prometheus text format.
    Metrics(MetricsArguments),
    /// Serve a live view to browsers on this machine, or to Foxglove.
    Serve(ServeArguments),
    /// Print the completions for a shell.
    Completions {
        /// bash, zsh, fish, elvish, powershell.
        shell: clap_complete::Shell,
    },
    /// Write man pages and completions into a directory, as a package ships them.
    Man {
        /// Directory to write to; it is created if it does not exist.
        #[arg(value_name = "DIR")]
        directory: PathBuf,
    },
    /// Record all messages to an MCAP file, for Foxglove, the mcap tools, plot and `vpcd replay`.
    Record(RecordArguments),
    /// Draw a recording (paths, commands, latencies) and report deadlines.
    Plot(PlotArguments),
}

impl Command {
    /// Whether its exit code tells what was done, and not what was printed.
    pub fn acts(&self) -> bool {
        matches!(
            self,
            Self::Arm(_)
                | Self::Disarm(_)
                | Self::Stop(_)
                | Self::Recover(_)
                | Self::Strategy(_)
                | Self::Flight(_)
                | Self::Teach(_)
        )
    }
}

/// The command line of `arm`.
#[derive(Clone, Debug, Args)]
pub struct ArmArguments {
    /// Arm in spite of this stop, or disarm of another operator: its number, which the refusal and
    /// status tell. A disarm before this command needs none.
    #[arg(long, value_name = "NUMBER")]
    pub veto: Option<u32>,

    /// As of every request.
    #[command(flatten)]
    pub request: RequestArguments,
}

/// The command line of `stop`.
#[derive(Clone, Debug, Args)]
pub struct StopArguments {
    /// Stop every vpcd of this user, in whatever domain.
    #[arg(long, conflicts_with = "domain")]
    pub all: bool,

    /// As of every request.
    #[command(flatten)]
    pub request: RequestArguments,
}

/// The command line of `status`.
#[derive(Clone, Debug, Args)]
pub struct StatusArguments {
    /// Print JSON; numbers that are not known are null.
    #[arg(long)]
    pub json: bool,

    /// How long to watch the cycles, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = seconds)]
    pub watch: Duration,
}

/// The command line of `watch`.
#[derive(Clone, Debug, Args)]
pub struct WatchArguments {
    /// Scene file to draw: image size, goal, occlusions, limits. [default: the daemon's]
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// Neighbours of knn for the key 2, 1 to 64.
    #[arg(long, value_name = "K", default_value = "1",
        value_parser = clap::value_parser!(u32).range(1..=64))]
    pub neighbours: u32,
}

/// The command line of `doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArguments {
    /// A scene file to check.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// A memory of motion to check, against the scene if there is one.
    #[arg(long, value_name = "FILE")]
    pub memory: Option<PathBuf>,

    /// How long to watch a running daemon, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = seconds)]
    pub watch: Duration,
}

/// The command line of `metrics`.
#[derive(Clone, Debug, Args)]
pub struct MetricsArguments {
    /// Address to serve at, path /metrics; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:9469")]
    pub listen: SocketAddr,

    /// Allow an address that other machines can reach, without encryption or password.
    #[arg(long)]
    pub expose: bool,

    /// Watch for the time of --watch, print, and exit.
    #[arg(long)]
    pub once: bool,

    /// How long to watch with --once, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = seconds)]
    pub watch: Duration,
}

/// The command line of `serve`.
#[derive(Clone, Debug, Args)]
pub struct ServeArguments {
    /// Scene file to draw: image size, goal, occlusions, limits. [default: the daemon's]
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// Address to serve at; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:9470")]
    pub listen: SocketAddr,

    /// Allow an address from which other machines can watch, without encryption or password.
    #[arg(long)]
    pub expose: bool,

    /// Let the page arm, disarm, stop and teach, when opened at the printed address with its token.
    #[arg(long)]
    pub control: bool,

    /// Hand-eye calibration of the camera on the flange: TOML, or YAML of easy_handeye or OpenCV.
    /// With it, Foxglove shows the arm where it stands.
    #[arg(long, value_name = "FILE", requires = "foxglove")]
    pub hand_eye: Option<PathBuf>,

    /// Serve Foxglove instead of the page, at this address or at 127.0.0.1:8765: the topics of
    /// `record`, and the camera's images. Clients only watch.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765",
        conflicts_with_all = ["listen", "control"])]
    pub foxglove: Option<SocketAddr>,

    /// Let the pages of this origin connect, too, as Foxglove's web app needs; may be repeated.
    /// Programs, and pages of this machine, may connect in any case.
    #[arg(long, value_name = "URL", requires = "foxglove")]
    pub origin: Vec<String>,
}

/// The command line of a request.
#[derive(Clone, Debug, Args)]
pub struct RequestArguments {
    /// How long to wait for the answer, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "2", value_parser = seconds)]
    pub timeout: Duration,
}

/// The command line of `recover`.
#[derive(Clone, Debug, Args)]
pub struct RecoverArguments {
    /// How long to wait for a robot without errors, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = seconds)]
    pub timeout: Duration,
}

/// The command line of `strategy`.
#[derive(Clone, Debug, Args)]
pub struct StrategyArguments {
    /// foresight, previous, knn (or knn2 ... knn64: the mean of that many neighbours), gpr, ibvs, follow.
    #[arg(value_name = "NAME", value_parser = strategy)]
    pub strategy: (StrategyCode, u32),

    #[command(flatten)]
    #[allow(missing_docs)]
    pub request: RequestArguments,
}

/// Reads the name of a strategy as `vpcd --strategy` does, with its neighbours.
fn strategy(text: &str) -> Result<(StrategyCode, u32), String> {
    StrategyCode::from_name(text).ok_or_else(|| {
        let names = StrategyCode::TABLE.names.iter().map(|name| name.text);
        format!(
            "allowed: {}, knn2 ... knn{MAX_NEIGHBOURS}",
            names.collect::<Vec<_>>().join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Arguments::command().debug_assert();
    }

    #[test]
    fn neighbours_come_from_the_name() {
        assert_eq!(strategy("knn"), Ok((StrategyCode::Knn, 1)));
        assert_eq!(strategy("knn8"), Ok((StrategyCode::Knn, 8)));
        assert_eq!(strategy("gpr"), Ok((StrategyCode::Gpr, 0)));
        let refused = strategy("gpr8").unwrap_err();
        assert!(refused.contains("knn64"), "{refused}");
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        for words in [
            ["strategy", "knn65"].as_slice(),
            &["strategy", "magic"],
            &["strategy", "knn0"],
            &["arm", "--timeout", "0"],
            &["arm", "--timeout", "nan"],
        ] {
            let line = std::iter::once(&"vpcctl").chain(words);
            assert!(Arguments::try_parse_from(line).is_err(), "{words:?}");
        }
    }
}
