//! `cargo table`: every strategy on the same starts, closed loop against an exact camera; the
//! paper's Table I.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::bail;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, ValueEnum};
use hw_sim::robot::arm::ArmSettings;
use hw_sim::robot::described;
use indicatif::{ProgressBar, ProgressStyle};
use memory_blob::MemoryFile;
use messages::ClockMode;
use scene::{Arm, Pose, Scene, read_starts};
use serde::Serialize;
use system_tests::children::Children;
use system_tests::column;
use system_tests::document::{self, Document};
use system_tests::external::{External, Method};
use system_tests::fci_table::{self, FciFlags, Setup};
use system_tests::flags::{Common, FreeFlags, RobotFlags, check};
use system_tests::pictures::{self, Draw};
use system_tests::results::{Line, Measured, Results};
use system_tests::robot::RobotRun;
use system_tests::robot_table::{self, RobotRow};
use system_tests::row::{self, Row};
use system_tests::run::{Caches, Run, through, time};
use system_tests::simulated::Simulated;
use system_tests::source::{Product, Source};
use system_tests::steering::Steering;
use vpc::{Settings, Task};

use crate::{arguments, write};

/// Runs every strategy from the same starts against an emulated camera, as in the paper's Table I.
///
/// Runs are made one after another on one core, so that they do not disturb each other's times.
/// Every run lasts the scene's time; its cost is the mean over all cycles.
///
/// Columns: success, the share of runs that arrived in the scene's time without a violation; cost,
/// the mean of what the law minimizes, per step ahead; cycles to arrival, the mean over these runs;
/// p99 of the time that a decision takes, of an external method from question to answer; failures
/// by their reason. With --wide also slack, the time that foresight takes after each decision.
#[derive(Args)]
pub(crate) struct Cli {
    /// Scene file (TOML).
    #[arg(long)]
    scene: PathBuf,
    /// Start poses: a file (CSV: tx,ty,tz,rx,ry,rz), or COUNT@SEED: so many that `vpc-memory starts`
    /// draws by this seed.
    #[arg(long)]
    starts: Source,
    /// Memory of motion: a file, or COUNT@SEED: one of so many trajectories that `vpc-memory build`
    /// makes by this seed; 900@1 if none is given. Several make a table each.
    #[arg(long)]
    memory: Vec<Source>,
    #[command(flatten)]
    common: Common,
    /// What carries the camera.
    #[arg(long, value_enum, default_value = "free")]
    robot: Body,
    /// Write rows and runs to this file (JSON).
    #[arg(long)]
    json: Option<PathBuf>,
    /// Draw pictures into this directory.
    #[arg(long)]
    plots: Option<PathBuf>,
    /// Print all columns, and from which starts each strategy failed.
    #[arg(long)]
    wide: bool,
    #[command(flatten, next_help_heading = "With --robot free")]
    camera: CameraFlags,
    #[command(flatten, next_help_heading = "With --robot panda or urdf")]
    arm: RobotFlags,
    #[command(flatten, next_help_heading = "With --robot fci")]
    fci: FciFlags,
}

/// The camera that flies freely.
#[derive(Args)]
struct CameraFlags {
    /// Replays of each run; the time of a cycle is the median over them.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    repeats: u16,
    /// Time decisions with cold caches as well, alone and after a rehearsal; the caches are emptied
    /// before each, which takes a second a run.
    #[arg(long)]
    cold: bool,
    /// Write the rows of all memories to this file (JSON), with commit and command; `cargo xtask
    /// codegen` quotes `tests/results/table.json` in README.md.
    #[arg(long, value_name = "FILE")]
    results: Option<PathBuf>,
    #[command(flatten)]
    world: FreeFlags,
    /// A method of another program: its row's name, the program and its arguments, separated by
    /// spaces. `tests/peers/README.md` says what it reads and writes. Several have a row each.
    #[arg(long, value_name = "NAME=PROGRAM ARGS")]
    external: Vec<Method>,
    /// Time that an external method has for each answer, and to start.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    timeout_s: f64,
}

/// The paper's memory has 900 trajectories.
const PAPERS_MEMORY: Source = Source::Made {
    count: 900,
    seed: 1,
};

