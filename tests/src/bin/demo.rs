//! `cargo demo`: emulator and daemon as two processes over shared memory, on a start where the memory-less strategy
//! gets stuck; then the comparison of the strategies. With `--scene paper-robot` a Panda carries the camera.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Parser, ValueEnum};
use hw_sim::eye::Sight;
use hw_sim::recording;
use memory_blob::MemoryFile;
use scene::{Scene, read_starts};
use system_tests::children::{self, Children, attended};
use system_tests::pictures;
use system_tests::processes::build;
use system_tests::robot_table::{self, Common, RobotFlags};
use system_tests::row::{Row, markdown};
use system_tests::run::{run, time};
use system_tests::spec::Spec;
use vpc::{Controller, MotionMemory, Settings, Task};

/// What can be shown.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Which {
    /// The paper's simulation: a camera that flies freely.
    PaperSim,
    /// The paper's robot experiment: a Panda, a late camera, a task.
    PaperRobot,
}

impl Which {
    /// Name of scene, starts and memory.
    fn name(self) -> &'static str {
        match self {
            Self::PaperSim => "paper-sim",
            Self::PaperRobot => "paper-robot",
        }
    }

    /// A start where `previous` stays in front of an occlusion and `gpr` gets round it.
    fn telling_start(self) -> usize {
        match self {
            Self::PaperSim => 82,
            Self::PaperRobot => 5,
        }
    }

    /// Configuration of the daemon.
    fn daemon(self) -> &'static str {
        match self {
            Self::PaperSim => "controller/vpcd.toml",
            Self::PaperRobot => "controller/vpcd-robot.toml",
        }
    }

    /// Configuration of the emulator.
    fn emulator(self) -> &'static str {
        match self {
            Self::PaperSim => "hw-sim/hw-sim.toml",
            Self::PaperRobot => "hw-sim/hw-sim-robot.toml",
        }
    }
}

/// Steers the emulated camera round occlusions with vpcd, as two processes over shared memory.
///
/// Builds vpcd and hw-sim, runs the chosen strategy in real time, then compares all strategies on the same start and
/// draws pictures. Exits with 0 only if the goal was reached without a violation.
#[derive(Parser)]
#[command(name = "demo", version)]
struct Cli {
    /// What to show.
    #[arg(long, value_enum, default_value = "paper-sim")]
    scene: Which,
    /// Strategy that steers: previous, knn, gpr, ibvs.
    #[arg(long, default_value = "gpr")]
    strategy: Spec,
    /// Start pose, by its index in the scene's file of starts; one that tells the strategies apart by default.
    #[arg(long)]
    start: Option<usize>,
    /// As fast as the controller instead of in real time.
    #[arg(long)]
    lockstep: bool,
    /// Directory for recording and pictures.
    #[arg(long, default_value = "out/demo")]
    output: PathBuf,
    /// Shows no line of progress.
    #[arg(long)]
    no_progress: bool,
}

fn main() -> ExitCode {
    attended("demo", |children| {
        let arrived = demo(children, &Cli::parse_from(system_tests::arguments()))?;
        Ok(ExitCode::from(u8::from(!arrived)))
    })
}

