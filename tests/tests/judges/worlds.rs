//! Worlds that are not ours: simulators of others carry the camera, draw its images and say where
//! it is; `vpc-camera` and `vpcd` bring it to the goal.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use serde::Deserialize;
use testkit::python::{self, Environment, script};
use testkit::{Place, Running, ended, is_long, not_run, program, root, tell};
use toml::Table;

/// What the features of a run may miss, and on the mean, px: neither a half pixel nor a texture
/// that is not quite in its place. PyBullet's renderer draws edges to the whole pixel.
const FEATURES_PX: f64 = 0.05;
const BIAS_PX: f64 = 0.02;
/// Times the scene's limits of speed: a run takes some seconds, and a camera can follow the box.
const SPEED: f64 = 10.0;
/// Speeds of the box, m/s, and how many starts a short and a long test runs over it.
const BOXES: [(f64, usize, usize); 2] = [(0.0, 2, 50), (0.02, 1, 10)];
/// Longest run: a minute of frames, at half a second each.
const PATIENCE: Duration = Duration::from_secs(900);

const WORLDS: Environment = Environment {
    name: "python-worlds",
    requirements: &[
        "ipc/clients/python/requirements-worlds.txt",
        "ipc/clients/python/requirements.txt",
    ],
    packages: &[],
};

/// What became of a run.
#[derive(Debug, Deserialize)]
struct Run {
    start: usize,
    verdict: String,
    frames: usize,
    rms_px: f64,
    mean_px: [f64; 2],
}

/// `vpcd` or `vpc-camera` in lockstep, with its shipped configuration.
fn running(name: &str, configuration: &str, words: &[&Path], place: &Place) -> Running {
    let mut command = testkit::command(program(name));
    command.arg("--config").arg(root().join(configuration));
    command.args(["--clock", "lockstep", "--domain"]);
    command.arg(place.domain()).args(words);
    Running::start(command.stdout(Stdio::null()).stderr(Stdio::null()))
}

/// The scene of our starts with an arm and with other limits of speed, as `cargo laboratory` has it.
fn scene_with(arm: &str, place: &Place) -> PathBuf {
    let read = |name: &str| std::fs::read_to_string(root().join("ipc/scene/scenes").join(name));
    for name in [format!("{arm}.toml"), format!("{arm}.urdf")] {
        place.file(&name, read(&name).unwrap());
    }
    let mut scene: Table = toml::from_str(&read("tags-robot.toml").unwrap()).unwrap();
    scene.insert("arm".to_owned(), format!("{arm}.toml").into());
    for key in ["linear", "angular"] {
        let limit = &mut scene["limits"][key];
        *limit = (SPEED * limit.as_float().unwrap()).into();
    }
    place.file("scene.toml", scene.to_string())
}

/// Runs a world from some of our starts, over a box that stands and one that moves.
fn arrives(world: &str, arm: &str) {
    let Some(python) = WORLDS.python(world) else {
        return;
    };
    let (place, scenes) = (Place::new(), root().join("ipc/scene/scenes"));
    let scene = scene_with(arm, &place);
    let made = |name: &str, words: &[&str], file: &str| -> PathBuf {
        let path = place.path(file);
        let mut maker = testkit::command(program(name));
        let told = ended(maker.args(words).arg(&scene).arg("-o").arg(&path));
        assert_eq!(told.code, Some(0), "{told:?}");
        path
    };
    let tags = made("vpc-camera", &["tags"], "tags.svg");
    // A small one: in a debug build fifty trajectories take minutes.
    let memory = "build --trajectories 6 --iterations 20 --gpr-samples 40";
    let words: Vec<&str> = memory.split(' ').collect();
    let memory = made("vpc-memory", &words, "tags.vpcmem");
    let shipped = "controller/vpcd-tags.toml";
    let scene_flag = [Path::new("--scene"), &scene];
    let words = [scene_flag[0], scene_flag[1], Path::new("--memory"), &memory];
    let _daemon = running("vpcd", shipped, &words, &place);
    let shipped = "ipc/clients/camera/vpc-camera.toml";
    let _camera = running("vpc-camera", shipped, &scene_flag, &place);
    let file = format!("ipc/clients/python/worlds/{world}_world.py");
    for (speed, short, long) in BOXES {
        let mut command = script(&python, &root().join(&file));
        let count = if is_long() { long } else { short };
        let json = place.path("runs.json");
        command.arg("--scene").arg(&scene).arg("--starts");
        command.arg(scenes.join("tags-robot-starts.csv"));
        command.arg("--tags").arg(&tags).arg("--json").arg(&json);
        command.arg("--domain").arg(place.domain());
        command.args(["--motion", &speed.to_string()]);
        command.args(["--count", &count.to_string()]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let told = Running::start(command).ended_within(PATIENCE * count as u32);
        tell(format_args!("{}{}", told.stdout, told.stderr));
        let runs: Vec<Run> = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
        assert_eq!(runs.len(), count);
        for run in runs {
            assert_eq!(run.verdict, "arrived", "{world}: start {}", run.start);
            assert!(run.frames > 20 && run.rms_px < FEATURES_PX, "{run:?}");
            assert!(run.mean_px.iter().all(|x| x.abs() < BIAS_PX), "{run:?}");
        }
    }
}

#[test]
#[ignore = "long: fifty runs in PyBullet"]
fn the_panda_of_pybullet_arrives() {
    arrives("pybullet", "panda");
}

#[test]
#[ignore = "long: fifty runs in MuJoCo"]
fn the_fr3_of_mujoco_arrives() {
    let load = "import ctypes; ctypes.CDLL('libEGL.so.1')";
    if python::run(testkit::command("python3").args(["-c", load])).is_err() {
        let packages = "libegl1 libgl1-mesa-dri";
        not_run(
            "mujoco",
            format_args!("EGL missing (apt-get install {packages})"),
        );
        return;
    }
    arrives("mujoco", "fr3");
}
