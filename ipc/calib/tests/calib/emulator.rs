//! Live, against the emulator: hw-sim's Panda carries its camera round a pattern of tags, by twists
//! of this test, while `vpc-calib` listens. What hw-sim's [truth] says is found out.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use hw_sim::robot::calibration::HandEye;
use ipc::{Domain, RobotState, TwistCommand, TwistState};
use rustix::process::Signal;
use testkit::{Place, Running, ended, program};
use vision_calibration_core::{Iso3, Vec3};

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
rate_hz = 30.0
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
}

fn pose(at: [f64; 3], turn: [f64; 3]) -> Iso3 {
    Iso3::new(Vec3::from(at), Vec3::from(turn))
}

impl Pilot {
    /// Steers towards what `wanted` says of the seconds since the start, until it says `None`.
    fn steer(&self, wanted: impl Fn(f64) -> Option<Iso3>) {
        let domain = Domain::join(&self.domain).unwrap();
        let mut twist = domain.publisher::<TwistCommand>().unwrap();
        let mut robot = domain.subscriber::<RobotState>(1).unwrap();
        let start = Instant::now();
        let mut seen = None;
        while !self.stop.load(Ordering::Relaxed) {
            if let Some(state) = robot.latest().unwrap() {
                seen = Some(pose(state.translation, state.rotation));
            }
            let Some(wanted) = wanted(start.elapsed().as_secs_f64()) else {
                return;
            };
            let mut command = TwistCommand::zero(TwistState::Moving);
            if let Some(seen) = seen {
                // The object is to move so; the camera moves against it.
                let off = wanted * seen.inverse();
                let gain: f64 = 3.0;
                let cap =
                    |vector: Vec3, most: f64| vector * (-gain).max(-most / vector.norm().max(1e-9));
                let linear = cap(off.translation.vector, 0.15);
                let angular = cap(off.rotation.scaled_axis(), 0.6);
                command.twist = [
                    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
                ];
            }
            twist.publish(&command.valid_for_ns(80_000_000)).unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Round the pattern, five seconds a place.
fn tour(time: f64) -> Option<Iso3> {
    let places = [
        ([0.0, 0.0, 0.36], [0.0, 0.0, 0.0]),
        ([0.02, 0.0, 0.36], [0.38, 0.0, 0.1]),
        ([0.0, 0.02, 0.33], [-0.36, 0.1, 0.3]),
        ([-0.02, 0.0, 0.38], [0.0, 0.40, -0.2]),
        ([0.0, -0.02, 0.34], [0.1, -0.38, 0.0]),
        ([0.02, 0.02, 0.40], [0.27, 0.27, 0.5]),
        ([-0.02, 0.02, 0.35], [-0.27, 0.27, -0.5]),
        ([-0.02, -0.02, 0.37], [-0.27, -0.27, 0.3]),
        ([0.02, -0.02, 0.33], [0.27, -0.27, -0.3]),
        ([0.0, 0.0, 0.42], [0.1, 0.1, 0.7]),
        ([0.01, 0.01, 0.31], [-0.1, 0.2, -0.7]),
    ];
    let (at, turn) = places[(time / 5.0) as usize % places.len()];
    Some(pose(at, turn))
}

/// As by hand.
fn wiggle(time: f64) -> Option<Iso3> {
    let wave =
        |amplitude: f64, hertz: f64| amplitude * (std::f64::consts::TAU * hertz * time).sin();
    let at = [
        wave(0.02, 0.43) + wave(0.015, 0.91),
        wave(0.02, 0.61) + wave(0.01, 1.07),
        0.36 + wave(0.01, 0.53),
    ];
    Some(pose(
        at,
        [wave(0.08, 0.77), wave(0.08, 0.59), wave(0.15, 0.37)],
    ))
}

#[test]
fn mounting_and_latency_of_the_emulated_robot_are_found_out_live() {
    let place = Place::new();
    let scene = place.file("scene.toml", SCENE);
    let starts = place.file("starts.csv", "tx,ty,tz,rx,ry,rz\n0,0,0.36,0,0,0\n");
    let keys = format!(
        "scene = {scene:?}\nstarts = {starts:?}\nrobot = \"panda\"\ncamera = \"rendered\"\nlatency_ms = 45.0\nexposure_ms = 4.0\n\
         [truth]\nhand_eye_m = {MOVED:?}\nhand_eye_deg = {TURNED:?}\n"
    );
    let config = place.file("hw-sim.toml", keys);
    let camera = place.file(
        "camera.toml",
        "width = 640\nheight = 480\nfx = 615.0\nfy = 612.0\ncx = 322.0\ncy = 237.0\ndistortion = [0, 0, 0, 0, 0]\n",
    );
    let file = place.path("hand-eye.toml");
    let mut emulator = Command::new(program("hw-sim"));
    emulator
        .arg("--config")
        .arg(&config)
        .arg("--domain")
        .arg(place.domain());
    let mut emulator = Running::start(emulator.stdout(Stdio::piped()).stderr(Stdio::piped()));
    emulator.line("go out in domain");
    let stop = Arc::new(AtomicBool::new(false));
    let steer = |wanted: fn(f64) -> Option<Iso3>| {
        let pilot = Pilot {
            domain: place.domain(),
            stop: Arc::clone(&stop),
        };
        std::thread::spawn(move || pilot.steer(wanted))
    };
    let calib = |command: &str| {
        let mut calib = Command::new(env!("CARGO_BIN_EXE_vpc-calib"));
        calib.arg(command).arg("--domain").arg(place.domain());
        calib
            .arg("--scene")
            .arg(&scene)
            .arg("--camera")
            .arg(&camera);
        calib
    };

    let pilot = steer(tour);
    let mut command = calib("hand-eye");
    command
        .args(["--views", "11", "--save"])
        .arg(place.path("views"));
    let said = ended(command.arg("-o").arg(&file));
    stop.store(true, Ordering::Relaxed);
    pilot.join().unwrap();
    testkit::tell(&said.stdout);
    assert_eq!(said.code, Some(0), "{said:?}");
    let error = pose(MOVED, TURNED.map(f64::to_radians));
    let believed = HandEye::default();
    let truth = pose(
        believed.translation,
        believed.rotation_deg.map(f64::to_radians),
    ) * error;
    let read = vpc_panda::hand_eye::read(&file, vpc_panda::hand_eye::Frame::Flange)
        .unwrap()
        .camera;
    let turn = panda::kinematics::rotation_vector(&read.rotation);
    let found = pose(read.translation.vector.into(), turn.into());
    let off = truth.inverse() * found;
    let off = [
        1e3 * off.translation.vector.norm(),
        off.rotation.angle().to_degrees(),
    ];
    testkit::tell(format_args!(
        "mounting off by {:.2} mm, {:.3} deg",
        off[0], off[1]
    ));
    assert!(off[0] < 1.0 && off[1] < 0.1, "{off:?}");

    // What was saved says the same.
    let mut again = Command::new(env!("CARGO_BIN_EXE_vpc-calib"));
    again
        .args(["hand-eye", "--images"])
        .arg(place.path("views"));
    again
        .arg("--scene")
        .arg(&scene)
        .arg("--camera")
        .arg(&camera);
    let again = ended(again);
    assert_eq!(
        (again.code, &again.stdout),
        (
            Some(0),
            &said
                .stdout
                .replace(&format!("written: {}\n", file.display()), "")
        )
    );

    stop.store(false, Ordering::Relaxed);
    let pilot = steer(wiggle);
    let mut command = calib("latency");
    let said = ended(
        command
            .arg("--hand-eye")
            .arg(&file)
            .args(["--seconds", "12"]),
    );
    stop.store(true, Ordering::Relaxed);
    pilot.join().unwrap();
    testkit::tell(&said.stdout);
    assert_eq!(said.code, Some(0), "{said:?}");
    let line = said
        .stdout
        .lines()
        .find_map(|line| line.strip_prefix("stamp_offset_ms = "));
    let offset: f64 = line.unwrap().split(' ').next().unwrap().parse().unwrap();
    // The emulator's stamps are true, however late images come.
    assert!(offset.abs() < 2.0, "{offset}");
    emulator.signal(Signal::TERM);
}
