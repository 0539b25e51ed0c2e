//! `cargo demo`: emulator and daemon as two processes over shared memory, on a start where the
//! memory-less strategy gets stuck; then the comparison of the strategies. With
//! `--scene paper-robot` a Panda carries the camera.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{ExitCode, Stdio};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use hw_sim::recording;
use hw_sim::robot::arm::ArmSettings;
use memory_blob::MemoryFile;
use messages::ClockMode;
use scene::{Pose, Scene, read_starts};
use system_tests::children::Children;
use system_tests::flags::{Common, RobotFlags, defaults};
use system_tests::pictures::{self, Draw};
use system_tests::simulated::Simulated;
use system_tests::spec::Spec;
use system_tests::{robot_table, root, run};
use vpc::Task;

/// A scene to show.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Which {
    /// The paper's simulation: a camera that flies freely.
    PaperSim,
    /// The paper's robot experiment: a Panda with a delayed camera, and a task.
    PaperRobot,
}

impl Which {
    /// The name of scene, starts and memory; the configurations of daemon and emulator; a start
    /// where `previous` stays in front of an occlusion and the strategy, which comes last, gets
    /// round it.
    fn parts(self) -> (&'static str, [&'static str; 2], usize, &'static str) {
        match self {
            Self::PaperSim => (
                "paper-sim",
                ["controller/vpcd.toml", "hw-sim/hw-sim.toml"],
                82,
                "foresight:3",
            ),
            Self::PaperRobot => (
                "paper-robot",
                ["controller/vpcd-robot.toml", "hw-sim/hw-sim-robot.toml"],
                5,
                "gpr:3",
            ),
        }
    }
}

/// Steers an emulated camera round occlusions with vpcd, as two processes over shared memory.
///
/// Builds vpcd and hw-sim, runs the chosen strategy in real time, then compares the strategies from
/// the same start and draws pictures. Exits with 0 only if the camera reached the goal without a
/// violation.
#[derive(Args)]
pub(crate) struct Cli {
    /// Scene to show.
    #[arg(long, value_enum, default_value = "paper-sim")]
    scene: Which,
    /// Strategy of the controller: foresight, previous, knn, gpr, ibvs; by default foresight, for
    /// the robot gpr.
    #[arg(long)]
    strategy: Option<Spec>,
    /// Index of the start pose in the scene's file of starts; by default one from which `previous`
    /// fails and the others arrive.
    #[arg(long)]
    start: Option<usize>,
    /// Run as fast as the controller computes, not in real time.
    #[arg(long)]
    lockstep: bool,
    /// Directory for recording and pictures.
    #[arg(long, default_value = "out/demo")]
    output: PathBuf,
    /// Show no progress while compiling.
    #[arg(long)]
    no_progress: bool,
}

/// One demonstration.
struct Demo<'a> {
    cli: &'a Cli,
    strategy: Spec,
    scene_path: PathBuf,
    starts_path: PathBuf,
    memory_path: PathBuf,
    scene: Scene,
    task: Task,
    starts: Vec<Pose>,
    start: usize,
}

/// Shows everything; a failure where the camera did not reach the goal.
pub(crate) fn show(children: &Children, cli: &Cli) -> anyhow::Result<ExitCode> {
    let has_arrived = Demo::new(cli)?.show(children)?;
    Ok(ExitCode::from(u8::from(!has_arrived)))
}

impl<'a> Demo<'a> {
    fn new(cli: &'a Cli) -> anyhow::Result<Self> {
        let (name, _, telling_start, strategy) = cli.scene.parts();
        let strategy = match cli.strategy {
            Some(strategy) => strategy,
            None => strategy.parse().map_err(anyhow::Error::msg)?,
        };
        let scenes = root().canonicalize()?.join("ipc/scene/scenes");
        let scene_path = scenes.join(format!("{name}.toml"));
        let starts_path = scenes.join(format!("{name}-starts.csv"));
        let scene = Scene::read(&scene_path)?;
        let starts = read_starts(&starts_path)?;
        let start = cli.start.unwrap_or(telling_start);
        if start >= starts.len() {
            bail!("--start = {start}; allowed: 0 to {}", starts.len() - 1);
        }
        fs::create_dir_all(&cli.output).with_context(|| cli.output.display().to_string())?;
        Ok(Self {
            cli,
            strategy,
            memory_path: root().join(format!("memory-blob/default/{name}.vpcmem")),
            task: Task::new(&scene)?,
            scene_path,
            starts_path,
            scene,
            starts,
            start,
        })
    }

