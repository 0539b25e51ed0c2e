//! Live, against the emulator: hw-sim's Panda carries its camera round a pattern of tags, by twists
//! of this test, while `vpc-calib` listens. What hw-sim's [truth] says is found out: lens, mounting
//! and stamps.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use hw_sim::robot::calibration::HandEye;
use ipc::Domain;
use messages::{RobotState, TwistCommand, TwistState};
use rustix::process::Signal;
use testkit::{Ended, Place, Running, program, within};
use vision_calibration_core::{Iso3, Vec3};

/// The scene's focal lengths, and what is true: larger by this share, another principal point, and
/// a lens that distorts by 6 px in the corners.
const FOCAL: [f64; 2] = [615.0, 612.0];
const LARGER: f64 = 0.02;
const KEYS: &str =
    "robot = \"panda\"\ncamera = \"rendered\"\nlatency_ms = 45.0\nexposure_ms = 4.0\n
[truth]\nfocal = 0.02\ncenter_px = [3.0, -2.0]\ndistortion = [-0.2, 0.05, 0.0, 0.0, 0.0]\n
stamp_bias_ms = 12.0\nstamp_jitter_ms = 0.5\n";
/// Longest time that a view or a calibration takes.
const PATIENCE: Duration = Duration::from_secs(30);
const BIAS_MS: f64 = 12.0;
/// By how much the camera sits and is turned otherwise, along and about its axes: m, deg.
const MOVED: [f64; 3] = [0.006, -0.004, 0.008];
const TURNED: [f64; 3] = [1.5, -1.0, 2.0];

/// Eight tags, and room to move before them; the goal is never reached.
const SCENE: &str = "
[camera]
width = 640
height = 480
fx = 615.0
fy = 612.0
cx = 322.0
cy = 237.0
rate_hz = 12.0
[pattern]
marker_size = 0.0375
points = [[-0.0675, -0.0225, 0.0], [-0.0225, -0.0225, 0.0], [0.0225, -0.0225, 0.0], [0.0675, -0.0225, 0.0],
  [-0.0675, 0.0225, 0.0], [-0.0225, 0.0225, 0.0], [0.0225, 0.0225, 0.0], [0.0675, 0.0225, 0.0]]
[goal]
translation = [0.0, 0.0, 0.9]
rotation = [0.0, 0.0, 0.0]
[limits]
linear = 0.2
angular = 0.8
linear_acceleration = 1.0
angular_acceleration = 4.0
[cost]
k_q = 1e-6
r = [50.0, 50.0, 0.5, 0.25, 0.25, 0.25]
[success]
violation_px = 10000.0
convergence_px = 0.001
time_s = 3600.0
[starts]
translation_min = [-0.1, -0.1, 0.33]
translation_max = [0.1, 0.1, 0.55]
tilt_max = 0.15
roll_max = 0.6
clearance_px = 15.0
min_error_px = 30.0
";

/// Who steers: towards poses of the pattern in the camera frame.
struct Pilot {
    domain: PathBuf,
    stop: Arc<AtomicBool>,
    /// Views that were taken.
    taken: Arc<AtomicUsize>,
}

/// The pose to be at, by the time, s, and the number of views that were taken.
type Plan = fn(f64, usize) -> Iso3;

fn pose(at: [f64; 3], turn: [f64; 3]) -> Iso3 {
    Iso3::new(Vec3::from(at), Vec3::from(turn))
}

