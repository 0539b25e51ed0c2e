//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

/// Real-time visual predictive controller: image features in, camera twist out, through shared
/// memory.
///
/// Exit codes: 0 stopped by SIGTERM, SIGINT or --cycles; 1 --preflight found the machine unfit, or
/// a replay differs; 64 command line; 65 scene, memory or flight record wrong, or memory built for
/// another task; 66 file missing; 69 shared memory not available, or another vpcd at work; 70
/// failure of vpcd; 73 a file cannot be written; 78 configuration.
#[derive(Clone, Debug, Default, Parser)]
#[command(
    name = "vpcd",
    version,
    max_term_width = 100,
    args_conflicts_with_subcommands = true
)]
pub struct Arguments {
    /// Run this instead of the controller.
    #[command(subcommand)]
    pub command: Option<Command>,

    /// Configuration file (TOML); paths in it are relative to its directory. Without one every key
    /// has its default and --scene must be given. CONFIGURATION.md lists all keys.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Scene file, instead of `scene` in the configuration.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,

    /// Memory of motion, instead of `memory` in the configuration.
    #[arg(long, value_name = "FILE")]
    pub memory: Option<PathBuf>,

    /// foresight, previous, knn (or knn2 ... knn64: neighbours averaged), gpr, ibvs or follow, instead of
    /// `law.strategy`.
    #[arg(long, value_name = "NAME")]
    pub strategy: Option<String>,

    /// Steps predicted, 1 to 40, instead of `law.np`.
    #[arg(long, value_name = "STEPS")]
    pub np: Option<i64>,

    /// fixed (cycles at the scene's rate), phase (the same, following the camera's frames) or
    /// lockstep (one cycle for each features message), instead of `cycle.clock`.
    #[arg(long, value_name = "MODE")]
    pub clock: Option<String>,

    /// Directory of the shared-memory domain, the same for camera, controller, robot and observers,
    /// instead of `ipc.domain`. [default: /tmp/vpc-UID]
    #[arg(long, value_name = "DIR")]
    pub domain: Option<PathBuf>,

    /// Start armed: the camera moves with the first good features. Without this flag and
    /// `safety.armed` it stands until an operator arms it. In lockstep, which moves only simulated
    /// cameras, vpcd always starts armed unless `safety.armed` is false.
    #[arg(long)]
    pub arm: bool,

    /// After a SIGUSR2 vpcd begins itself again with this: disarmed, whatever else is said, under
    /// the operator's stop or disarm of this name, if one stood.
    #[arg(long, value_name = "VETO", hide = true)]
    pub again: Option<u32>,

    /// After N cycles, brake and stop.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub cycles: Option<u64>,

    /// Write a report to this file at the end (JSON): times of wake-up, reception, law and sending,
    /// page faults, blocking calls and heap allocations.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,

    /// Print what this machine lacks for real time and how to provide it, and exit with 0 if
    /// nothing is missing, else with 1. Needs neither configuration nor scene.
    #[arg(long)]
    pub preflight: bool,

    /// With --preflight: print JSON.
    #[arg(long, requires = "preflight")]
    pub json: bool,

    /// Check configuration, scene and memory, print what would run, and exit.
    #[arg(long)]
    pub check_only: bool,

    /// Print the whole configuration, with flags and defaults, as TOML, and exit.
    #[arg(long)]
    pub print_config: bool,
}

/// What `vpcd` can do besides controlling.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Repeat the cycles of a flight record or a recording and compare every bit: exit code 0 if
    /// all are the same, 1 if something differs.
    ///
    /// Scene and configuration come from the file. The memory of motion is read from the path in
    /// the configuration, or from --memory. Other exit codes: 65 the file is damaged or no
    /// recording, or the memory is not the recorded one; 66 a file is missing.
    Replay(ReplayArguments),
}

/// The command line of `vpcd replay`.
#[derive(Clone, Debug, Default, Args)]
pub struct ReplayArguments {
    /// The flight record, or a recording by `vpcctl record`.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,

    /// Memory of motion, instead of the path in the recorded configuration; it must be the
    /// recorded memory.
    #[arg(long, value_name = "FILE")]
    pub memory: Option<PathBuf>,

    /// Replay only from the last snapshot before cycle N up to N, and print its record.
    #[arg(long, value_name = "N")]
    pub until: Option<u64>,

    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