    /// Shows everything; whether the goal was reached.
    fn show(&self, children: &Children) -> anyhow::Result<bool> {
        let strategy = self.strategy;
        let programs = children.build(&["vpcd", "hw-sim"])?;
        println!(
            "\nRunning vpcd ({strategy}) and hw-sim as two processes: {}, start {}.",
            self.scene_path.display(),
            self.start
        );
        let recording_path = self.cli.output.join("run.jsonl");
        let has_arrived = self.run(children, &programs, &recording_path)?;
        println!("\nThe strategies from the same start, in this process:");
        let pictures = self.cli.output.join("strategies");
        match self.cli.scene {
            Which::PaperSim => self.draw_strategies(&self.compare()?, &pictures)?,
            Which::PaperRobot => self.draw_strategies(&self.compare_on_robot()?, &pictures)?,
        }
        let has_joints = self.draw_recording(&recording_path)?;
        self.say_what_to_look_at(has_joints);
        Ok(has_arrived)
    }

    fn say_what_to_look_at(&self, has_joints: bool) {
        println!("\nLook at (in {}):", self.cli.output.display());
        let mut files = vec![
            (
                "strategies.gif",
                "the same start without and with the memory, as a film",
            ),
            ("strategies.png", "the same, with the velocity commands"),
            ("run.png", "what vpcd and hw-sim did together"),
            ("memory.png", "trajectories in the memory of motion"),
            ("vpcd.log", "what vpcd said"),
        ];
        if has_joints {
            files.push(("joints.png", "the robot's joints while vpcd and hw-sim ran"));
        }
        for (file, what) in files {
            println!("  {file:<16} {what}");
        }
        println!(
            "Next: `cargo table --help` compares strategies over 100 starts; README.md, \"Run it\"."
        );
    }

    /// Runs the two processes; `hw-sim` prints the result. Returns whether the goal was
    /// reached without a violation.
    fn run(&self, children: &Children, programs: &Path, recording: &Path) -> anyhow::Result<bool> {
        let (cli, [vpcd, hw_sim]) = (self.cli, self.cli.scene.parts().1);
        // The daemon puts its flight record beside the domain: to it, the end of the camera is a
        // fault.
        let here = std::env::temp_dir().join(format!("vpc-demo-{}", std::process::id()));
        let _place = children.place(here.clone());
        fs::create_dir_all(&here).with_context(|| here.display().to_string())?;
        let domain = here.join("domain");
        let clock = if cli.lockstep { "lockstep" } else { "fixed" };
        let mut daemon = testkit::command(programs.join("vpcd"));
        daemon.arg("--config").arg(root().join(vpcd)).arg("--arm");
        daemon.arg("--scene").arg(&self.scene_path);
        daemon
            .arg("--strategy")
            .arg(self.strategy.strategy.to_string());
        daemon.arg("--np").arg(self.strategy.np.to_string());
        daemon.args(["--clock", clock]).arg("--domain").arg(&domain);
        daemon.stderr(fs::File::create(cli.output.join("vpcd.log"))?);
        if self.strategy.strategy.uses_memory() {
            daemon.arg("--memory").arg(&self.memory_path);
        }
        let mut emulator = testkit::command(programs.join("hw-sim"));
        emulator.arg("--config").arg(root().join(hw_sim));
        emulator.arg("--scene").arg(&self.scene_path);
        emulator.arg("--starts").arg(&self.starts_path);
        emulator.args(["--start", &self.start.to_string(), "--clock", clock]);
        emulator
            .arg("--domain")
            .arg(&domain)
            .arg("--record")
            .arg(recording);
        emulator.stdout(Stdio::piped());
        if !cli.no_progress {
            emulator.arg("--progress");
        }
        let daemon = children.start("vpcd", daemon)?;
        let (status, _) = children.start("hw-sim", emulator)?.output()?;
        let log = || format!("see {}", cli.output.join("vpcd.log").display());
        daemon.stop().with_context(log)?;
        Ok(status.success())
    }

