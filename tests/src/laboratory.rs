//! The robot experiment with rendered images and the errors of a laboratory: `hw-sim`, `vpc-camera`
//! and `vpcd` as processes in lockstep, which takes less time than the runs do.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use hw_sim::outcome::Verdict;
use ipc::{Domain, Subscriber};
use messages::CycleRecord;
use scene::Scene;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::children::{Children, Running};
use crate::film::Film;
use crate::flaw::Flaw;
use crate::row::wilson;

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
    /// Of the first laboratory; the others count on.
    pub seed: u64,
    /// Laboratories at work at a time.
    pub jobs: usize,
    /// Where the film of the first laboratory goes, without its ending.
    pub film: Option<&'a Path>,
}

/// Flaws with their levels.
pub type Levels<'a> = [(&'a Flaw, f64)];

/// Of `hw-sim`'s line what stands in the table.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Run {
    /// `arrived`, or why not.
    pub verdict: Verdict,
    /// Seconds until the features were at the goal.
    pub arrived_s: Option<f64>,
    /// Least signed distance of a point from an occlusion or the border, px.
    pub least_clearance_px: f64,
    /// What the robot's referee reports.
    pub arm: ArmReport,
    /// Cycles in which `vpcd` held the camera, by the cause.
    #[serde(default)]
    pub holds: BTreeMap<String, usize>,
}

/// See `hw_sim::robot::inspector::ArmReport`.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[allow(missing_docs)]
pub struct ArmReport {
    pub reflexes: u64,
    pub limit_violations: u64,
    pub discontinuities: u64,
    pub joint_velocity: f64,
    pub errors: Vec<String>,
    pub joint_room: f64,
}

/// A row: many runs with the same errors.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The errors.
    pub errors: String,
    /// Runs, and those that arrived.
    pub runs: usize,
    /// See `runs`.
    pub arrived: usize,
    /// The 95 % interval of the share that arrived (Wilson).
    pub interval: [f64; 2],
    /// Reflexes, milliseconds beyond a limit, and with a discontinuity; of all runs.
    pub trouble: [u64; 3],
    /// Mean time to arrival, s.
    pub arrived_s: Option<f64>,
    /// Largest share of the joints' speed limits in any run.
    pub joint_speed: f64,
    /// Least clearance of a point in any run, px.
    pub least_clearance_px: f64,
    /// Runs that did not arrive: their starts, verdicts, the robot's errors, and for what `vpcd` held
    /// the camera most often.
    pub failed: Vec<(usize, String)>,
}

/// Runs all starts with these errors.
///
/// # Errors
/// A process cannot be started, ends early, or tells nothing.
pub fn row(setup: &Setup<'_>, name: &str, levels: &Levels<'_>) -> anyhow::Result<Row> {
    let (runs, next) = (Mutex::new(Vec::new()), AtomicUsize::new(0));
    let work = || -> anyhow::Result<()> {
        loop {
            let laboratory = next.fetch_add(1, Ordering::Relaxed);
            if laboratory >= LABORATORIES {
                return Ok(());
            }
            let place = setup.place.join(format!("laboratory-{laboratory}"));
            let starts = (0..setup.starts.len()).filter(|i| i % LABORATORIES == laboratory);
            let starts: Vec<usize> = starts.collect();
            if starts.is_empty() {
                continue;
            }
            let laboratory = Laboratory {
                setup,
                levels,
                number: setup.seed + laboratory as u64,
                place: &place,
                starts: &starts,
            };
            let done = laboratory.run().with_context(|| name.to_owned())?;
            let mut runs = runs.lock().unwrap_or_else(PoisonError::into_inner);
            runs.extend(starts.into_iter().zip(done));
        }
    };
    thread::scope(|scope| {
        let jobs: Vec<_> = (0..setup.jobs.max(1)).map(|_| scope.spawn(work)).collect();
        for job in jobs {
            match job.join() {
                Ok(done) => done?,
                Err(_) => bail!("a job panicked"),
            }
        }
        anyhow::Ok(())
    })?;
    let mut runs = runs.into_inner().unwrap_or_else(PoisonError::into_inner);
    runs.sort_by_key(|(start, _)| *start);
    Ok(Row::of(name, &runs))
}

impl Row {
    fn of(name: &str, runs: &[(usize, Run)]) -> Self {
        let is_good = |run: &Run| run.verdict == Verdict::Arrived && run.arm.reflexes == 0;
        let arrived = runs.iter().filter(|(_, run)| is_good(run)).count();
        let sum = |what: fn(&ArmReport) -> u64| runs.iter().map(|(_, run)| what(&run.arm)).sum();
        let good = runs.iter().filter(|(_, run)| is_good(run));
        let times: Vec<f64> = good.filter_map(|(_, run)| run.arrived_s).collect();
        let bad = runs.iter().filter(|(_, run)| !is_good(run));
        Self {
            errors: name.to_owned(),
            runs: runs.len(),
            arrived,
            interval: wilson(arrived, runs.len()),
            trouble: [
                sum(|arm| arm.reflexes),
                sum(|arm| arm.limit_violations),
                sum(|arm| arm.discontinuities),
            ],
            arrived_s: (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64),
            joint_speed: runs
                .iter()
                .map(|(_, run)| run.arm.joint_velocity)
                .fold(0.0, f64::max),
            least_clearance_px: runs
                .iter()
                .map(|(_, run)| run.least_clearance_px)
                .fold(f64::INFINITY, f64::min),
            failed: bad.map(|(start, run)| (*start, why(run))).collect(),
        }
    }
}

