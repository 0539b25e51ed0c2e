//! The whole loop with another team's robot: `vpcd` and `vpc-panda` as processes, and a camera of
//! this test on the arm's flange, which sees by the measured joints.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use hand_eye::{self, Frame};
use hw_sim::camera::project;
use hw_sim::pose::from_scene;
use hw_sim::referee::Referee;
use hw_sim::robot::arm::base_from_object;
use ipc::{CameraPorts, Domain, Observer, now_ns};
use messages::{Features, RobotMode};
use panda::{Chain, Joints, Model, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use testkit::{Place, Running, eventually, not_run, program, repeats, root, tell};

use super::STALLS;
use super::emulator::{Emulator, Team};

/// Noise of each coordinate, to either side, px, and share of the frames that are lost.
const NOISE_PX: f64 = 0.5;
const LOST: f64 = 0.01;
/// Depth in an occlusion that the scene forbids, px.
const DEEP_PX: f64 = -15.0;
/// What the log of `vpcd` says where the machine stood still: it disarms after 0.3 s without a
/// state of the robot, and after three late cycles in a row.
const STILL: [&str; 2] = ["robot silent", "disarmed: overruns"];

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
enum End {
    /// After so many seconds, with this clearance at least, px.
    Arrived(f64, f64),
    Failed(String),
    /// The machine stood still.
    Stalled(String),
}

/// How fast the arm is driven.
#[derive(Clone, Copy)]
enum Pace {
    /// As in the paper: 1 cm/s.
    Paper,
    /// Ten times as fast, with a law that knows the arm, and no memory, which another scene has.
    Fast,
}

impl Pace {
    /// The configurations of `vpcd` and `vpc-panda`.
    fn files(self, place: &Place) -> [PathBuf; 2] {
        match self {
            Self::Paper => [
                root().join("controller/vpcd-robot.toml"),
                place.file("bridge.toml", ""),
            ],
            Self::Fast => {
                for file in ["fr3.toml", "fr3.urdf"] {
                    let shipped = root().join("ipc/scene/scenes").join(file);
                    place.file(file, std::fs::read(shipped).unwrap());
                }
                [
                    place.file("vpcd.toml", FAST_LAW),
                    place.file("bridge.toml", FAST_BRIDGE),
                ]
            }
        }
    }

    /// The text of the scene.
    fn scene(self) -> String {
        match self {
            Self::Paper => scene::PAPER_ROBOT.to_owned(),
            Self::Fast => {
                let slow = "linear = 0.01\nangular = 0.03\n";
                let fast = "linear = 0.1\nangular = 0.3\n";
                assert!(scene::PAPER_ROBOT.contains(slow));
                let text = scene::PAPER_ROBOT.replace(slow, fast);
                format!("arm = \"fr3.toml\"\n{text}")
            }
        }
    }
}

/// `vpcd-robot.toml`, but for the speed.
const FAST_LAW: &str = "scene = \"scene.toml\"\n[law]\nstrategy = \"foresight\"\nnp = 3\n\
    iterations = 10\ntolerance = 1e-6\nmargin_px = 12.0\n";
/// The caps are no tighter than the scene's limits.
const FAST_BRIDGE: &str = "linear = 0.2\nangular = 0.6\n";

fn run(test: &str, team: Team, pace: Pace, start: usize) -> Option<End> {
    let place = Place::new();
    let [law, settings] = pace.files(&place);
    let path = place.file("scene.toml", pace.scene());
    let scene = Scene::read(&path).unwrap();
    let starts = scene::parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
    let file = root().join("ipc/clients/panda/hand-eye.toml");
    let mount = hand_eye::read(&file, Frame::Flange)
        .unwrap()
        .mount(&Pose::identity());
    // This robot has no hand: its end effector is the flange.
    let chain = Chain::default();
    let camera = base_from_object() * from_scene(&starts[start]).inverse();
    let q = panda::place(&chain, Model::Fr3.limits(), &mount.flange(&camera)).unwrap();
    let emulator = Emulator::start_at(team, test, &q.into())?;
    let domain = Domain::join(&place.domain()).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let mut ports = CameraPorts::open(&domain).unwrap();
    let mut bridge = testkit::command(env!("CARGO_BIN_EXE_vpc-panda"));
    bridge.args(["--robot", &format!("fr3:{}", emulator.address())]);
    bridge.arg("--config").arg(settings);
    bridge.arg("--scene").arg(&path);
    bridge
        .arg("--hand-eye")
        .arg(&file)
        .arg("--domain")
        .arg(place.domain());
    let mut bridge = Running::start(bridge.stdout(Stdio::null()).stderr(Stdio::piped()));
    // What was commanded before its motion began would not count.
    bridge.line("the robot follows vpc/twist");
    eventually("a state", || observer.robot.latest().unwrap());
    let daemon = daemon(&law, &place.domain());

    let mut random = ChaCha8Rng::seed_from_u64(start as u64);
    let mut referee = Referee::new(&scene);
    let begin = Instant::now();
    let mut due = begin;
    let mut seen_at = None;
    while begin.elapsed().as_secs_f64() < scene.success.time_s {
        due += Duration::from_nanos(33_333_333);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let Some(state) = observer.robot.latest().unwrap() else {
            // An emulator that is late: a frame less.
            continue;
        };
        if state.mode() == Some(RobotMode::Fault) || !bridge.is_running() {
            let log = bridge.terminated().stderr;
            return Some(match STALLS.iter().any(|words| log.contains(words)) {
                true => End::Stalled(log),
                false => End::Failed(log),
            });
        }
        let flange = chain.flange(&Joints::from(state.q));
        let object = mount.camera(&flange).inverse() * base_from_object();
        let Ok(points) = project(&scene, &object) else {
            return Some(End::Failed("the pattern is behind the camera".to_owned()));
        };
        referee.judge(&points);
        if referee.least_clearance() < DEEP_PX {
            let clearance = referee.least_clearance();
            return Some(failed(&format!("{clearance} px"), daemon));
        }
        // At the goal for half a second.
        let is_there = referee.error(&points) < scene.success.convergence_px;
        seen_at = match is_there {
            true => seen_at.or(Some(Instant::now())),
            false => None,
        };
        if seen_at.is_some_and(|since| since.elapsed().as_secs_f64() > 0.5) {
            let said = bridge.terminated();
            assert_eq!(said.code, Some(0), "{said:?}");
            let log = emulator.stopped();
            assert!(!log.contains("violation"), "{log}");
            let seconds = begin.elapsed().as_secs_f64();
            return Some(End::Arrived(seconds, referee.least_clearance()));
        }
        if random.random::<f64>() > LOST {
            let noisy: Vec<[f64; 2]> = points
                .iter()
                .map(|point| point.map(|x| x + random.random_range(-NOISE_PX..NOISE_PX)))
                .collect();
            ports
                .features
                .publish(&Features::new(&noisy, now_ns()))
                .unwrap();
        }
    }
    Some(failed("time out", daemon))
}

/// A run that did not arrive, with the daemon's warnings.
fn failed(what: &str, daemon: Running) -> End {
    let log = daemon.terminated().stderr;
    let warnings: Vec<_> = log.lines().filter(|line| line.contains(" WARN ")).collect();
    let warnings = format!("{what}: {}", warnings.join("; "));
    match STILL.iter().any(|words| warnings.contains(words)) {
        true => End::Stalled(warnings),
        false => End::Failed(warnings),
    }
}

fn daemon(config: &Path, domain: &Path) -> Running {
    let mut vpcd = testkit::command(program("vpcd"));
    vpcd.arg("--config").arg(config);
    vpcd.arg("--domain").arg(domain).arg("--arm");
    Running::start(vpcd.stdout(Stdio::null()).stderr(Stdio::piped()))
}

#[test]
#[ignore = "long: runs in real time on another team's emulator"]
fn a_camera_on_another_teams_fr3_arrives() {
    arrives("a camera on franka-sim", Team::Franka, Pace::Paper);
}

#[test]
#[ignore = "long: runs in real time on another team's emulator"]
fn a_camera_on_another_teams_fr3_arrives_at_ten_times_the_speed() {
    arrives("a camera on franka-sim, 10 cm/s", Team::Franka, Pace::Fast);
}

#[test]
#[ignore = "long: runs in real time on another team's emulator"]
fn a_camera_on_a_third_teams_fr3_arrives_at_ten_times_the_speed() {
    arrives("a camera on franky-sim, 10 cm/s", Team::Franky, Pace::Fast);
}

/// From each start, in time, and without a fault of the robot; a run in which the machine stood
/// still shows neither.
fn arrives(test: &str, team: Team, pace: Pace) {
    let _turn = testkit::turn();
    let count = repeats(&format!("{test}: starts"), 2, 20);
    // One at a time: the emulators have real-time priority, and take the processor from a `vpcd`
    // that has not.
    for start in 0..count {
        let Some(end) = run(test, team, pace, start) else {
            return;
        };
        tell(format_args!("{test}, start {start}: {end:?}"));
        match end {
            End::Arrived(..) => (),
            End::Failed(why) => panic!("start {start}: {why}"),
            End::Stalled(log) => {
                not_run(
                    test,
                    format_args!("start {start}: the machine stood still: {log}"),
                );
            }
        }
    }
}
