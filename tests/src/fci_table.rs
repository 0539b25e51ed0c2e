//! `cargo table -- --robot fci`: strategies on the same starts with `vpcd`, `vpc-panda` and
//! `hw-sim --fci` as processes, in real time, with the law's settings of
//! `controller/vpcd-robot.toml`.

use std::fs;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use hw_sim::outcome::Verdict;
use serde::Serialize;
use toml::Table;

use crate::children::Children;
use crate::column::{self, Column};
use crate::flags::Common;
use crate::processes::{self, Run, Summary, absolute};
use crate::spec::Spec;

/// The robot behind the vendor's interface.
#[derive(Args, Clone, Debug)]
pub struct FciFlags {
    /// What the bridge commands: joint velocities, or those of the end effector.
    #[arg(long, value_delimiter = ',', default_value = "joint,cartesian", value_parser = ["joint", "cartesian"])]
    pub interfaces: Vec<String>,
    /// Version of the interface: 5, a Panda's, or 10, an FR3's.
    #[arg(long, default_value = "5", value_parser = ["5", "10"])]
    pub fci_version: String,
    /// Runs at a time; each takes the time that it takes, and a third of a processor.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=16))]
    pub jobs: u16,
}

/// Longest time for a run on the machine's clock: the scene's several times.
const PATIENCE: Duration = Duration::from_secs(180);
/// Between two looks at a run.
const LOOK: Duration = Duration::from_millis(50);
/// The vendor's clients know no other port.
const PORT: u16 = 1337;

/// A row.
#[derive(Clone, Debug, Serialize)]
pub struct FciRow {
    /// Strategy and window.
    pub strategy: String,
    /// What the bridge commanded.
    pub interface: String,
    /// Arrivals, failures and trouble.
    #[serde(flatten)]
    pub summary: Summary,
    /// Runs after which the bridge did not end with exit code 0.
    pub bridges: usize,
    /// Mean time to arrival, s.
    pub arrived_s: Option<f64>,
    /// Largest shares of the joints' limits in any run: speed, acceleration, jerk.
    pub joint_shares: [f64; 3],
}

/// What all runs have in common.
#[derive(Clone, Copy)]
pub struct Setup<'a> {
    /// Who ends the processes.
    pub children: &'a Children,
    /// The scene file.
    pub scene: &'a Path,
    /// The file of starts, and how many there are.
    pub starts: (&'a Path, usize),
    /// The file of the memory.
    pub memory: Option<&'a Path>,
    /// Strategies and seed.
    pub common: &'a Common,
    /// The robot.
    pub flags: &'a FciFlags,
}

/// Runs every strategy by every interface on every start.
///
/// # Errors
/// A process cannot be started, or tells nothing.
pub fn table(setup: &Setup, tick: &(dyn Fn() + Sync)) -> anyhow::Result<Vec<FciRow>> {
    let programs = setup.children.build(&["vpcd", "hw-sim", "vpc-panda"])?;
    let place = std::env::temp_dir().join(format!("vpc-table-{}", std::process::id()));
    let _place = setup.children.place(place.clone());
    let mut rows = Vec::new();
    for &spec in &setup.common.strategies {
        for interface in &setup.flags.interfaces {
            let work = |start: usize| {
                let job = rayon::current_thread_index().unwrap_or(0);
                let trio = Trio {
                    setup,
                    programs: &programs,
                    place: &place.join(format!("{spec}-{interface}-{start}")),
                    // Of this program and of this job.
                    address: format!("127.1.{}.{}", std::process::id() % 256, job + 1),
                };
                let run = trio.run(spec, interface, start);
                tick();
                run.with_context(|| format!("{spec}, {interface}, start {start}"))
            };
            let runs = processes::each(setup.flags.jobs.into(), setup.starts.1, work)?;
            rows.push(row(spec, interface, runs));
        }
    }
    Ok(rows)
}

/// The three processes of a run.
struct Trio<'a> {
    setup: &'a Setup<'a>,
    programs: &'a PathBuf,
    place: &'a Path,
    address: String,
}

