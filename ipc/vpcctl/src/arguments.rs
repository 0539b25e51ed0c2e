//! The command line.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use ipc::StrategyCode;

use crate::plot::PlotArguments;
use crate::record::RecordArguments;
use crate::replay::ReplayArguments;

/// Watch and command vpcd, the visual predictive controller.
///
/// Exit codes: 0 moving, arrived, done; 1 the camera stands (status), or something is to be mended (doctor); 2 the
/// request was refused; 3 no daemon; 4 the daemon does not answer; 5 disarmed (status); 64 command line; 65 a file is
/// wrong; 66 a file is missing; 69 shared memory, place or address not available; 70 failure of vpcctl.
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
    /// Tell on one screen what the daemon does.
    Status(StatusArguments),
    /// Show live what the daemon does: image plane, twist, times, states; keys command it.
    Watch(WatchArguments),
    /// Let the law move the camera.
    Arm(RequestArguments),
    /// Brake to zero and stay there until the next arm.
    Disarm(RequestArguments),
    /// Zero at once, without braking, and stay there until the next arm. Needs no observer's place.
    Stop(RequestArguments),
    /// Change the strategy of the law.
    Strategy(StrategyArguments),
    /// Have the daemon write out its flight record.
    Flight(RequestArguments),
    /// Say what is wrong with this machine or set-up, and how to mend it.
    Doctor(DoctorArguments),
    /// Metrics in the Prometheus text format, served or printed.
    Metrics(MetricsArguments),
    /// Serve a live view for the browser, on loopback.
    Serve(ServeArguments),
    /// Print the completions for a shell.
    Completions {
        /// bash, zsh, fish, elvish, powershell.
        shell: clap_complete::Shell,
    },
    /// Write the man pages into a directory.
    Man {
        /// The directory.
        #[arg(value_name = "DIR")]
        directory: PathBuf,
    },
    /// Record what the domain says, for Foxglove, the mcap tools, plot and replay.
    Record(RecordArguments),
    /// Draw a recording: paths, commands, latencies; and report deadlines.
    Plot(PlotArguments),
    /// Run the law again on a recording and compare.
    Replay(ReplayArguments),
}

/// `status`.
#[derive(Clone, Debug, Args)]
pub struct StatusArguments {
    /// JSON instead of text; numbers that are not known are null.
    #[arg(long)]
    pub json: bool,

    /// How long to watch the cycles, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = seconds)]
    pub watch: Duration,
}

/// `watch`.
#[derive(Clone, Debug, Args)]
pub struct WatchArguments {
    /// Scene file: image size, goal, occlusions and limits to draw.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// Neighbours that the key 2 asks for, 1 to 64.
    #[arg(long, value_name = "K", default_value = "1",
        value_parser = clap::value_parser!(u32).range(1..=64))]
    pub neighbours: u32,
}

/// `doctor`.
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

/// `metrics`.
#[derive(Clone, Debug, Args)]
pub struct MetricsArguments {
    /// Address to serve at, path /metrics; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:9469")]
    pub listen: SocketAddr,

    /// Allow an address that other machines reach. There is no encryption and no password.
    #[arg(long)]
    pub expose: bool,

    /// Watch for a while, print, and exit.
    #[arg(long)]
    pub once: bool,

    /// How long to watch with --once, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = seconds)]
    pub watch: Duration,
}

/// `serve`.
#[derive(Clone, Debug, Args)]
pub struct ServeArguments {
    /// Scene file: image size, goal, occlusions and limits to draw.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// Address to serve at; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:9470")]
    pub listen: SocketAddr,

    /// Allow an address that other machines reach, for watching. There is no encryption and no password.
    #[arg(long)]
    pub expose: bool,

    /// Let the page arm, disarm and stop; for who has the address with its token, as it is printed.
    #[arg(long)]
    pub control: bool,
}

