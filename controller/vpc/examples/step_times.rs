//! What a whole cycle costs: `cargo run --release -p vpc --example step_times`.
//!
//! Steers an exact camera from the first fixed starts of the paper's scene, with every strategy,
//! and records what it saw. The recording is then replayed: the time of a cycle is the median over
//! the replays, so that other work on the machine, which disturbs a cycle here and there, is not
//! taken for the law's.

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use arm::{Arm, Joints, READY};
use memory_blob::MemoryFile;
use nalgebra::Vector3;
use scene::{Pose, Scene};
use vpc::motion::{Motion, rotation};
use vpc::{Asked, Law, Measurement, MotionMemory, Settings, Strategy, camera};

const STARTS: usize = 25;
const REPLAYS: usize = 7;
const MEMORY: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../memory-blob/default/paper-sim.vpcmem"
);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml")?;
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "paper-sim-starts.csv")?;
    let file = MemoryFile::open(Path::new(MEMORY), Some(scene.fingerprint().bytes()))?;
    println!(
        "strategy | Np | cycles | asked memory | iterations | p50 us | p99 us | max us | once: p50 | p99"
    );
    for strategy in [Strategy::Previous, Strategy::Knn { k: 3 }, Strategy::Gpr] {
        for np in [3, 30] {
            let settings = Settings {
                strategy,
                np,
                ..Settings::default()
            };
            let mut controller = Law::new(&scene, settings, |len| vec![0.0; len])?;
            let mut cycles = Cycles::default();
            for start in starts.iter().take(STARTS) {
                cycles.run(&scene, &mut controller, &file.view(), start);
            }
            cycles.print(strategy, np);
        }
    }
    markers()?;
    arm()
}

/// What the size of markers costs: the scene with tags, for a law that knows their size and one
/// that takes them for points.
fn markers() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags-robot.toml")?;
    let starts = scene::parse_starts(scene::TAGS_ROBOT_STARTS, "tags-robot-starts.csv")?;
    let mut points = scene.clone();
    points.marker_size = 0.0;
    println!("\ntags-robot: tags beside points");
    pairs([&scene, &points], &starts)
}

/// What an arm costs: the paper's robot scene, for a law that knows the Panda that carries the
/// camera, ready at each start, and one of a free camera.
fn arm() -> Result<(), Box<dyn std::error::Error>> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
    let text = format!("arm = \"panda.toml\"\n{}", scene::PAPER_ROBOT);
    let scene = Scene::parse(&text, beside)?;
    let starts = scene::parse_starts(scene::PAPER_ROBOT_STARTS, "paper-robot-starts.csv")?;
    let mut free = scene.clone();
    free.arm = None;
    println!("\npaper-robot: a known arm beside a free camera");
    pairs([&scene, &free], &starts)
}

/// A cycle of the law of each of two scenes, on the same measurements, in turn.
fn pairs(scenes: [&Scene; 2], starts: &[Pose]) -> Result<(), Box<dyn std::error::Error>> {
    println!("Np | cycles | p50 us | p99 us | without: p50 us | p99 us | ratio of a cycle, p50");
    for np in [3, 30] {
        // As vpcd-robot.toml.
        let settings = Settings {
            strategy: Strategy::Previous,
            np,
            step_s: 0.4,
            ..Settings::default()
        };
        let law = |scene| Law::new(scene, settings, |len| vec![0.0; len]);
        let mut laws = [law(scenes[0])?, law(scenes[1])?];
        let (mut times, mut ratios) = ([const { Vec::new() }; 2], Vec::new());
        for start in starts.iter().take(STARTS) {
            let seen = seen(scenes[0], &mut laws[0], start);
            let mut medians = [const { Vec::new() }; 2];
            let mut passes = [const { Vec::new() }; 2];
            for _ in 0..REPLAYS {
                for (law, passes) in laws.iter_mut().zip(&mut passes) {
                    law.reset();
                    passes.push(Vec::from_iter(seen.iter().map(|seen| {
                        let begin = Instant::now();
                        law.see_joints(&seen.q, 0);
                        let _ = black_box(law.step(black_box(&seen.measurement), None));
                        begin.elapsed().as_secs_f64() * 1e6
                    })));
                }
            }
            for (passes, medians) in passes.iter().zip(&mut medians) {
                for cycle in 0..seen.len() {
                    let mut one = Vec::from_iter(passes.iter().map(|pass| pass[cycle]));
                    medians.push(quantile(&mut one, 0.5));
                }
            }
            ratios.extend(medians[0].iter().zip(&medians[1]).map(|(a, b)| a / b));
            let [with, without] = medians;
            times[0].extend(with);
            times[1].extend(without);
        }
        let count = ratios.len();
        let [with, without] = times
            .each_mut()
            .map(|t| [0.5, 0.99].map(|p| quantile(t, p)));
        println!(
            "{np:>2} | {count:>6} | {:>6.1} | {:>6.1} | {:>15.1} | {:>6.1} | {:>.2}",
            with[0],
            with[1],
            without[0],
            without[1],
            quantile(&mut ratios, 0.5),
        );
    }
    Ok(())
}