fn demo(children: &Children, cli: &Cli) -> anyhow::Result<bool> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .context("no workspace")?;
    let scenes = root.join("ipc/scene/scenes");
    let name = cli.scene.name();
    let (scene_path, starts_path) = (
        scenes.join(format!("{name}.toml")),
        scenes.join(format!("{name}-starts.csv")),
    );
    let memory_path = root.join(format!("memory-blob/default/{name}.vpcmem"));
    let scene = Scene::read(&scene_path)?;
    let starts = read_starts(&starts_path)?;
    let index = cli.start.unwrap_or(cli.scene.telling_start());
    let Some(start) = starts.get(index) else {
        bail!("--start = {index}; allowed: 0 to {}", starts.len() - 1);
    };
    fs::create_dir_all(&cli.output).with_context(|| cli.output.display().to_string())?;
    let binaries = build(children, root, &["vpcd", "hw-sim"])?;

    println!(
        "vpcd ({}) and hw-sim, two processes over shared memory: {}, start {index}",
        cli.strategy,
        scene_path.display(),
    );
    // The daemon puts its flight record beside the domain: the end of the camera is a fault to it.
    let here = env::temp_dir().join(format!("vpc-demo-{}", std::process::id()));
    let place = children.place(here.clone());
    fs::create_dir_all(&here).with_context(|| here.display().to_string())?;
    let domain = here.join("domain");
    let clock = if cli.lockstep { "lockstep" } else { "fixed" };
    let recording_path = cli.output.join("run.jsonl");
    let log = fs::File::create(cli.output.join("vpcd.log"))?;
    let mut daemon = children::command(binaries.join("vpcd"));
    daemon
        .arg("--config")
        .arg(root.join(cli.scene.daemon()))
        .arg("--arm")
        .arg("--scene")
        .arg(&scene_path)
        .arg("--strategy")
        .arg(cli.strategy.strategy.to_string())
        .arg("--np")
        .arg(cli.strategy.np.to_string())
        .args(["--clock", clock])
        .arg("--domain")
        .arg(&domain)
        .stderr(log);
    if cli.strategy.strategy.needs_memory() {
        daemon.arg("--memory").arg(&memory_path);
    }
    let daemon = children.start("vpcd", daemon)?;
    let mut emulator = children::command(binaries.join("hw-sim"));
    emulator
        .arg("--config")
        .arg(root.join(cli.scene.emulator()))
        .arg("--scene")
        .arg(&scene_path)
        .arg("--starts")
        .arg(&starts_path)
        .arg("--start")
        .arg(index.to_string())
        .args(["--clock", clock])
        .arg("--domain")
        .arg(&domain)
        .arg("--record")
        .arg(&recording_path)
        .stdout(Stdio::piped());
    if !cli.no_progress {
        emulator.arg("--progress");
    }
    let watch = WayPoints::watch(&domain);
    let (status, verdict) = children.start("hw-sim", emulator)?.output()?;
    let log = || format!("its log is in {}", cli.output.display());
    let stopped = daemon.stop().with_context(log);
    let way_points = watch.end();
    drop(place);
    let verdict = verdict.trim();
    println!(
        "hw-sim: {}",
        if verdict.is_empty() {
            "no verdict; see its message above"
        } else {
            verdict
        }
    );
    stopped?;
    let arrived = status.success();

    println!("\nThe strategies on the same start, in process:\n");
    let mut written = match cli.scene {
        Which::PaperSim => compare(&scene, &memory_path, start, &cli.output)?,
        Which::PaperRobot => compare_on_robot(&scene, &memory_path, &starts, index, &cli.output)?,
    };
    written.extend(draw_recording(&scene, &recording_path, cli, way_points)?);
    for path in written {
        println!("wrote {}", path.display());
    }
    println!(
        "\n{}",
        if arrived {
            "The goal was reached without a violation."
        } else {
            "The goal was NOT reached."
        }
    );
    Ok(arrived)
}

/// Runs the strategies on one start and draws them side by side.
fn compare(
    scene: &Scene,
    memory: &Path,
    start: &scene::Pose,
    output: &Path,
) -> anyhow::Result<Vec<PathBuf>> {
    let task = Task::new(scene)?;
    let memory = MemoryFile::open(memory, Some(scene.fingerprint().bytes()))?;
    let view = memory.view();
    let (mut rows, mut runs) = (Vec::new(), Vec::new());
    for text in ["previous:3", "knn:3", "gpr:3"] {
        let spec: Spec = text.parse().map_err(anyhow::Error::msg)?;
        let mut controller = Box::new(Controller::new(scene, spec.settings())?);
        let memory = Some(&view as &dyn MotionMemory);
        let mut result = run(scene, &mut controller, memory, start);
        time(&mut result, &mut controller, memory, 5)?;
        rows.push(Row::of(spec, std::slice::from_ref(&result)));
        runs.push((text.to_owned(), result));
    }
    println!("{}", markdown(&rows));
    let named = runs.iter().map(|(name, run)| (name.clone(), run));
    let mut written = pictures::comparison(scene, &task, named)
        .canvas()
        .write(&output.join("strategies"))?
        .to_vec();
    written.extend(
        pictures::samples(scene, &task, &memory)
            .canvas()
            .write(&output.join("memory"))?,
    );
    Ok(written)
}