/// A request.
#[derive(Clone, Debug, Args)]
pub struct RequestArguments {
    /// How long to wait for the answer, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "2", value_parser = seconds)]
    pub timeout: Duration,
}

/// `strategy`.
#[derive(Clone, Debug, Args)]
pub struct StrategyArguments {
    /// previous, knn (or knn2 ... knn64: neighbours averaged), gpr, ibvs.
    #[arg(value_name = "NAME", value_parser = strategy)]
    pub strategy: Choice,

    /// Neighbours averaged by knn, 1 to 64.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub neighbours: Option<u32>,

    /// How long to wait.
    #[command(flatten)]
    pub request: RequestArguments,
}

/// A strategy with the neighbours that its name gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The strategy.
    pub strategy: StrategyCode,
    /// Neighbours of knn, 1 to 64; else 0.
    pub neighbours: u32,
}

impl StrategyArguments {
    /// The strategy asked for; the flag wins over the name.
    ///
    /// # Errors
    /// Neighbours for a strategy that has none.
    pub fn choice(&self) -> Result<Choice, String> {
        match (self.strategy.strategy, self.neighbours) {
            (_, None) => Ok(self.strategy),
            (StrategyCode::Knn, Some(neighbours)) => Ok(Choice {
                neighbours,
                ..self.strategy
            }),
            (other, Some(k)) => Err(format!(
                "--neighbours {k} with strategy {other}; allowed: with knn only"
            )),
        }
    }
}

/// Reads a duration in seconds.
fn seconds(text: &str) -> Result<Duration, String> {
    let range = 0.05..=3600.0;
    match text.parse::<f64>() {
        Ok(seconds) if range.contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("allowed: 0.05 to 3600 seconds".to_owned()),
    }
}

/// Reads the name of a strategy as `vpcd --strategy` does.
fn strategy(text: &str) -> Result<Choice, String> {
    let plain = |strategy, neighbours| Choice {
        strategy,
        neighbours,
    };
    match text {
        "previous" => Ok(plain(StrategyCode::Previous, 0)),
        "knn" => Ok(plain(StrategyCode::Knn, 1)),
        "gpr" => Ok(plain(StrategyCode::Gpr, 0)),
        "ibvs" => Ok(plain(StrategyCode::Ibvs, 0)),
        _ => text
            .strip_prefix("knn")
            .and_then(|digits| digits.parse().ok())
            .filter(|neighbours| (1..=64).contains(neighbours))
            .map(|neighbours| plain(StrategyCode::Knn, neighbours))
            .ok_or_else(|| "allowed: previous, knn, knn2 ... knn64, gpr, ibvs".to_owned()),
    }
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
    fn neighbours_come_from_the_name_or_the_flag() {
        let choice = |words: &[&str]| {
            let line = ["vpcctl", "strategy"].iter().chain(words);
            match Arguments::try_parse_from(line).unwrap().command {
                Command::Strategy(arguments) => arguments.choice(),
                other => panic!("{other:?}"),
            }
        };
        let knn = |neighbours| {
            Ok(Choice {
                strategy: StrategyCode::Knn,
                neighbours,
            })
        };
        assert_eq!(choice(&["knn"]), knn(1));
        assert_eq!(choice(&["knn8"]), knn(8));
        assert_eq!(choice(&["knn", "--neighbours", "5"]), knn(5));
        let refused = choice(&["gpr", "--neighbours", "5"]).unwrap_err();
        assert!(refused.contains("with knn only"), "{refused}");
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        for words in [
            ["strategy", "knn65"].as_slice(),
            &["strategy", "magic"],
            &["strategy", "knn", "--neighbours", "0"],
            &["arm", "--timeout", "0"],
            &["arm", "--timeout", "nan"],
        ] {
            let line = std::iter::once(&"vpcctl").chain(words);
            assert!(Arguments::try_parse_from(line).is_err(), "{words:?}");
        }
    }
}
