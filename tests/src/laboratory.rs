//! The robot experiment with rendered images and the errors of a laboratory: `hw-sim`, `vpc-camera`
//! and `vpcd` as processes in lockstep, which takes less time than the runs do.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use hw_sim::following::FollowingReport;
use hw_sim::motion::MotionKeys;
use ipc::{Domain, Subscriber};
use messages::CycleRecord;
use scene::Scene;
use serde::Serialize;
use toml::{Table, Value};

use crate::children::{Children, Running};
use crate::column::{self, Column, Shown};
use crate::film::Film;
use crate::flaw::Flaw;
use crate::processes::{self, Run, Summary, absolute};
use crate::statistics::wilson;

/// Laboratories among which the starts of a row are dealt out; each has its own seed and signs of
/// errors, and its arm goes on from start to start.
const LABORATORIES: usize = 4;
/// Longest time without a verdict, on the machine's clock.
const PATIENCE: Duration = Duration::from_secs(300);
/// Between two looks at a laboratory.
const LOOK: Duration = Duration::from_millis(20);
/// ... that is filmed.
const SHORT_LOOK: Duration = Duration::from_millis(2);

/// What all rows have in common.
pub struct Setup<'a> {
    /// Who ends the processes.
    pub children: &'a Children,
    /// Where the programs are.
    pub programs: &'a Path,
    /// A directory to work in.
    pub place: &'a Path,
    /// The scene file.
    pub scene: &'a Path,
    /// A line of a file of starts for each run.
    pub starts: &'a [String],
    /// The first line of that file.
    pub head: &'a str,
    /// The file of the memory.
    pub memory: &'a Path,
    /// Keys of `[law]` that go over `controller/vpcd-tags.toml`.
    pub law: &'a Table,
    /// How the pattern moves.
    pub motion: &'a [MotionKeys],
    /// How long the following is measured after the arrival, s.
    pub follow_s: f64,
    /// Of the first laboratory; the others count on.
    pub seed: u64,
    /// Laboratories at work at a time.
    pub jobs: usize,
    /// Where the film of the first laboratory goes, without its ending.
    pub film: Option<&'a Path>,
}

/// Flaws with their levels.
pub type Levels<'a> = [(&'a Flaw, f64)];

/// A row: many runs with the same errors.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The errors.
    pub errors: String,
    /// Arrivals, failures and trouble.
    #[serde(flatten)]
    pub summary: Summary,
    /// The 95 % interval of the share that arrived (Wilson).
    pub interval: [f64; 2],
    /// Mean time to arrival, s.
    pub arrived_s: Option<f64>,
    /// Largest share of the joints' speed limits in any run.
    pub joint_speed: f64,
    /// Share of the time in which the robot's bridge slowed the camera down, of all runs together.
    pub slowed: f64,
    /// Least clearance of a point in any run, px.
    pub least_clearance_px: f64,
    /// How well the runs that arrived followed, all their frames together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<FollowingReport>,
    /// Whether that was asked for.
    #[serde(skip)]
    pub is_following: bool,
}

/// Runs all starts with these errors.
///
/// # Errors
/// A process cannot be started, ends early, or tells nothing.
pub fn row(setup: &Setup<'_>, name: &str, levels: &Levels<'_>) -> anyhow::Result<Row> {
    let work = |number: usize| {
        let starts = (0..setup.starts.len()).filter(|i| i % LABORATORIES == number);
        let starts: Vec<usize> = starts.collect();
        let laboratory = Laboratory {
            setup,
            levels,
            number: setup.seed + number as u64,
            place: &setup.place.join(format!("laboratory-{number}")),
            starts: &starts,
        };
        let done = laboratory.run().with_context(|| name.to_owned())?;
        Ok(starts.into_iter().zip(done).collect::<Vec<_>>())
    };
    let busy = setup.starts.len().min(LABORATORIES);
    let mut runs = processes::each(setup.jobs, busy, work)?.concat();
    runs.sort_by_key(|(start, _)| *start);
    let summary = Summary::of(&runs);
    let all = || runs.iter().map(|(_, run)| run);
    Ok(Row {
        errors: name.to_owned(),
        interval: wilson(summary.arrived, summary.runs),
        summary,
        arrived_s: processes::arrival_s(all().filter(|run| run.is_good())),
        joint_speed: processes::largest(&runs, |arm| arm.joint_velocity),
        slowed: processes::slowed(runs.iter().map(|(_, run)| &run.arm)),
        least_clearance_px: all()
            .map(|run| run.least_clearance_px)
            .fold(f64::INFINITY, f64::min),
        following: FollowingReport::of(
            all()
                .filter(|run| run.is_good())
                .filter_map(|run| run.following.as_ref()),
        ),
        is_following: setup.follow_s > 0.0,
    })
}