impl Trio<'_> {
    /// The run, and the exit code of `vpc-panda` after SIGTERM, with an arm that stands: 0.
    fn run(&self, spec: Spec, interface: &str, start: usize) -> anyhow::Result<(Run, Option<i32>)> {
        let Setup {
            children, flags, ..
        } = self.setup;
        let path = |name: &str| self.place.join(name);
        fs::create_dir_all(self.place)?;
        let robot = match flags.fci_version.as_str() {
            "5" => "panda",
            _ => "fr3",
        };
        let begin = |name: &'static str, arguments: &[&str]| {
            let mut command = testkit::command(self.programs.join(name));
            command.args(arguments).arg("--domain").arg(path("domain"));
            processes::begin(children, self.place, name, command)
        };
        let mut law = Table::new();
        law.insert("strategy".to_owned(), spec.strategy.to_string().into());
        law.insert("np".to_owned(), i64::try_from(spec.np)?.into());
        let (shipped, memory) = ("controller/vpcd-robot.toml", self.setup.memory);
        let daemon = processes::daemon(shipped, self.setup.scene, memory, law)?;
        fs::write(path("vpcd.toml"), toml::to_string(&daemon)?)?;
        let vpcd = begin(
            "vpcd",
            &["--arm", "--config", &absolute(&path("vpcd.toml"))?],
        )?;
        let at = format!("{}:{PORT}", self.address);
        let scene = absolute(self.setup.scene)?;
        let starts = absolute(self.setup.starts.0)?;
        let hw_sim = begin(
            "hw-sim",
            &[
                "--robot",
                "panda",
                "--fci",
                &at,
                "--fci-version",
                &flags.fci_version,
                "--scene",
                &scene,
                "--starts",
                &starts,
                "--start",
                &start.to_string(),
            ],
        )?;
        let begun = Instant::now();
        while TcpStream::connect(&at).is_err() {
            self.wait(begun, "hw-sim does not listen")?;
        }
        let hand_eye = absolute(&crate::root().join("ipc/clients/panda/hand-eye.toml"))?;
        let robot = format!("{robot}:{}", self.address);
        let panda = begin(
            "vpc-panda",
            &[
                "--robot",
                &robot,
                "--scene",
                &scene,
                "--hand-eye",
                &hand_eye,
                "--interface",
                interface,
            ],
        )?;
        let told = loop {
            let told = fs::read_to_string(path("hw-sim.out"))?;
            if told.ends_with('\n') {
                break told;
            }
            self.wait(begun, "no verdict")?;
        };
        let bridge = panda.terminate()?.code();
        drop((hw_sim, vpcd));
        let mut run: Run = serde_json::from_str(&told)?;
        if run.verdict != Verdict::Arrived {
            let log = fs::read_to_string(path("vpcd.err"))?;
            let warning = log.lines().rfind(|line| line.contains(" WARN "));
            run.notes.extend(warning.map(str::to_owned));
        }
        fs::remove_dir_all(self.place)?;
        Ok((run, bridge))
    }

    fn wait(&self, since: Instant, what: &str) -> anyhow::Result<()> {
        if since.elapsed() > PATIENCE {
            let said = processes::words(self.place, &["hw-sim", "vpc-panda", "vpcd"]);
            bail!("{what} within {PATIENCE:?}; the processes said:\n{said}");
        }
        thread::sleep(LOOK);
        Ok(())
    }
}

fn row(spec: Spec, interface: &str, runs: Vec<(Run, Option<i32>)>) -> FciRow {
    let bridges = runs.iter().filter(|(_, code)| *code != Some(0)).count();
    let runs: Vec<_> = runs.into_iter().map(|(run, _)| run).enumerate().collect();
    FciRow {
        strategy: spec.to_string(),
        interface: interface.to_owned(),
        summary: Summary::of(&runs),
        bridges,
        arrived_s: processes::arrival_s(runs.iter().map(|(_, run)| run)),
        joint_shares: [
            processes::largest(&runs, |arm| arm.joint_velocity),
            processes::largest(&runs, |arm| arm.joint_acceleration),
            processes::largest(&runs, |arm| arm.joint_jerk),
        ],
    }
}

/// The columns in their order. A new figure is a field of [`FciRow`] and a line here.
const COLUMNS: [Column<FciRow>; 9] = [
    Column::always("strategy", |row| row.strategy.clone()),
    Column::always("interface", |row| row.interface.clone()),
    Column::always("arrived", |row| {
        format!("{} of {}", row.summary.arrived, row.summary.runs)
    }),
    Column::always("arrival (s)", |row| column::seconds(row.arrived_s)),
    Column::always("reflexes", |row| row.summary.trouble[0].to_string()),
    Column::wide("limit violations", |row| row.summary.trouble[1].to_string()),
    Column::wide("discontinuities", |row| row.summary.trouble[2].to_string()),
    Column::wide("bridges not at exit 0", |row| row.bridges.to_string()),
    Column::wide("joint speed, acceleration, jerk (% of limit)", |row| {
        let [speed, push, snap] = row.joint_shares.map(|share| 100.0 * share);
        format!("{speed:.0}, {push:.0}, {snap:.0}")
    }),
];

/// The rows as a Markdown table; a wide one with what failed.
pub fn markdown(rows: &[FciRow], is_wide: bool) -> String {
    let mut text = column::markdown(&COLUMNS, rows, is_wide);
    for row in rows.iter().filter(|_| is_wide) {
        text += &row
            .summary
            .failures(&format!("{}, {}", row.strategy, row.interface));
    }
    text
}