impl Pilot {
    fn steer(&self, plan: Plan) {
        let domain = Domain::join(&self.domain).unwrap();
        let mut twist = domain.publisher::<TwistCommand>().unwrap();
        let mut robot = domain.subscriber::<RobotState>(1).unwrap();
        let start = Instant::now();
        let mut seen = None;
        while !self.stop.load(Ordering::Relaxed) {
            if let Some(state) = robot.latest().unwrap() {
                seen = Some(pose(state.translation, state.rotation));
            }
            let taken = self.taken.load(Ordering::Relaxed);
            let wanted = plan(start.elapsed().as_secs_f64(), taken);
            let mut command = TwistCommand::zero(TwistState::Moving);
            if let Some(seen) = seen {
                // The object is to move so; the camera moves against it.
                let off = wanted * seen.inverse();
                let gain: f64 = 6.0;
                let cap =
                    |vector: Vec3, most: f64| vector * (-gain).max(-most / vector.norm().max(1e-9));
                let linear = cap(off.translation.vector, 0.15);
                let angular = cap(off.rotation.scaled_axis(), 0.6);
                command.twist = [
                    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
                ];
            }
            twist
                .publish(&command.valid_until(ipc::now_ns() + 80_000_000))
                .unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Round the pattern: to the next place when a view was taken.
fn tour(_: f64, taken: usize) -> Iso3 {
    let places = [
        ([0.0, 0.0, 0.34], [0.0, 0.0, 0.0]),
        ([-0.09, -0.06, 0.36], [0.0, 0.0, 0.1]),
        ([0.09, -0.06, 0.36], [0.1, 0.0, -0.1]),
        ([0.09, 0.06, 0.36], [0.0, 0.1, 0.0]),
        ([-0.09, 0.06, 0.36], [0.35, 0.0, 0.1]),
        ([0.0, 0.0, 0.36], [0.40, 0.0, 0.1]),
        ([0.0, 0.0, 0.38], [-0.2, 0.1, 0.3]),
        ([0.0, 0.0, 0.36], [0.0, 0.42, -0.2]),
        ([0.0, 0.0, 0.34], [0.1, -0.42, 0.0]),
        ([0.05, 0.03, 0.38], [0.38, 0.2, 0.3]),
        ([-0.05, 0.03, 0.36], [-0.1, 0.3, -0.3]),
        ([-0.05, -0.03, 0.37], [-0.1, -0.3, 0.2]),
        ([0.05, -0.03, 0.36], [0.38, -0.2, -0.2]),
        ([0.0, 0.0, 0.42], [0.1, 0.1, 0.7]),
    ];
    let (at, turn) = places[taken % places.len()];
    pose(at, turn)
}

/// As by hand.
fn wiggle(time: f64, _: usize) -> Iso3 {
    let wave =
        |amplitude: f64, hertz: f64| amplitude * (std::f64::consts::TAU * hertz * time).sin();
    let at = [
        wave(0.02, 0.43) + wave(0.015, 0.91),
        wave(0.02, 0.61) + wave(0.01, 1.07),
        0.36 + wave(0.01, 0.53),
    ];
    let turn = [wave(0.08, 0.77), wave(0.08, 0.59), wave(0.15, 0.37)];
    pose(at, turn)
}

/// The emulator, and who steers it.
struct Laboratory {
    place: Place,
    emulator: Running,
}

impl Laboratory {
    fn new() -> Self {
        let place = Place::new();
        let scene = place.file("scene.toml", SCENE);
        let starts = place.file("starts.csv", "tx,ty,tz,rx,ry,rz\n0,0,0.36,0,0,0\n");
        let keys = format!(
            "scene = {scene:?}\nstarts = {starts:?}\n{KEYS}hand_eye_m = {MOVED:?}\nhand_eye_deg = {TURNED:?}\n"
        );
        let config = place.file("hw-sim.toml", keys);
        let mut emulator = testkit::command(program("hw-sim"));
        emulator.arg("--config").arg(&config);
        emulator.arg("--domain").arg(place.domain());
        let emulator = emulator.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut emulator = Running::start(emulator);
        emulator.line("go out in domain");
        Self { place, emulator }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.place.path(name)
    }

    /// What `vpc-calib` says that is good; takes so many views, steered by a plan.
    fn calibrate(&self, words: &str, views: usize, plan: Option<Plan>) -> String {
        let said = self.run(words, views, plan);
        assert_eq!(said.code, Some(0), "{said:?}");
        said.stdout
    }

    fn run(&self, words: &str, views: usize, plan: Option<Plan>) -> Ended {
        let (stop, taken) = (Arc::default(), Arc::default());
        let pilot = Pilot {
            domain: self.place.domain(),
            stop: Arc::clone(&stop),
            taken: Arc::clone(&taken),
        };
        let pilot = plan.map(|plan| std::thread::spawn(move || pilot.steer(plan)));
        let mut calib = testkit::command(env!("CARGO_BIN_EXE_vpc-calib"));
        calib.current_dir(self.place.directory());
        calib.args(words.split(' '));
        let calib = Running::start(calib.stdout(Stdio::piped()).stderr(Stdio::piped()));
        for view in 1..=views {
            let line = format!("taken {view}:");
            let found = within(PATIENCE, || calib.stderr().contains(&line).then_some(()));
            let emulator = || self.emulator.stderr();
            assert!(found.is_some(), "{}{}", calib.stderr(), emulator());
            taken.store(view, Ordering::Relaxed);
        }
        let said = calib.ended_within(3 * PATIENCE);
        stop.store(true, Ordering::Relaxed);
        if let Some(pilot) = pilot {
            pilot.join().unwrap();
        }
        testkit::tell(format_args!("$ vpc-calib {words}\n{}", said.stdout));
        said
    }
}

fn mounting(file: &Path) -> Iso3 {
    let frame = hand_eye::Frame::Flange;
    let read = hand_eye::read(file, frame).unwrap().camera;
    let turn = nalgebra::UnitQuaternion::from_rotation_matrix(&read.rotation).scaled_axis();
    pose(read.translation.vector.into(), turn.into())
}

#[test]
fn lens_mounting_and_latency_are_found_live() {
    let laboratory = Laboratory::new();
    let domain = laboratory.place.domain();
    let domain = domain.display();

    laboratory.calibrate(
        &format!(
            "intrinsics --domain {domain} --scene scene.toml --views 14 --save views -o camera.toml"
        ),
        14,
        Some(tour),
    );
    let lens = vpc_camera::lens::read(&laboratory.path("camera.toml")).unwrap();
    let off = [0, 1].map(|k| 100.0 * (lens.focal[k] / FOCAL[k] / (1.0 + LARGER) - 1.0));
    testkit::tell(format_args!("focal lengths off by {off:.3?} %"));
    assert!(off.iter().all(|off| off.abs() < 0.3), "{off:?}");

    laboratory.calibrate(
        "hand-eye --images views --scene scene.toml --camera camera.toml -o hand-eye.toml",
        0,
        None,
    );
    let believed = HandEye::default();
    let turn = believed.rotation_deg.map(f64::to_radians);
    let error = pose(MOVED, TURNED.map(f64::to_radians));
    let truth = pose(believed.translation, turn) * error;
    let off = truth.inverse() * mounting(&laboratory.path("hand-eye.toml"));
    let (off_m, off_deg) = (
        off.translation.vector.norm(),
        off.rotation.angle().to_degrees(),
    );
    testkit::tell(format_args!(
        "mounting off by {:.2} mm, {off_deg:.3} deg",
        1e3 * off_m
    ));
    assert!(off_m < 1e-3 && off_deg < 0.1);

    // A busy machine looks at too few images in a shorter time.
    let words = format!(
        "latency --domain {domain} --seconds 60 --scene scene.toml --camera camera.toml \
         --hand-eye hand-eye.toml"
    );
    let said = laboratory.calibrate(&words, 0, Some(wiggle));
    let line = said
        .lines()
        .find_map(|line| line.strip_prefix("stamp_offset_ms = "));
    let offset: f64 = line.unwrap().split(' ').next().unwrap().parse().unwrap();
    testkit::tell(format_args!("stamps off by {:.2} ms", offset + BIAS_MS));
    assert!((offset + BIAS_MS).abs() < 2.0, "{offset}");
    laboratory.emulator.signal(Signal::TERM);
}