/// Three processes, and the starts that they run one after another.
struct Laboratory<'a> {
    setup: &'a Setup<'a>,
    levels: &'a Levels<'a>,
    number: u64,
    place: &'a Path,
    starts: &'a [usize],
}

impl Laboratory<'_> {
    fn run(&self) -> anyhow::Result<Vec<Run>> {
        if self.place.exists() {
            fs::remove_dir_all(self.place)?;
        }
        let domain = self.place.join("domain");
        fs::create_dir_all(&domain)?;
        self.configure()?;
        let joined = Domain::join(&domain)?;
        let mut holds = Holds::open(&joined)?;
        let film = self.setup.film.filter(|_| self.number == self.setup.seed);
        let film = film
            .map(|path| anyhow::Ok((path, Film::open(&joined, Scene::read(self.setup.scene)?)?)));
        let mut film = film.transpose()?;
        let daemon = self.begin("vpcd")?;
        let camera = self.begin("vpc-camera")?;
        let hw_sim = self.begin("hw-sim")?;
        let (mut runs, mut news) = (Vec::<Run>::new(), Instant::now());
        while runs.len() < self.starts.len() {
            thread::sleep(if film.is_some() { SHORT_LOOK } else { LOOK });
            holds.look()?;
            if let Some((_, film)) = &mut film {
                film.look()?;
            }
            let told = fs::read_to_string(self.place.join("hw-sim.out"))?;
            let lines = told.split_inclusive('\n').filter(|x| x.ends_with('\n'));
            let lines: Vec<&str> = lines.collect();
            for line in &lines[runs.len()..] {
                runs.push(serde_json::from_str(line)?);
                news = Instant::now();
            }
            if news.elapsed() > PATIENCE || hw_sim.has_ended() && runs.len() < self.starts.len() {
                bail!(
                    "no verdict from start {}; the processes said:\n{}",
                    runs.len(),
                    processes::words(self.place, &["hw-sim", "vpc-camera", "vpcd"])
                );
            }
        }
        holds.look()?;
        drop((hw_sim, camera, daemon));
        if let Some((path, film)) = film {
            film.write(path)?;
        }
        for (run, holds) in runs.iter_mut().zip(&holds.runs) {
            let most = holds.iter().max_by_key(|(_, cycles)| **cycles);
            let most = most.map(|(hold, cycles)| format!("{hold}, {cycles} cycles"));
            run.notes.extend(most);
        }
        fs::remove_dir_all(self.place)?;
        Ok(runs)
    }

    fn begin(&self, name: &'static str) -> anyhow::Result<Running<'_>> {
        let path = |name: &str| self.place.join(name);
        let mut command = testkit::command(self.setup.programs.join(name));
        command
            .arg("--config")
            .arg(path(&format!("{name}.toml")))
            .args(["--clock", "lockstep", "--domain"])
            .arg(path("domain"));
        if name == "hw-sim" {
            command.arg("--all");
        }
        processes::begin(self.setup.children, self.place, name, command)
    }

    /// Writes what the processes read: the shipped configurations with this scene, the errors, and
    /// what is told of them.
    fn configure(&self) -> anyhow::Result<()> {
        let Setup {
            scene,
            memory,
            starts,
            head,
            ..
        } = *self.setup;
        let shipped = |path: &str| processes::read_table(&crate::root().join(path));
        let mut lines = vec![head];
        lines.extend(self.starts.iter().map(|&i| starts[i].as_str()));
        let own = self.place.join("starts.csv");
        fs::write(&own, lines.join("\n") + "\n")?;

        let mut hw_sim = shipped("hw-sim/hw-sim-tags.toml")?;
        // The shutter's readout is one of the errors.
        hw_sim.insert("readout_ms".to_owned(), 0.0.into());
        let mut told = calibration(scene)?;
        for (flaw, level) in self.levels {
            flaw.add(*level, self.number, &mut hw_sim, &mut told)?;
        }
        let motion = self.setup.motion.iter().map(Value::try_from);
        let motion: Result<Vec<Value>, _> = motion.collect();
        hw_sim.insert("motion".to_owned(), Value::Array(motion?));
        hw_sim.insert("follow_s".to_owned(), self.setup.follow_s.into());
        hw_sim.insert("scene".to_owned(), absolute(scene)?.into());
        hw_sim.insert("starts".to_owned(), absolute(&own)?.into());
        hw_sim.insert("seed".to_owned(), i64::try_from(self.number)?.into());
        self.write("hw-sim.toml", &hw_sim)?;

        let mut camera = shipped("ipc/clients/camera/vpc-camera.toml")?;
        self.write("calibration.toml", &told)?;
        camera.insert("scene".to_owned(), absolute(scene)?.into());
        camera.insert("source".to_owned(), "shm".into());
        camera.insert("calibration".to_owned(), "calibration.toml".into());
        self.write("vpc-camera.toml", &camera)?;

        let (shipped, law) = ("controller/vpcd-tags.toml", self.setup.law.clone());
        let daemon = processes::daemon(shipped, scene, Some(memory), law)?;
        self.write("vpcd.toml", &daemon)
    }

    fn write(&self, name: &str, keys: &Table) -> anyhow::Result<()> {
        Ok(fs::write(self.place.join(name), toml::to_string(keys)?)?)
    }
}