/// Runs the strategies on one start with the emulated robot, in process, and draws them side by side.
fn compare_on_robot(
    scene: &Scene,
    memory: &Path,
    starts: &[scene::Pose],
    start: usize,
    output: &Path,
) -> anyhow::Result<Vec<PathBuf>> {
    let task = Task::new(scene)?;
    let memory = MemoryFile::open(memory, Some(scene.fingerprint().bytes()))?;
    let view = memory.view();
    let strategies: Vec<Spec> = ["previous:3", "gpr:3"]
        .iter()
        .map(|text| text.parse().map_err(anyhow::Error::msg))
        .collect::<anyhow::Result<_>>()?;
    let flags = RobotFlags {
        only: Some(start),
        camera: Sight::Rendered,
        ..RobotFlags::default()
    };
    let common = Common {
        strategies: &strategies,
        noise: 0.3,
        drop: 0.01,
        depth_error: 0.0,
        seed: 1,
        settings: Settings::default(),
    };
    let view = Some(&view as &(dyn MotionMemory + Sync));
    let (document, runs) = robot_table::table(scene, starts, view, &flags, &common, &|| ())?;
    println!("{}", robot_table::markdown(&document));
    let runs = strategies.iter().zip(runs.iter().flatten());
    let named = runs.map(|(spec, run)| (spec.to_string(), run));
    let mut written = pictures::robot_comparison(scene, &task, named)
        .canvas()
        .write(&output.join("strategies"))?
        .to_vec();
    written.extend(
        pictures::samples(scene, &task, &memory)
            .canvas()
            .write(&output.join("memory"))?,
    );
    Ok(written)
}

/// Draws what the two processes did.
fn draw_recording(
    scene: &Scene,
    path: &Path,
    cli: &Cli,
    way_points: Vec<figures::Points>,
) -> anyhow::Result<Vec<PathBuf>> {
    let (head, records) = recording::read(path).with_context(|| path.display().to_string())?;
    let joints = pictures::joints(&records, "joints while vpcd and hw-sim ran");
    // The way to the goal; what comes after the release is the robot's.
    let steered = records
        .iter()
        .take_while(|record| {
            record
                .arm
                .as_ref()
                .is_none_or(|arm| arm.phase.obeys_controller())
        })
        .filter(|record| record.arm.is_none() || record.time_s > 0.0);
    let records: Vec<_> = steered.collect();
    let plane = figures::ImagePlane {
        scene,
        path: records
            .iter()
            .map(|record| record.features.clone())
            .collect(),
        goal: head.goal,
        way_points,
        title: format!("vpcd {} and hw-sim over shared memory", cli.strategy),
    };
    let velocity = figures::Velocity {
        period_s: scene.sampling_time(),
        twists: records.iter().map(|record| record.twist).collect(),
        limits: scene.limits,
        title: "twist executed by hw-sim".to_owned(),
    };
    let comparison = figures::Comparison {
        columns: vec![(plane, velocity)],
    };
    let mut written = comparison.canvas().write(&cli.output.join("run"))?.to_vec();
    if let Some(joints) = joints {
        written.extend(joints.canvas().write(&cli.output.join("joints"))?);
    }
    Ok(written)
}

/// Collects the way points that the daemon's cycles report, until it is told to end or dropped: a domain that is left
/// in order leaves nothing in shared memory.
struct WayPoints {
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<Vec<figures::Points>>>,
}

impl WayPoints {
    fn watch(domain: &Path) -> Self {
        let end = Arc::new(AtomicBool::new(false));
        let (ended, domain) = (Arc::clone(&end), domain.to_owned());
        // Without the pictures' way points the demo is still a demo: errors mean that there are none.
        let thread = thread::spawn(move || collect(&domain, &ended).unwrap_or_default());
        let thread = Some(thread);
        Self { end, thread }
    }

    fn end(mut self) -> Vec<figures::Points> {
        self.collected()
    }

    fn collected(&mut self) -> Vec<figures::Points> {
        self.end.store(true, Ordering::Relaxed);
        let thread = self.thread.take().map(JoinHandle::join);
        thread.and_then(Result::ok).unwrap_or_default()
    }
}

impl Drop for WayPoints {
    fn drop(&mut self) {
        self.collected();
    }
}

fn collect(domain: &Path, end: &AtomicBool) -> anyhow::Result<Vec<figures::Points>> {
    let domain = ipc::Domain::join(domain)?;
    let mut observer = ipc::Observer::open(&domain)?;
    let mut way_points = Vec::new();
    while !end.load(Ordering::Relaxed) {
        while let Ok(Some(record)) = observer.cycles.oldest() {
            let count = record.way_point_count as usize;
            let points = record.way_point.chunks_exact(2).take(count);
            let points: figures::Points = points.map(|p| [p[0], p[1]]).collect();
            if !points.is_empty() {
                way_points.push(points);
            }
        }
        thread::sleep(Duration::from_millis(20));
    }
    Ok(way_points)
}