    /// Runs the strategies with the camera that flies freely.
    fn compare(&self) -> anyhow::Result<Vec<(String, run::Run)>> {
        let memory = self.memory()?;
        let mut runs = Vec::new();
        for text in ["previous:3", "gpr:3", "foresight:3"] {
            let spec: Spec = text.parse().map_err(anyhow::Error::msg)?;
            let (memory, clock) = (Some(&memory), ClockMode::Fixed);
            let mut daemon = Simulated::new(&self.scene, memory, spec.settings(), clock)?;
            let start = &self.starts[self.start];
            runs.push((text.to_owned(), run::run(&self.scene, &mut daemon, start)));
        }
        Ok(runs)
    }

    /// Runs the strategies with the emulated robot.
    fn compare_on_robot(&self) -> anyhow::Result<Vec<(String, system_tests::robot::RobotRun)>> {
        let flags = RobotFlags {
            only: Some(self.start),
            ..defaults()
        };
        let strategies =
            ["previous:3", "gpr:3"].map(|text| text.parse::<Spec>().map_err(anyhow::Error::msg));
        let common = Common {
            strategies: strategies.into_iter().collect::<anyhow::Result<_>>()?,
            noise: 0.3,
            drop: 0.01,
            ..defaults()
        };
        let memory = self.memory()?;
        let memory = Some(&memory);
        let all = robot_table::table(
            (&self.scene, &ArmSettings::default()),
            &self.starts,
            memory,
            &flags,
            &common,
            &|| (),
        )?;
        let runs = all
            .into_iter()
            .flat_map(|(name, runs)| runs.into_iter().map(move |run| (name.clone(), run)));
        Ok(runs.collect())
    }

    fn memory(&self) -> anyhow::Result<MemoryFile> {
        let task = self.scene.fingerprint();
        Ok(MemoryFile::open(&self.memory_path, Some(task.bytes()))?)
    }

    /// Draws the strategies side by side, the first and the last of them as a film, and the memory.
    fn draw_strategies<R: Draw>(&self, runs: &[(String, R)], path: &Path) -> anyhow::Result<()> {
        for (name, run) in runs {
            println!("  {}", run.drawn(name, &self.task).title);
        }
        let named = runs.iter().map(|(name, run)| (name, run));
        pictures::comparison(&self.scene, &self.task, named)
            .canvas()
            .write(path)?;
        let film: Vec<_> = runs.first().into_iter().chain(runs.last()).collect();
        pictures::animation(&self.scene, &self.task, &film).write(path)?;
        let memory = self.memory()?;
        let memory = pictures::samples(&self.scene, &self.task, &memory);
        memory.canvas().write(&self.cli.output.join("memory"))?;
        Ok(())
    }

    /// Draws what the two processes did; whether a robot's joints were drawn.
    fn draw_recording(&self, path: &Path) -> anyhow::Result<bool> {
        let (head, records) = recording::read(path).with_context(|| path.display().to_string())?;
        // The way to the goal; what comes after the release is the robot's.
        let obeys = |record: &&recording::Record| {
            let arm = record.arm.as_ref();
            arm.is_none_or(|arm| arm.phase.is_approach())
        };
        let steered = records.iter().take_while(obeys);
        let steered = steered.filter(|record| record.arm.is_none() || record.time_s > 0.0);
        let plane = figures::ImagePlane {
            scene: &self.scene,
            path: steered
                .clone()
                .map(|record| record.features.clone())
                .collect(),
            goal: head.goal,
            way_points: Vec::new(),
            foreseen: Vec::new(),
            ellipses: Vec::new(),
            title: format!("vpcd {} and hw-sim over shared memory", self.strategy),
        };
        let velocity = figures::Velocity {
            period_s: self.scene.sampling_time(),
            twists: steered.map(|record| record.twist).collect(),
            own: Vec::new(),
            limits: self.scene.limits,
            periods: 0,
            title: "twist executed by hw-sim".to_owned(),
        };
        let columns = vec![(plane, velocity)];
        figures::Comparison { columns }
            .canvas()
            .write(&self.cli.output.join("run"))?;
        let joints = pictures::joints(&records, "joints while vpcd and hw-sim ran");
        if let Some(joints) = &joints {
            joints.canvas().write(&self.cli.output.join("joints"))?;
        }
        Ok(joints.is_some())
    }
}