/// What carries the camera.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Body {
    /// Nothing: the camera moves exactly as commanded, as in the paper's simulation.
    Free,
    /// A Franka Emika Panda; frames are delayed.
    Panda,
    /// The arm of --arm or of the scene; its bridge does not slow it down for its joints.
    Urdf,
    /// The same as panda in real time, with vpcd, vpc-panda and hw-sim as processes: the bridge
    /// speaks the vendor's protocol.
    Fci,
}

/// What stands below a narrow table.
const MORE: &str =
    "All columns, and the starts that failed: --wide. What each column means: --help.";

impl Cli {
    /// What a line of words says.
    pub(crate) fn of(words: &[&str]) -> Result<Self, clap::Error> {
        let command = Self::augment_args(Command::new("table").no_binary_name(true));
        Self::from_arg_matches(&command.try_get_matches_from(words)?)
    }

    /// Refuses a flag that the chosen body ignores: a margin that changes nothing must not pass for
    /// one that does nothing.
    pub(crate) fn check(&self, given: &ArgMatches) -> Result<(), String> {
        let is_given = |id: &str| given.value_source(id) == Some(ValueSource::CommandLine);
        let first = |flags: Command| {
            let mut ids = flags.get_arguments().map(|flag| flag.get_id().as_str());
            // Every body has strategies.
            let id = ids.find(|id| *id != "strategies" && is_given(id))?;
            Some(format!("--{}", id.replace('_', "-")))
        };
        let none = || Command::new("");
        let bodies = [
            ("free", &[Body::Free][..], CameraFlags::augment_args(none())),
            (
                "panda",
                &[Body::Panda, Body::Urdf],
                RobotFlags::augment_args(none()),
            ),
            ("fci", &[Body::Fci], FciFlags::augment_args(none())),
        ];
        for (name, bodies, flags) in bodies {
            if let (false, Some(flag)) = (bodies.contains(&self.robot), first(flags)) {
                return Err(format!("{flag} goes with --robot {name}"));
            }
        }
        let only_panda = ["edge", "servo_rule", "joint_task", "plots"].map(Arg::new);
        let (name, without) = match self.robot {
            Body::Urdf => ("urdf", none().args(only_panda)),
            Body::Fci => ("fci", Common::augment_args(none())),
            _ => ("", none()),
        };
        first(without).map_or(Ok(()), |flag| {
            Err(format!("{flag} does not go with --robot {name}"))
        })
    }
}

