//! A controller of any size is made, steps and thinks on the stack of a small thread.

use std::sync::atomic::{AtomicU32, Ordering};

use scene::{Pose, Scene, write_mask};
use vpc::{Law, Measurement, MotionMemory, Settings, Strategy, Task, Twist};

/// Stack of the thread, bytes.
const STACK: usize = 256 << 10;
/// Cycles of each controller.
const CYCLES: u64 = 10;

/// The paper's simulated scene.
fn usual() -> Scene {
    Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()
}

/// A scene with as many points, parts and areas as one may have, markers, and limits of
/// acceleration.
fn largest() -> Scene {
    let directory = tempfile::tempdir().unwrap();
    // 32 spots of a mask along two sides of the image.
    let is_spot = |u: u32, v: u32| u % 64 < 12 && (v < 12 || (40..52).contains(&v));
    write_mask(&directory.path().join("spots.png"), 1024, 1024, is_spot).unwrap();
    let head = scene::PAPER_SIM.split_once("[pattern]").unwrap().0;
    let text = scene::PAPER_SIM.split_once("[goal]").unwrap().1;
    let (middle, _) = text.split_once("[[occlusion]]").unwrap();
    let corner = |k: u32| {
        let angle = std::f64::consts::TAU * (f64::from(k) + 0.5) / 8.0;
        format!(
            "[{:.6}, {:.6}, 0.0]",
            0.06 * angle.cos(),
            0.06 * angle.sin()
        )
    };
    let corners: Vec<String> = (0..8).map(corner).collect();
    let mut parts = String::new();
    for occlusion in 0..6 {
        let part = |k: u32| {
            let (u, v) = (80 + 120 * k, 700 + 55 * occlusion);
            format!("{{ center = [{u}.0, {v}.0], half = [9.0, 9.0], p = 3.5 }}")
        };
        let row: Vec<String> = (0..8).map(part).collect();
        let row = row.join(", ");
        parts += &format!("[[occlusion]]\nname = \"row {occlusion}\"\nparts = [{row}]\n");
    }
    let middle = middle.replace(
        "[limits]",
        "[limits]\nlinear_acceleration = 1.0\nangular_acceleration = 2.0",
    );
    let text = format!(
        "{head}[pattern]\nmarker_size = 0.01\npoints = [{}]\n[goal]{middle}{parts}\
         [[occlusion]]\nname = \"spots\"\nmask = \"spots.png\"\n",
        corners.join(", ")
    );
    let path = directory.path().join("scene.toml");
    std::fs::write(&path, text).unwrap();
    let scene = Scene::read(&path).unwrap();
    assert_eq!(scene.pattern.len(), vpc::MAX_POINTS);
    assert_eq!(scene.parts().count(), vpc::task::MAX_ALL_PARTS);
    assert_eq!(scene.areas().count(), scene::MAX_AREAS);
    scene
}

/// A memory with one sample: the goal. Its trajectory stands still.
struct Goal {
    task: Task,
    /// How often a trajectory was asked for.
    asked: AtomicU32,
}

impl MotionMemory for Goal {
    fn infer(&self, _: Strategy, _: &[f64], output: &mut [f64]) -> bool {
        let goal = self.task.goal.iter().flatten();
        output
            .iter_mut()
            .skip(6)
            .zip(goal)
            .for_each(|(to, from)| *to = *from);
        true
    }

    fn neighbour(&self, _: &[f64], rank: usize, found: &mut [f64]) -> Option<f64> {
        self.sample(rank, found)
    }

    fn count(&self) -> usize {
        1
    }

    fn sample(&self, _: usize, input: &mut [f64]) -> Option<f64> {
        let goal = self.task.goal.iter().flatten();
        input
            .iter_mut()
            .zip(goal)
            .for_each(|(to, from)| *to = *from);
        Some(0.0)
    }

    fn trajectory(
        &self,
        _: &[f64],
        rank: usize,
        _: f64,
        found: &mut [f64],
        commands: &mut [Twist],
    ) -> Option<()> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        commands.fill([0.0; vpc::DOF]);
        self.sample(rank, found).map(|_| ())
    }
}

/// Makes a controller. The result that it is unwrapped from leaves the stack before it steps.
fn made(scene: &Scene, settings: Settings, lend: impl FnOnce(usize) -> Vec<f64>) -> Law<Vec<f64>> {
    Law::new(scene, settings, lend).unwrap()
}

/// Runs a controller in a thread of its own; returns the numbers of its workspace, and how many
/// trajectories it asked for.
fn run(scene: &Scene, settings: Settings) -> (usize, u32) {
    let memory = Goal {
        task: Task::new(scene).unwrap(),
        asked: AtomicU32::new(0),
    };
    let work = || {
        let mut numbers = 0;
        let lend = |len| {
            numbers = len;
            vec![f64::NAN; len]
        };
        let mut law = made(scene, settings, lend);
        let [x, y, z] = scene.goal.translation;
        let start = Pose {
            translation: [x + 0.1, y - 0.1, 1.2 * z],
            ..scene.goal
        };
        let points = law.task().features_at(&start).unwrap();
        for k in 0..CYCLES {
            let now_ns = 33_333_333 * k;
            let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
            let step = law.step(&measured, Some(&memory)).unwrap();
            assert!(step.twist.iter().all(|v| v.is_finite()));
            law.sent(&step.twist, now_ns);
            law.think(Some(&memory));
            assert!(law.foreseen().simulated > 0);
        }
        numbers
    };
    let numbers = std::thread::scope(|threads| {
        let thread = std::thread::Builder::new().stack_size(STACK);
        thread.spawn_scoped(threads, work).unwrap().join().unwrap()
    });
    (numbers, memory.asked.into_inner())
}

#[test]
fn a_controller_lives_on_a_stack_of_256_kib() {
    let foresight = Settings {
        strategy: Strategy::Foresight,
        ..Settings::default()
    };
    let (usual, asked) = run(&usual(), foresight);
    assert_eq!(asked, 8);
    let longest = Settings {
        np: vpc::MAX_NP,
        nc: vpc::MAX_NC,
        foresight_steps: 5,
        iterations: 3,
        ..foresight
    };
    let (largest, _) = run(&largest(), longest);
    // The workspace is as small as the problem allows, and no larger than promised.
    assert!(usual < 6_500 && largest <= 60_000, "{usual}, {largest}");
}

#[test]
fn a_workspace_that_is_too_short_is_refused() {
    let lend = |len: usize| vec![0.0; len - 1];
    let refused = Law::new(&usual(), Settings::default(), lend).map(|_| ());
    let message = refused.unwrap_err().to_string();
    assert!(message.starts_with("workspace: "), "{message}");
    assert!(message.contains(" numbers; allowed: "), "{message}");
}