/// A calibration that found what the scene says, and no distortion.
fn calibration(scene: &Path) -> anyhow::Result<Table> {
    let scene = processes::read_table(scene)?;
    let camera = scene.get("camera").and_then(Value::as_table);
    let camera = camera.context("a scene without [camera]")?;
    let keys = ["fx", "fy", "cx", "cy", "width", "height"];
    let mut told: Table = keys
        .into_iter()
        .filter_map(|key| Some((key.to_owned(), camera.get(key)?.clone())))
        .collect();
    told.insert("distortion".to_owned(), Value::Array(vec![0.0.into(); 5]));
    Ok(told)
}

/// For what `vpcd` holds the camera, run after run.
struct Holds {
    cycles: Subscriber<CycleRecord>,
    /// Number of the newest frame that was answered.
    frame: u64,
    runs: Vec<BTreeMap<String, usize>>,
}

impl Holds {
    fn open(domain: &Domain) -> anyhow::Result<Self> {
        Ok(Self {
            cycles: domain.subscriber(usize::MAX)?,
            frame: 0,
            runs: Vec::new(),
        })
    }

    /// Counts the cycles since the last look. A frame that is not newer begins another run.
    fn look(&mut self) -> anyhow::Result<()> {
        while let Some(cycle) = self.cycles.oldest()? {
            let frame = cycle.features_seen.sequence;
            if frame == 0 {
                continue;
            }
            if self.runs.is_empty() || frame < self.frame {
                self.runs.push(BTreeMap::new());
            }
            self.frame = frame;
            let hold = cycle.hold();
            if let (Some(hold), Some(run)) = (hold, self.runs.last_mut()) {
                *run.entry(hold.to_string()).or_default() += 1;
            }
        }
        Ok(())
    }
}

const IS_FOLLOWING: Shown<Row> = |_, row| row.is_following;

/// The columns in their order.
const COLUMNS: [Column<Row>; 13] = [
    Column::always("errors", |row| row.errors.clone()),
    Column::always("arrived", |row| {
        format!("{} of {}", row.summary.arrived, row.summary.runs)
    }),
    Column::always("95 % interval (%)", |row| {
        let [low, high] = row.interval.map(|share| 100.0 * share);
        format!("{low:.1} to {high:.1}")
    }),
    Column::always("reflexes", |row| row.summary.trouble[0].to_string()),
    Column::always("limit violations", |row| row.summary.trouble[1].to_string()),
    Column::always("discontinuities", |row| row.summary.trouble[2].to_string()),
    Column::always("arrival (s)", |row| column::seconds(row.arrived_s)),
    Column::always("least clearance (px)", |row| {
        format!("{:.1}", row.least_clearance_px)
    }),
    Column::when("follows to (px RMS, most)", IS_FOLLOWING, |row| {
        column::followed_px(row.following.as_ref())
    }),
    Column::when("(mm RMS: camera, object)", IS_FOLLOWING, |row| {
        column::followed_mm(row.following.as_ref())
    }),
    Column::when("change a frame", IS_FOLLOWING, |row| {
        column::followed_change(row.following.as_ref())
    }),
    Column::always("joint speed (% of limit)", |row| {
        format!("{:.0}", 100.0 * row.joint_speed)
    }),
    Column::always("slowed by the bridge (% of time)", |row| {
        format!("{:.2}", 100.0 * row.slowed)
    }),
];

/// The rows as a Markdown table, and what failed.
pub fn markdown(rows: &[Row]) -> String {
    let failed = rows.iter().map(|row| row.summary.failures(&row.errors));
    column::markdown(&COLUMNS, rows, true) + &failed.collect::<String>()
}

/// Where a run works: its processes' files.
pub fn place() -> PathBuf {
    std::env::temp_dir().join(format!("vpc-laboratory-{}", std::process::id()))
}
