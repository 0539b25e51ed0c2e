//! `cargo table -- --robot fci`: strategies on the same starts with `vpcd`, `vpc-panda` and
//! `hw-sim --fci` as processes, in real time, with the law's settings of
//! `controller/vpcd-robot.toml`.

use std::fs;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use hw_sim::outcome::Verdict;
use serde::{Deserialize, Serialize};

use crate::children::Children;
use crate::column::{self, Column};
use crate::flags::Common;
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

/// What a run came to: of `hw-sim`'s line what stands in the table.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct FciRun {
    /// `arrived`, or why not.
    pub verdict: Verdict,
    /// Seconds until the features were at the goal.
    pub arrived_s: Option<f64>,
    /// Least signed distance of a point from an occlusion or the border, px.
    pub least_clearance_px: f64,
    /// What the robot's referee reports.
    pub arm: ArmReport,
    /// The exit code of `vpc-panda` after SIGTERM, with an arm that stands: 0.
    #[serde(default)]
    pub bridge: Option<i32>,
    /// The last warning of `vpcd`, where it did not arrive.
    #[serde(default)]
    pub warning: Option<String>,
}

/// See `hw_sim::robot::inspector::ArmReport`.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[allow(missing_docs)]
pub struct ArmReport {
    pub reflexes: u64,
    pub limit_violations: u64,
    pub discontinuities: u64,
    pub errors: Vec<String>,
    pub joint_velocity: f64,
    pub joint_acceleration: f64,
    pub joint_jerk: f64,
}

/// A row.
#[derive(Clone, Debug, Serialize)]
pub struct FciRow {
    /// Strategy and window.
    pub strategy: String,
    /// What the bridge commanded.
    pub interface: String,
    /// Runs, and those that arrived without a reflex and within all limits.
    pub runs: usize,
    /// See `runs`.
    pub arrived: usize,
    /// Starts that did not, with their verdicts and the robot's errors.
    pub failed: Vec<(usize, String)>,
    /// Reflexes, milliseconds beyond a limit, and with a discontinuity; of all runs.
    pub trouble: [u64; 3],
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
            let runs = Mutex::new(Vec::new());
            let next = AtomicUsize::new(0);
            let work = |job: u16| -> anyhow::Result<()> {
                loop {
                    let start = next.fetch_add(1, Ordering::Relaxed);
                    if start >= setup.starts.1 {
                        return Ok(());
                    }
                    let place = place.join(format!("{spec}-{interface}-{start}"));
                    let trio = Trio {
                        setup,
                        programs: &programs,
                        place: &place,
                        // Of this program and of this job.
                        address: format!("127.1.{}.{}", std::process::id() % 256, job + 1),
                    };
                    let run = trio.run(spec, interface, start);
                    let run = run.with_context(|| format!("{spec}, {interface}, start {start}"));
                    let mut runs = runs
                        .lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner);
                    runs.push((start, run?));
                    tick();
                }
            };
            thread::scope(|scope| {
                let jobs = (0..setup.flags.jobs).map(|job| scope.spawn(move || work(job)));
                let jobs: Vec<_> = jobs.collect();
                for job in jobs {
                    match job.join() {
                        Ok(done) => done?,
                        Err(_) => bail!("a job panicked"),
                    }
                }
                anyhow::Ok(())
            })?;
            let mut runs = runs.into_inner().unwrap_or_default();
            runs.sort_by_key(|(start, _)| *start);
            rows.push(row(spec, interface, &runs));
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
    fn run(&self, spec: Spec, interface: &str, start: usize) -> anyhow::Result<FciRun> {
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
            command.stdout(fs::File::create(path(&format!("{name}.out")))?);
            command.stderr(fs::File::create(path(&format!("{name}.err")))?);
            command.stdin(Stdio::null());
            children.start(name, command)
        };
        fs::write(path("vpcd.toml"), self.configuration(spec)?)?;
        let vpcd = begin("vpcd", &["--arm", "--config", &text(&path("vpcd.toml"))])?;
        let at = format!("{}:{PORT}", self.address);
        let scene = text(&fs::canonicalize(self.setup.scene)?);
        let starts = text(&fs::canonicalize(self.setup.starts.0)?);
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
        let hand_eye = text(&crate::root().join("ipc/clients/panda/hand-eye.toml"));
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
        let mut run: FciRun = serde_json::from_str(&told)?;
        run.bridge = bridge;
        if run.verdict != Verdict::Arrived {
            let log = fs::read_to_string(path("vpcd.err"))?;
            let warning = log.lines().rfind(|line| line.contains(" WARN "));
            run.warning = warning.map(str::to_owned);
        }
        fs::remove_dir_all(self.place)?;
        Ok(run)
    }

    fn wait(&self, since: Instant, what: &str) -> anyhow::Result<()> {
        if since.elapsed() > PATIENCE {
            let said = |name: &str| fs::read_to_string(self.place.join(name)).unwrap_or_default();
            let said = said("hw-sim.err") + &said("vpc-panda.err") + &said("vpcd.err");
            bail!("{what} within {PATIENCE:?}; the processes said:\n{said}");
        }
        thread::sleep(LOOK);
        Ok(())
    }

    /// `controller/vpcd-robot.toml` with this scene, memory and strategy.
    fn configuration(&self, spec: Spec) -> anyhow::Result<String> {
        let file = crate::root().join("controller/vpcd-robot.toml");
        let mut table: toml::Table = toml::from_str(&fs::read_to_string(file)?)?;
        let path = |file: &Path| Ok::<_, std::io::Error>(text(&fs::canonicalize(file)?).into());
        table.insert("scene".to_owned(), path(self.setup.scene)?);
        match self.setup.memory {
            Some(memory) => table.insert("memory".to_owned(), path(memory)?),
            None => table.remove("memory"),
        };
        let law = table.get_mut("law").and_then(toml::Value::as_table_mut);
        let law = law.context("vpcd-robot.toml without [law]")?;
        law.insert("strategy".to_owned(), spec.strategy.to_string().into());
        law.insert("np".to_owned(), i64::try_from(spec.np)?.into());
        Ok(toml::to_string(&table)?)
    }
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

