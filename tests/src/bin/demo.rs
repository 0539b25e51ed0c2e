//! `cargo demo`: emulator and daemon as two processes over shared memory, on a start where the memory-less strategy
//! gets stuck; then the comparison of the strategies.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Parser;
use hw_sim::recording;
use memory_blob::MemoryFile;
use scene::{Scene, read_starts};
use system_tests::pictures;
use system_tests::row::{Row, markdown};
use system_tests::run::{run, time};
use system_tests::spec::Spec;
use vpc::{Controller, MotionMemory, Task};

/// A start of paper-sim where `previous` stays in front of an occlusion and `gpr` gets round it.
const TELLING_START: usize = 82;
/// Longest time for the daemon to end after a termination signal.
const PATIENCE: Duration = Duration::from_secs(5);

/// Steers the emulated camera round occlusions with vpcd, as two processes over shared memory.
///
/// Builds vpcd and hw-sim, runs the chosen strategy in real time, then compares all strategies on the same start and
/// draws pictures. Exits with 0 only if the goal was reached without a violation.
#[derive(Parser)]
#[command(name = "demo", version)]
struct Cli {
    /// Strategy that steers: previous, knn, gpr, ibvs.
    #[arg(long, default_value = "gpr")]
    strategy: Spec,
    /// Start pose, by its index in paper-sim-starts.csv.
    #[arg(long, default_value_t = TELLING_START)]
    start: usize,
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
    match demo(&Cli::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("demo: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn demo(cli: &Cli) -> anyhow::Result<bool> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .context("no workspace")?;
    let scenes = root.join("ipc/scene/scenes");
    let (scene_path, starts_path) = (
        scenes.join("paper-sim.toml"),
        scenes.join("paper-sim-starts.csv"),
    );
    let memory_path = root.join("memory-blob/default/paper-sim.vpcmem");
    let scene = Scene::read(&scene_path)?;
    let starts = read_starts(&starts_path)?;
    let Some(start) = starts.get(cli.start) else {
        bail!(
            "--start = {}; allowed: 0 to {}",
            cli.start,
            starts.len() - 1
        );
    };
    fs::create_dir_all(&cli.output).with_context(|| cli.output.display().to_string())?;
    build(root)?;

    println!(
        "vpcd ({}) and hw-sim, two processes over shared memory: {}, start {}",
        cli.strategy,
        scene_path.display(),
        cli.start
    );
    let binaries = env::current_exe()?
        .parent()
        .context("no directory of binaries")?
        .to_owned();
    let domain = env::temp_dir().join(format!("vpc-demo-{}", std::process::id()));
    let clock = if cli.lockstep { "lockstep" } else { "fixed" };
    let recording_path = cli.output.join("run.jsonl");
    let log = fs::File::create(cli.output.join("vpcd.log"))?;
    let mut daemon = Command::new(binaries.join("vpcd"));
    daemon
        .arg("--config")
        .arg(root.join("controller/vpcd.toml"))
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
    let mut daemon = Running(daemon.spawn().context("cannot start vpcd")?);
    let mut emulator = Command::new(binaries.join("hw-sim"));
    emulator
        .arg("--scene")
        .arg(&scene_path)
        .arg("--starts")
        .arg(&starts_path)
        .arg("--start")
        .arg(cli.start.to_string())
        .args(["--clock", clock])
        .arg("--domain")
        .arg(&domain)
        .arg("--record")
        .arg(&recording_path)
        .stdout(Stdio::piped());
    if !cli.no_progress {
        emulator.arg("--progress");
    }
    let emulated = emulator.output().context("cannot run hw-sim")?;
    let stopped = daemon.stop();
    let _ = fs::remove_dir_all(&domain);
    // The end of the camera is a fault to the daemon, which left its flight record.
    let _ = fs::remove_dir_all(
        domain.with_file_name(format!("vpc-demo-{}-flight", std::process::id())),
    );
    let verdict = String::from_utf8_lossy(&emulated.stdout);
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
    let arrived = emulated.status.success();

    println!("\nThe strategies on the same start, in process:\n");
    let mut written = compare(&scene, &memory_path, start, &cli.output)?;
    written.extend(draw_recording(&scene, &recording_path, cli)?);
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

/// Builds the two programs beside this one, with the cargo that runs it.
fn build(root: &Path) -> anyhow::Result<()> {
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.current_dir(root).args([
        "build",
        "--quiet",
        "--package",
        "controller",
        "--package",
        "hw-sim",
    ]);
    if !cfg!(debug_assertions) {
        command.arg("--release");
    }
    let status = command.status().context("cannot run cargo")?;
    if !status.success() {
        bail!("cargo build of vpcd and hw-sim failed");
    }
    Ok(())
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
        .write(&output.join("strategies"))?
        .to_vec();
    written.extend(pictures::samples(scene, &task, &memory).write(&output.join("memory"))?);
    Ok(written)
}

/// Draws what the two processes did.
fn draw_recording(scene: &Scene, path: &Path, cli: &Cli) -> anyhow::Result<Vec<PathBuf>> {
    let (head, records) = recording::read(path).with_context(|| path.display().to_string())?;
    let plane = figures::ImagePlane {
        scene,
        path: records
            .iter()
            .map(|record| record.features.clone())
            .collect(),
        goal: head.goal,
        way_points: Vec::new(),
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
    Ok(comparison.write(&cli.output.join("run"))?.to_vec())
}

/// A child that does not outlive this program.
struct Running(Child);

impl Running {
    /// Asks the child to stop and waits for it.
    fn stop(&mut self) -> anyhow::Result<()> {
        let id = self.0.id();
        let asked = Command::new("kill")
            .arg(id.to_string())
            .status()
            .context("cannot run kill")?;
        let begin = Instant::now();
        while begin.elapsed() < PATIENCE {
            if let Some(status) = self.0.try_wait()? {
                if status.success() {
                    return Ok(());
                }
                bail!("vpcd ended with {status}; its log is beside the recording");
            }
            thread::sleep(Duration::from_millis(10));
        }
        bail!("vpcd (process {id}) did not stop within {PATIENCE:?} after {asked}");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Already gone where it was stopped.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