/// The verdict, the robot's errors, and for what the camera was held most often.
fn why(run: &Run) -> String {
    let errors = run.arm.errors.iter().cloned();
    let most = run.holds.iter().max_by_key(|(_, cycles)| **cycles);
    let most = most.map(|(hold, cycles)| format!("{hold}, {cycles} cycles"));
    let reasons: Vec<String> = errors.chain(most).collect();
    match reasons.is_empty() {
        true => run.verdict.to_string(),
        false => format!("{}: {}", run.verdict, reasons.join("; ")),
    }
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
        let (mut runs, mut news) = (Vec::new(), Instant::now());
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
                    self.words()
                );
            }
        }
        holds.look()?;
        drop((hw_sim, camera, daemon));
        if let Some((path, film)) = film {
            film.write(path)?;
        }
        for (run, holds) in runs.iter_mut().zip(holds.runs) {
            let Run { holds: told, .. } = run;
            *told = holds;
        }
        fs::remove_dir_all(self.place)?;
        Ok(runs)
    }

    /// What the processes wrote to standard error, the last lines.
    fn words(&self) -> String {
        let tail = |name: &str| {
            let text = fs::read_to_string(self.place.join(format!("{name}.err")));
            let text = text.unwrap_or_default();
            let lines: Vec<&str> = text.lines().collect();
            let last = lines[lines.len().saturating_sub(8)..].join("\n");
            format!("{name}: {last}\n")
        };
        ["hw-sim", "vpc-camera", "vpcd"].map(tail).concat()
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
        command.stdout(fs::File::create(path(&format!("{name}.out")))?);
        command.stderr(fs::File::create(path(&format!("{name}.err")))?);
        command.stdin(Stdio::null());
        self.setup.children.start(name, command)
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
        let path = |path: &Path| Ok::<_, std::io::Error>(text(&fs::canonicalize(path)?));
        let mut lines = vec![head];
        lines.extend(self.starts.iter().map(|&i| starts[i].as_str()));
        let own = self.place.join("starts.csv");
        fs::write(&own, lines.join("\n") + "\n")?;

        let mut hw_sim = shipped("hw-sim/hw-sim-tags.toml")?;
        let mut told = calibration(scene)?;
        for (flaw, level) in self.levels {
            flaw.add(*level, self.number, &mut hw_sim, &mut told)?;
        }
        hw_sim.insert("scene".to_owned(), path(scene)?);
        hw_sim.insert("starts".to_owned(), path(&own)?);
        hw_sim.insert("seed".to_owned(), i64::try_from(self.number)?.into());
        self.write("hw-sim.toml", &hw_sim)?;

        let mut camera = shipped("ipc/clients/camera/vpc-camera.toml")?;
        self.write("calibration.toml", &told)?;
        camera.insert("scene".to_owned(), path(scene)?);
        camera.insert("source".to_owned(), "shm".into());
        camera.insert("calibration".to_owned(), "calibration.toml".into());
        self.write("vpc-camera.toml", &camera)?;

        let mut daemon = shipped("controller/vpcd-tags.toml")?;
        daemon.insert("scene".to_owned(), path(scene)?);
        daemon.insert("memory".to_owned(), path(memory)?);
        let law = daemon.get_mut("law").and_then(Value::as_table_mut);
        let law = law.context("vpcd-tags.toml without [law]")?;
        law.extend(self.setup.law.clone());
        self.write("vpcd.toml", &daemon)
    }

    fn write(&self, name: &str, keys: &Table) -> anyhow::Result<()> {
        Ok(fs::write(self.place.join(name), toml::to_string(keys)?)?)
    }
}

/// A configuration that ships.
fn shipped(path: &str) -> anyhow::Result<Table> {
    let path = crate::root().join(path);
    let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    toml::from_str(&text).with_context(|| path.display().to_string())
}

/// A calibration that found what the scene says, and no distortion.
fn calibration(scene: &Path) -> anyhow::Result<Table> {
    let scene: Table = toml::from_str(&fs::read_to_string(scene)?)?;
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

fn text(path: &Path) -> Value {
    path.display().to_string().into()
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

/// The rows as a Markdown table, and what failed.
pub fn markdown(rows: &[Row]) -> String {
    let mut text = String::from(
        "| errors | arrived | 95 % interval (%) | reflexes | limit violations | discontinuities | arrival (s) | least clearance (px) | joint speed (% of limit) |\n\
         |---|--:|--:|--:|--:|--:|--:|--:|--:|\n",
    );
    for row in rows {
        let [reflexes, limits, discontinuities] = row.trouble;
        let [low, high] = row.interval.map(|share| 100.0 * share);
        text += &format!(
            "| {} | {} of {} | {low:.1} to {high:.1} | {reflexes} | {limits} | {discontinuities} | {} | {:.1} | {:.0} |\n",
            row.errors,
            row.arrived,
            row.runs,
            row.arrived_s.map_or("-".to_owned(), |s| format!("{s:.1}")),
            row.least_clearance_px,
            100.0 * row.joint_speed,
        );
    }
    for row in rows.iter().filter(|row| !row.failed.is_empty()) {
        let failed = row.failed.iter();
        let failed = failed.map(|(start, why)| format!("{start} ({why})"));
        let failed = failed.collect::<Vec<_>>().join(", ");
        text += &format!("\n{}: failed from {failed}\n", row.errors);
    }
    text
}

/// Where a run works: its processes' files.
pub fn place() -> PathBuf {
    std::env::temp_dir().join(format!("vpc-laboratory-{}", std::process::id()))
}