fn row(spec: Spec, interface: &str, runs: &[(usize, FciRun)]) -> FciRow {
    let is_good = |run: &FciRun| run.verdict == Verdict::Arrived && run.arm.reflexes == 0;
    let sum = |what: fn(&ArmReport) -> u64| runs.iter().map(|(_, run)| what(&run.arm)).sum();
    let most = |share: fn(&ArmReport) -> f64| {
        let shares = runs.iter().map(|(_, run)| share(&run.arm));
        shares.fold(0.0, f64::max)
    };
    let times: Vec<f64> = runs.iter().filter_map(|(_, run)| run.arrived_s).collect();
    let bad = runs.iter().filter(|(_, run)| !is_good(run));
    FciRow {
        strategy: spec.to_string(),
        interface: interface.to_owned(),
        runs: runs.len(),
        arrived: runs.iter().filter(|(_, run)| is_good(run)).count(),
        failed: bad.map(|(start, run)| (*start, why(run))).collect(),
        trouble: [
            sum(|arm| arm.reflexes),
            sum(|arm| arm.limit_violations),
            sum(|arm| arm.discontinuities),
        ],
        bridges: runs.iter().filter(|(_, run)| run.bridge != Some(0)).count(),
        arrived_s: (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64),
        joint_shares: [
            most(|arm| arm.joint_velocity),
            most(|arm| arm.joint_acceleration),
            most(|arm| arm.joint_jerk),
        ],
    }
}

fn why(run: &FciRun) -> String {
    let verdict = run.verdict.to_string();
    let words = std::iter::once(&verdict).chain(&run.arm.errors);
    let words = words.chain(&run.warning);
    words.map(String::as_str).collect::<Vec<_>>().join(" ")
}

/// The columns in their order. A new figure is a field of [`FciRow`] and a line here.
const COLUMNS: [Column<FciRow>; 9] = [
    Column::always("strategy", |row| row.strategy.clone()),
    Column::always("interface", |row| row.interface.clone()),
    Column::always("arrived", |row| format!("{} of {}", row.arrived, row.runs)),
    Column::always("arrival (s)", |row| {
        row.arrived_s.map_or("-".to_owned(), |s| format!("{s:.1}"))
    }),
    Column::always("reflexes", |row| row.trouble[0].to_string()),
    Column::wide("limit violations", |row| row.trouble[1].to_string()),
    Column::wide("discontinuities", |row| row.trouble[2].to_string()),
    Column::wide("bridges not at exit 0", |row| row.bridges.to_string()),
    Column::wide("joint speed, acceleration, jerk (% of limit)", |row| {
        let [speed, push, snap] = row.joint_shares.map(|share| 100.0 * share);
        format!("{speed:.0}, {push:.0}, {snap:.0}")
    }),
];

/// The rows as a Markdown table; a wide one with what failed.
pub fn markdown(rows: &[FciRow], is_wide: bool) -> String {
    let mut text = column::markdown(&COLUMNS, rows, is_wide);
    let failed = rows.iter().filter(|row| is_wide && !row.failed.is_empty());
    for row in failed {
        let starts = row
            .failed
            .iter()
            .map(|(start, why)| format!("{start} ({why})"));
        let starts = starts.collect::<Vec<_>>().join(", ");
        text += &format!(
            "\n{}, {}: failed from {starts}\n",
            row.strategy, row.interface
        );
    }
    text
}