/// What a cycle has: the measurement, and the joints of an arm, rad.
struct Seen {
    measurement: Measurement,
    q: Vec<f64>,
}

/// What an exact camera sees from a start until the law arrives or the scene's time is up.
fn seen(scene: &Scene, law: &mut Law<Vec<f64>>, start: &Pose) -> Vec<Seen> {
    law.reset();
    let mut points = placed(scene, start);
    let arm = scene.arm.as_ref().map(Arm::from);
    let mut q = Joints::from(READY);
    let mut seen = Vec::new();
    for _ in 0..(scene.success.time_s * scene.camera.rate_hz) as usize {
        let Some(pixels) = pixels(scene, &points) else {
            break;
        };
        let measurement = Measurement::from_points(&pixels);
        law.see_joints(q.as_slice(), 0);
        let step = law.step(&measurement, None);
        seen.push(Seen {
            measurement,
            q: q.as_slice().to_vec(),
        });
        let Some(step) = step
            .ok()
            .filter(|s| s.error_px > scene.success.convergence_px)
        else {
            break;
        };
        let period = scene.sampling_time();
        let motion = Motion::of_camera(&step.twist, period);
        points.iter_mut().for_each(|x| *x = motion.apply(x));
        if let Some(arm) = &arm {
            q = arm.moved(&q, &step.twist, step.elbow, period);
        }
    }
    seen
}

/// The cycles of some runs.
#[derive(Default)]
struct Cycles {
    /// Median time of each over the replays, us.
    median_us: Vec<f64>,
    /// Time of each in the first pass, us.
    once_us: Vec<f64>,
    recalled: usize,
    iterations: u64,
}

impl Cycles {
    /// Runs the law from a start until it arrives or the scene's time is up, and replays what it
    /// saw.
    fn run(
        &mut self,
        scene: &Scene,
        controller: &mut Law<Vec<f64>>,
        memory: &dyn MotionMemory,
        start: &Pose,
    ) {
        controller.reset();
        let mut points = placed(scene, start);
        let mut seen = Vec::new();
        let periods = (scene.success.time_s * scene.camera.rate_hz) as usize;
        for _ in 0..periods {
            let Some(pixels) = pixels(scene, &points) else {
                break;
            };
            let measurement = Measurement::from_points(&pixels);
            let begin = Instant::now();
            let step = controller.step(black_box(&measurement), Some(memory));
            self.once_us.push(begin.elapsed().as_secs_f64() * 1e6);
            seen.push(measurement);
            let Ok(step) = step else {
                break;
            };
            self.recalled += usize::from(step.asked == Asked::Followed);
            self.iterations += u64::from(step.iterations);
            if step.error_px <= scene.success.convergence_px {
                break;
            }
            let motion = Motion::of_camera(&step.twist, scene.sampling_time());
            points.iter_mut().for_each(|x| *x = motion.apply(x));
        }
        self.replay(controller, memory, &seen);
    }

    fn replay(
        &mut self,
        controller: &mut Law<Vec<f64>>,
        memory: &dyn MotionMemory,
        seen: &[Measurement],
    ) {
        let mut times = vec![Vec::with_capacity(REPLAYS); seen.len()];
        for _ in 0..REPLAYS {
            controller.reset();
            for (measurement, times) in seen.iter().zip(&mut times) {
                let begin = Instant::now();
                let _ = black_box(controller.step(black_box(measurement), Some(memory)));
                times.push(begin.elapsed().as_secs_f64() * 1e6);
            }
        }
        self.median_us
            .extend(times.iter_mut().map(|times| quantile(times, 0.5)));
    }

    fn print(&mut self, strategy: Strategy, np: usize) {
        let count = self.median_us.len();
        println!(
            "{:<8} | {np:>2} | {count:>6} | {:>10.1} % | {:>10.2} | {:>6.1} | {:>6.1} | {:>6.1} | {:>9.1} | {:>.1}",
            strategy.to_string(),
            100.0 * self.recalled as f64 / count as f64,
            self.iterations as f64 / count as f64,
            quantile(&mut self.median_us, 0.5),
            quantile(&mut self.median_us, 0.99),
            quantile(&mut self.median_us, 1.0),
            quantile(&mut self.once_us, 0.5),
            quantile(&mut self.once_us, 0.99),
        );
    }
}

/// The pattern's points in the camera frame, m.
fn placed(scene: &Scene, pose: &Pose) -> Vec<Vector3<f64>> {
    let turn = rotation(pose.rotation);
    let place = |p: &[f64; 3]| turn * Vector3::from(*p) + Vector3::from(pose.translation);
    scene.pattern.iter().map(place).collect()
}

/// What an exact camera sees; `None` if a point is behind it.
fn pixels(scene: &Scene, points: &[Vector3<f64>]) -> Option<Vec<[f64; 2]>> {
    let see = |x: &Vector3<f64>| camera::project(&scene.camera, (*x).into());
    points.iter().map(see).collect()
}

/// The smallest entry that this share of all does not exceed.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values
        .get(rank.clamp(1, values.len().max(1)) - 1)
        .copied()
        .unwrap_or(f64::NAN)
}