/// Prints a table for each memory, and writes what was asked for.
pub(crate) fn table(children: &Children, cli: &Cli) -> anyhow::Result<ExitCode> {
    let (several, count) = (cli.memory.len() > 1, cli.memory.len());
    if several && (cli.json.is_some() || cli.plots.is_some()) {
        bail!("--json and --plots go with one --memory; given: {count}");
    }
    let (scene, starts) = scene_and_starts(children, cli)?;
    let mut strategies = cli.common.strategies.iter();
    let sources = match cli.memory.as_slice() {
        [] if strategies.any(|spec| spec.strategy.needs_memory()) => vec![Some(&PAPERS_MEMORY)],
        [] => vec![None],
        sources => sources.iter().map(Some).collect(),
    };
    let mut results = Results::begin(command());
    for source in sources {
        let memory = source.map(|source| memory(children, cli, source));
        let memory = memory.transpose()?;
        let name = source.map_or(String::new(), Source::to_string);
        if several {
            println!("memory {name}");
        }
        match cli.robot {
            Body::Free => {
                let done = free(cli, &scene, &starts, memory.as_ref())?;
                done.finish(cli, &scene, memory.as_ref())?;
                let (memory, lines) = (name, done.rows.iter().map(Line::from).collect());
                results.tables.push(Measured { memory, lines });
            }
            Body::Panda | Body::Urdf => {
                on_robot(cli, &scene, &starts, memory.as_ref())?.finish(cli, &scene, None)?;
            }
            Body::Fci => by_interface(children, cli, source, starts.len())?,
        }
    }
    if let Some(path) = &cli.camera.results {
        write(path, &results.to_json()?)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The scene, with the arm and the rate that the flags give it, and the starts.
pub(crate) fn scene_and_starts(
    children: &Children,
    cli: &Cli,
) -> anyhow::Result<(Scene, Vec<Pose>)> {
    cli.common.check()?;
    let mut scene = Scene::read(&cli.scene)?;
    if let Some(path) = &cli.arm.arm {
        scene.arm = Some(Arm::read(path)?);
    }
    scene.camera.rate_hz = cli.common.rate.unwrap_or(scene.camera.rate_hz);
    let read = |path: &Path| Ok(read_starts(path)?);
    let starts = made(children, cli, &cli.starts, Product::Starts, read)?;
    Ok((scene, starts))
}

/// The memory of the scene as its file has it.
pub(crate) fn memory(
    children: &Children,
    cli: &Cli,
    source: &Source,
) -> anyhow::Result<MemoryFile> {
    let task = Scene::read(&cli.scene)?.fingerprint();
    let open = |path: &Path| Ok(MemoryFile::open(path, Some(task.bytes()))?);
    made(children, cli, source, Product::Memory, open)
}

/// The table of the camera that flies freely.
pub(crate) fn free(
    cli: &Cli,
    scene: &Scene,
    starts: &[Pose],
    memory: Option<&MemoryFile>,
) -> anyhow::Result<Done<Row, Run>> {
    let CameraFlags {
        repeats,
        cold,
        ref world,
        ref external,
        timeout_s,
        ..
    } = cli.camera;
    world.check()?;
    check("--timeout-s", timeout_s, 0.01, 3600.0)?;
    let believed = cli.common.believed(scene);
    let is_following = cli.common.is_following();
    let bar = bar((cli.common.strategies.len() + external.len()) * starts.len());
    let (mut rows, mut all, mut told) = (Vec::new(), Vec::new(), String::new());
    for &spec in &cli.common.strategies {
        let settings = cli.common.settings(spec);
        let mut daemon = Simulated::new(&believed, memory, settings, ClockMode::Fixed)?;
        let mut caches = Caches::default();
        let name = spec.to_string();
        let runs = runs(
            cli,
            scene,
            starts,
            (&name, &bar),
            &mut daemon,
            |run, daemon| {
                time(run, daemon, usize::from(repeats))?;
                if cold {
                    caches.time(run, daemon);
                }
                Ok(())
            },
        )?;
        let (strategy, np) = (spec.strategy.to_string(), Some(spec.np));
        rows.push(Row::of(strategy, np, &runs, is_following));
        if cold {
            told += &format!("{spec}: {caches}\n");
        }
        all.push((name, runs));
    }
    for method in external {
        let name = method.name.clone();
        if all.iter().any(|(other, _)| *other == name) {
            bail!("--external {name}=: a row has this name; allowed: a name for each row");
        }
        let settings = Settings {
            brake_s: cli.common.brake_s,
            ..Settings::default()
        };
        let patience = Duration::from_secs_f64(timeout_s);
        let mut method = External::start(method, &believed, &settings, patience)?;
        let runs = runs(
            cli,
            scene,
            starts,
            (&name, &bar),
            &mut method,
            |run, method| {
                let until_decided = method.times_us().iter().take(run.history.len());
                run.cycles_us = until_decided.copied().collect();
                Ok(())
            },
        )?;
        rows.push(Row::of(name.clone(), None, &runs, is_following));
        all.push((name, runs));
    }
    bar.finish_and_clear();
    let title = title(cli, starts.len());
    let text = column::markdown(&row::COLUMNS, &rows, cli.wide);
    let text = format!("{title}\n\n{text}{told}");
    Ok(Done {
        title,
        text,
        rows,
        all,
    })
}

/// The runs of what steers, by its name, from all starts; after each, `then` is called.
fn runs<S: Steering<Error: std::error::Error + Send + Sync + 'static>>(
    cli: &Cli,
    scene: &Scene,
    starts: &[Pose],
    (name, bar): (&str, &ProgressBar),
    steering: &mut S,
    mut then: impl FnMut(&mut Run, &mut S) -> anyhow::Result<()>,
) -> anyhow::Result<Vec<Run>> {
    if bar.is_hidden() {
        eprintln!("table: {name} from {} starts", starts.len());
    }
    let each = starts.iter().enumerate().map(|(start, pose)| {
        bar.set_message(format!("{name}, start {start}"));
        let world = cli.camera.world.world(&cli.common, start);
        let mut run = through(scene, steering, pose, &world)?;
        then(&mut run, steering)?;
        bar.inc(1);
        Ok(run)
    });
    each.collect()
}

/// Scene, starts, and the camera's flaws: those that it has.
fn title(cli: &Cli, starts: usize) -> String {
    let Common {
        noise,
        drop,
        depth_error,
        no_compensation,
        ref motion,
        ..
    } = cli.common;
    let FreeFlags {
        delay,
        gain,
        hide,
        blackout_s,
        ..
    } = cli.camera.world;
    let compensation = match no_compensation {
        true => "not compensated",
        false => "compensated",
    };
    let flaws = [
        (delay > 0, format!("delay {delay} frames, {compensation}")),
        (noise > 0.0, format!("noise {noise} px")),
        (drop > 0.0, format!("{} % of frames lost", 100.0 * drop)),
        (
            hide > 0.0,
            format!("a point hidden in {} % of frames", 100.0 * hide),
        ),
        (blackout_s > 0.0, format!("nothing seen for {blackout_s} s")),
        (gain != 1.0, format!("moves by {gain} of its command")),
        (
            depth_error != 0.0,
            format!("depths wrong by {} %", 100.0 * depth_error),
        ),
    ];
    let there = flaws.into_iter().filter(|(is_there, _)| *is_there);
    let mut title = format!("{}, {starts} starts", cli.scene.display());
    there.for_each(|(_, words)| title += &format!(", {words}"));
    (motion.iter()).for_each(|motion| title += &format!(", {motion}"));
    title
}

/// The command line, as it may be given again.
fn command() -> String {
    let words = arguments()
        .skip(2)
        .map(|word| format!(" {}", word.display()));
    format!("cargo table --{}", words.collect::<String>())
}

/// The table of the robot.
fn on_robot(
    cli: &Cli,
    scene: &Scene,
    starts: &[Pose],
    memory: Option<&MemoryFile>,
) -> anyhow::Result<Done<RobotRow, RobotRun>> {
    let count = cli.arm.only.map_or(starts.len(), |_| 1);
    let rows = cli.common.strategies.len() + usize::from(cli.arm.joint_task);
    let bar = bar(rows * count);
    let tick = || bar.inc(1);
    let arm = match (cli.robot, &scene.arm) {
        (Body::Urdf, None) => bail!("--robot urdf goes with --arm, or a scene that names an arm"),
        (Body::Urdf, Some(arm)) => described::settings(arm, &scene.goal),
        _ => ArmSettings::default(),
    };
    let all = robot_table::table((scene, &arm), starts, memory, &cli.arm, &cli.common, &tick)?;
    bar.finish_and_clear();
    let is_following = cli.common.is_following();
    let rows = all.iter();
    let rows = rows.map(|(name, runs)| robot_table::row(name, runs, is_following));
    let rows: Vec<_> = rows.collect();
    let text = column::markdown(&robot_table::COLUMNS, &rows, cli.wide);
    let title = cli.scene.display().to_string();
    Ok(Done {
        title,
        text,
        rows,
        all,
    })
}

/// The table of the robot behind the vendor's interface.
fn by_interface(
    children: &Children,
    cli: &Cli,
    memory: Option<&Source>,
    starts: usize,
) -> anyhow::Result<()> {
    // The processes read them.
    fn file(source: &Source) -> anyhow::Result<&Path> {
        match source {
            Source::File(path) => Ok(path),
            made => bail!("{made}: --robot fci takes files; make one with vpc-memory"),
        }
    }
    let setup = Setup {
        children,
        scene: &cli.scene,
        starts: (file(&cli.starts)?, starts),
        memory: memory.map(file).transpose()?,
        common: &cli.common,
        flags: &cli.fci,
    };
    let bar = bar(cli.common.strategies.len() * cli.fci.interfaces.len() * starts);
    let rows = fci_table::table(&setup, &|| bar.inc(1))?;
    bar.finish_and_clear();
    println!("{}", fci_table::markdown(&rows, cli.wide));
    if let Some(path) = &cli.json {
        write(path, &serde_json::to_vec_pretty(&rows)?)?;
    }
    Ok(())
}

/// Rows, and the runs of each strategy that they were made from.
pub(crate) struct Done<Row, Run> {
    title: String,
    /// What is printed.
    text: String,
    rows: Vec<Row>,
    pub(crate) all: Vec<(String, Vec<Run>)>,
}

impl<Row: Serialize, Run: Draw + Serialize> Done<Row, Run> {
    /// The rows, and from which starts each strategy failed where the table is wide.
    pub(crate) fn told(&self, cli: &Cli) -> String {
        if !cli.wide {
            return format!("{}\n{MORE}\n", self.text);
        }
        let first = cli.arm.only.unwrap_or(0);
        let failed = self.all.iter().map(|(name, runs)| {
            let failed = (first..).zip(runs).filter(|(_, run)| !run.is_success());
            let failed: Vec<_> = failed.map(|(start, _)| start.to_string()).collect();
            match failed.is_empty() {
                true => String::new(),
                false => format!("{name} failed from {}\n", failed.join(", ")),
            }
        });
        format!("{}\n{}", self.text, failed.collect::<String>())
    }

    /// Prints them, and writes what was asked for.
    fn finish(&self, cli: &Cli, scene: &Scene, memory: Option<&MemoryFile>) -> anyhow::Result<()> {
        let mut out = std::io::stdout().lock();
        write!(out, "{}", self.told(cli))?;
        if let Some(path) = &cli.json {
            let document = Document {
                command: command(),
                title: &self.title,
                rows: &self.rows,
                runs: document::records(&self.all, cli.arm.only.unwrap_or(0)),
            };
            write(path, &serde_json::to_vec(&document)?)?;
            writeln!(out, "wrote {}", path.display())?;
        }
        if let Some(directory) = &cli.plots {
            let (task, only) = (Task::new(scene)?, cli.arm.only);
            for path in pictures::of_table(directory, scene, &task, memory, &self.all, only)? {
                writeln!(out, "wrote {}", path.display())?;
            }
        }
        Ok(())
    }
}

/// Reads a file; one that is to be made is made in a temporary directory, which is removed once it
/// is read.
fn made<T>(
    children: &Children,
    cli: &Cli,
    source: &Source,
    product: Product,
    read: impl Fn(&Path) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let directory = std::env::temp_dir().join(format!("vpc-table-{}", std::process::id()));
    let _place = children.place(directory.clone());
    read(&source.file(children, &cli.scene, product, &directory)?)
}

/// Progress on standard error, where that is a terminal.
fn bar(total: usize) -> ProgressBar {
    let style =
        ProgressStyle::with_template("{bar:30.cyan/blue} {pos}/{len} {msg}, {elapsed}, ETA {eta}");
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(total as u64).with_style(style);
    // A run may take seconds: it shows that time goes on.
    bar.enable_steady_tick(Duration::from_secs(1));
    bar
}

#[cfg(test)]
mod tests {
    use crate::Lab;

    fn refusal(flags: &str) -> Option<String> {
        let line = format!("vpc-lab table --scene s --starts s {flags}");
        let read = Lab::read(line.split_whitespace().map(Into::into));
        read.err().map(|error| error.to_string())
    }

    #[test]
    fn a_flag_that_would_change_nothing_is_refused() {
        assert_eq!(refusal("--margin 12 --robot panda"), None);
        assert_eq!(refusal("--delay 4 --noise 0.3 --gain 0.8"), None);
        let moves = "--motion circle:0.05:0.1 --motion conveyor:-0.1 --follow-s 5";
        assert_eq!(refusal(moves), None);
        assert_eq!(refusal(&format!("{moves} --robot panda")), None);
        for (flags, words) in [
            ("--margin 12", "--margin goes with --robot panda"),
            ("--unshaped", "--unshaped goes with --robot panda"),
            (
                "--delay-ms 110 --robot free",
                "--delay-ms goes with --robot panda",
            ),
            ("--delay 4 --robot panda", "--delay goes with --robot free"),
            ("--gain 0.8 --robot panda", "--gain goes with --robot free"),
            ("--hide 0.3 --robot panda", "--hide goes with --robot free"),
            (
                "--external visp=visp --robot panda",
                "--external goes with --robot free",
            ),
            (
                "--blackout-s 0.5 --robot panda",
                "--blackout-s goes with --robot free",
            ),
            (
                "--robot urdf --edge 1",
                "--edge does not go with --robot urdf",
            ),
            ("--jobs 4", "--jobs goes with --robot fci"),
            (
                "--noise 1 --robot fci",
                "--noise does not go with --robot fci",
            ),
        ] {
            let message = refusal(flags).unwrap();
            assert!(message.contains(words), "{flags}: {message}");
        }
    }
}
