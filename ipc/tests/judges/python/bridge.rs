//! `robot_bridge.py` with stand-ins for the libraries of two robots: what the arm does, and what
//! `vpc/robot` says of it.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use ipc::{ControllerPorts, Domain, Observer};
use messages::{RobotFaults, RobotMode, RobotState, TwistCommand, TwistState};
use testkit::python::{Environment, run};
use testkit::{Ended, Place, Running, eventually};

use super::{numbers, sources, with_stand_ins};

const ROBOTS: [&str; 2] = ["ur", "xarm"];
const TWIST: [f64; 6] = [0.02, -0.01, 0.025, 0.05, -0.04, 0.1];
const STILL: [f64; 6] = [0.0; 6];
/// How long each command claims to be valid, ns.
const VALID_NS: u64 = 100_000_000;
/// The workspace: lower and upper corner, m. The stand-in's tool begins at (0.5, 0.1, 0.3).
const WIDE: [f64; 6] = [0.1, -0.5, 0.05, 0.9, 0.6, 0.9];

fn hand_eye() -> PathBuf {
    sources("clients/panda/hand-eye.toml")
}

struct Rig {
    python: PathBuf,
    place: Place,
    controller: ControllerPorts,
    observer: Observer,
    bridge: Running,
}

impl Rig {
    fn start(python: &Path, robot: &str, workspace: [f64; 6], more: &[&str]) -> Self {
        let place = Place::new();
        let domain = Domain::join(&place.domain()).unwrap();
        let controller = ControllerPorts::open(&domain).unwrap();
        let observer = Observer::open(&domain).unwrap();
        let mut bridge = with_stand_ins(python, "clients/python/robot_bridge.py");
        bridge.arg(robot).arg(place.path("log")).arg("--hand-eye");
        bridge.arg(hand_eye()).arg("--domain").arg(place.domain());
        let (lower, upper) = workspace.split_at(3);
        for (name, corner) in [("--lower", lower), ("--upper", upper)] {
            bridge.arg(name).args(corner.iter().map(f64::to_string));
        }
        bridge.args(more).stdout(Stdio::piped());
        let mut rig = Self {
            python: python.to_owned(),
            place,
            controller,
            observer,
            bridge: Running::start(bridge.stderr(Stdio::piped())),
        };
        rig.state("its first state", |_| true);
        rig
    }

    /// Waits for a state of the robot.
    fn state(&mut self, what: &str, is_it: impl Fn(&RobotState) -> bool) -> RobotState {
        eventually(what, || {
            let state = self.observer.robot.oldest().unwrap();
            state.map(|state| state.message).filter(&is_it)
        })
    }

    /// Publishes a command at 30 Hz, valid as this says; the states that came meanwhile.
    fn drive(
        &mut self,
        twist: [f64; 6],
        frames: u32,
        valid: impl Fn(TwistCommand) -> TwistCommand,
    ) -> Vec<RobotState> {
        let mut states = Vec::new();
        for _ in 0..frames {
            let mut command = TwistCommand::zero(TwistState::Moving);
            command.twist = twist;
            self.controller.twist.publish(&valid(command)).unwrap();
            std::thread::sleep(Duration::from_millis(33));
            while let Some(state) = self.observer.robot.oldest().unwrap() {
                states.push(state.message);
            }
        }
        states
    }

    fn follow(&mut self, twist: [f64; 6], frames: u32) -> Vec<RobotState> {
        self.drive(twist, frames, |command| {
            command.valid_until(ipc::now_ns() + VALID_NS)
        })
    }

    /// What judge.py says of the stand-in's log, for a camera that was to move so.
    fn judged(&self, twist: [f64; 6]) -> String {
        let mut judge = with_stand_ins(&self.python, "tests/judges/python/stand_ins/judge.py");
        judge.arg(self.place.path("log")).arg(hand_eye());
        run(judge.args(twist.map(|v| v.to_string()))).unwrap()
    }

    /// Terminates the bridge; its end, and what is said of the log.
    fn terminated(self, twist: [f64; 6]) -> (Ended, String) {
        let Self {
            python,
            place,
            controller,
            observer,
            bridge,
        } = self;
        let ended = bridge.terminated();
        let rig = Self {
            bridge: Running::start(testkit::command("true")),
            python,
            place,
            controller,
            observer,
        };
        (ended, rig.judged(twist))
    }
}

fn has(state: &RobotState, fault: RobotFaults) -> bool {
    state.faults & fault.0 != 0
}

/// The median of each component of the twist.
fn median(states: &[RobotState]) -> [f64; 6] {
    std::array::from_fn(|k| {
        let mut values: Vec<f64> = states.iter().map(|state| state.twist[k]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    })
}

/// The camera moves as commanded, along one screw from the start to the end; the states say so.
fn the_camera_follows(python: &Path, robot: &str) {
    let mut rig = Rig::start(python, robot, WIDE, &[]);
    let idle = rig.state("idle", |state| state.mode == RobotMode::Idle.code());
    let joints = if robot == "ur" { 6 } else { 7 };
    assert_eq!(idle.joints, joints);
    for k in 0..joints as usize {
        let expected = 0.1 * (k + 1) as f64;
        assert!((idle.q[k] - expected).abs() < 1e-6, "{idle:?}");
        assert!((idle.dq[k] - 0.1 * expected).abs() < 1e-6, "{idle:?}");
    }
    let states = rig.follow(TWIST, 45);
    let last = &states[states.len() * 2 / 3..];
    assert!(last.len() > 15, "{} states", last.len());
    let told = median(last);
    let off = (0..6).map(|k| (told[k] - TWIST[k]).abs());
    let off = off.fold(0.0, f64::max);
    let end = last.last().unwrap();
    assert!(off < 1e-3, "{robot} tells {told:?}");
    assert_eq!((end.mode, end.faults), (RobotMode::Moving.code(), 0));

    // The last command ends; nobody sends another one.
    let valid_until = ipc::now_ns() + VALID_NS - 33_000_000;
    let stale = rig.state("rest", |state| {
        state.mode == RobotMode::Stale.code() && state.twist.iter().all(|v| v.abs() < 1e-4)
    });
    assert!(has(&stale, RobotFaults::STALE_COMMAND));
    let until = numbers(&rig.judged(TWIST), "moved until")[0];
    let took = (until - valid_until as f64) / 1e6;
    assert!(took < 200.0, "{robot} took {took:.0} ms to stop");

    // In motion when it is terminated: it brakes, and never jumps.
    rig.follow(TWIST, 15);
    let (ended, judged) = rig.terminated(TWIST);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let seconds = numbers(&judged, "seconds")[0];
    assert!((1.5..3.0).contains(&seconds), "{judged}");
    let off = numbers(&judged, "off");
    assert!(off[0] < 5e-4 && off[1] < 3e-3, "{robot}: {judged}");
    assert_eq!(numbers(&judged, "last twist"), STILL);
    // The ramps take at most 40 ms at a time.
    let jump = numbers(&judged, "jump");
    assert!(jump[0] < 0.0201 && jump[1] < 0.0481, "{robot}: {judged}");
    let calls = match robot {
        "ur" => "setWatchdog speedL speedStop stopScript",
        _ => "set_mode set_state vc_set_cartesian_velocity disconnect",
    };
    assert!(judged.contains(&format!("calls {calls}\n")), "{judged}");
    println!(
        "{robot}: told within {off_told:.1e}; {seconds:.2} s of motion, off by {:.3} mm and {:.2} mrad; \
         stops {took:.0} ms after its command",
        1e3 * off[0],
        1e3 * off[1],
        off_told = (0..6)
            .map(|k| (told[k] - TWIST[k]).abs())
            .fold(0.0, f64::max),
    );
}

/// Neither a command of lockstep nor one that is not finite moves anything.
fn nothing_moves(python: &Path, robot: &str) {
    let mut rig = Rig::start(python, robot, WIDE, &[]);
    let states = rig.drive(TWIST, 10, |command| command);
    assert!(states.iter().all(|s| s.mode == RobotMode::Idle.code()));
    let mut broken = TWIST;
    broken[4] = f64::NAN;
    rig.follow(broken, 10);
    let (ended, judged) = rig.terminated(TWIST);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stderr.contains("vpc/twist: twist[4] = nan"));
    assert_eq!(numbers(&judged, "moved until"), [0.0]);
    assert_eq!(numbers(&judged, "way"), [0.0; 3]);
}

/// A fast command is shortened and keeps its direction.
fn the_caps_hold(python: &Path, robot: &str) {
    let caps = ["--linear", "0.03", "--angular", "0.1"];
    for twist in [
        [0.3, 0.1, -0.2, 0.05, 0.1, 0.0],
        [0.02, 0.0, 0.01, 1.0, -2.0, 0.5],
    ] {
        let mut rig = Rig::start(python, robot, WIDE, &caps);
        let states = rig.follow(twist, 20);
        let last = states.last().unwrap();
        assert!(has(last, RobotFaults::COMMAND_LIMITED), "{last:?}");
        let (_, judged) = rig.terminated(twist);
        let [linear, angular] = numbers(&judged, "fastest")[..] else {
            panic!("{judged}")
        };
        assert!(linear < 0.0301 && angular < 0.1001, "{robot}: {judged}");
        assert!(linear > 0.029 || angular > 0.097, "{robot}: {judged}");
        let off = numbers(&judged, "off");
        assert!(off[0] < 5e-4 && off[1] < 3e-3, "{robot}: {judged}");
    }
}

/// The arm stands at the wall of its workspace, and leaves it when it is told to.
fn the_walls_hold(python: &Path, robot: &str) {
    let near = [0.485, 0.085, 0.285, 0.515, 0.115, 0.315];
    let mut rig = Rig::start(python, robot, near, &[]);
    let twist = [0.05, 0.0, 0.0, 0.0, 0.0, 0.0];
    let states = rig.follow(twist, 50);
    let last = states.last().unwrap();
    assert!(has(last, RobotFaults::COMMAND_LIMITED), "{last:?}");
    assert!(last.twist.iter().all(|v| v.abs() < 2e-3), "{last:?}");
    let farthest = |judged: &str| {
        let way = numbers(judged, "way");
        way.iter().fold(0.0_f64, |most, x| most.max(x.abs()))
    };
    let at_wall = farthest(&rig.judged(twist));
    assert!(
        (0.0140..0.0155).contains(&at_wall),
        "{robot}: {at_wall} m, of 0.015"
    );
    rig.follow([-0.03, 0.0, 0.0, 0.0, 0.0, 0.0], 15);
    let (_, judged) = rig.terminated(twist);
    let back = farthest(&judged);
    assert!(back < at_wall - 0.005, "{robot} stays: {judged}");
}

/// A protective stop is told, and stays told when somebody clears it: the bridge moves nothing.
fn a_fault_stays(python: &Path, robot: &str) {
    let mut rig = Rig::start(python, robot, WIDE, &[]);
    rig.follow(TWIST, 10);
    let cause = rig.place.file("log.fault", "");
    let states = rig.follow(TWIST, 10);
    let last = states.last().unwrap();
    assert_eq!(last.mode, RobotMode::Fault.code());
    assert!(has(last, RobotFaults::REFLEX), "{last:?}");
    std::fs::remove_file(cause).unwrap();
    let before = rig.judged(TWIST);
    let states = rig.follow(TWIST, 10);
    assert!(states.iter().all(|s| s.mode == RobotMode::Fault.code()));
    assert_eq!(rig.judged(TWIST), before);
    let (ended, _) = rig.terminated(TWIST);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let cause = if robot == "ur" {
        "protective stop"
    } else {
        "error_code 31"
    };
    let words = format!("robot_bridge: fault: {cause}");
    assert!(ended.stderr.contains(&words), "{}", ended.stderr);
}

/// An arm that does not know where it is stands, and the bridge says why.
fn a_lost_place_is_a_fault(python: &Path, robot: &str) {
    let mut rig = Rig::start(python, robot, WIDE, &[]);
    rig.follow(TWIST, 10);
    rig.place.file("log.nan", "");
    let states = rig.follow(TWIST, 10);
    let last = states.last().unwrap();
    assert_eq!(last.mode, RobotMode::Fault.code());
    let (ended, _) = rig.terminated(TWIST);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let words = "robot_bridge: fault: its pose, velocity or joints are not finite";
    assert!(ended.stderr.contains(words), "{}", ended.stderr);
}

/// See `robust.py`.
fn robust(python: &Path) {
    let place = Place::new();
    let directory = place.path("pipe");
    std::fs::create_dir(&directory).unwrap();
    let mut script = with_stand_ins(python, "tests/judges/python/robust.py");
    let said = run(script.arg(directory)).unwrap();
    assert_eq!(said.matches("refused").count(), 3, "{said}");
    assert!(said.contains("robust robot_bridge"), "{said}");
}

/// With `--dry-run` it says what it would send, and sends nothing.
fn a_dry_run_sends_nothing(python: &Path, robot: &str) {
    let mut rig = Rig::start(python, robot, WIDE, &["--dry-run"]);
    let states = rig.follow(TWIST, 45);
    assert!(states.iter().all(|s| s.mode == RobotMode::Idle.code()));
    assert!(!rig.place.path("log").exists());
    let ended = rig.bridge.terminated();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let moving = |line: &&str| line.starts_with("would send [") && !line.contains("[0.0,");
    assert!(ended.stdout.lines().any(|l| moving(&l)), "{ended:?}");
    assert!(ended.stdout.contains("tool in the base [0.5, 0.1, 0.3] m"));
}

/// Wrong arguments: which, its value, and what is allowed.
fn refusals(python: &Path) {
    let place = Place::new();
    let bad_hand_eye = place.file(
        "bad.toml",
        "translation = [0.0, 0.0]\nrotation_deg = [0, 0, 0]",
    );
    let log = place.path("log");
    let refused = |robot: &str, hand_eye: &Path, more: &[&str]| {
        let mut bridge = with_stand_ins(python, "clients/python/robot_bridge.py");
        bridge.arg(robot).arg(&log).arg("--hand-eye").arg(hand_eye);
        bridge.args(["--lower", "0", "0", "0", "--upper", "1", "1", "1"]);
        bridge.arg("--domain").arg(place.domain()).args(more);
        run(&mut bridge).unwrap_err()
    };
    let good = hand_eye();
    let cases: [(&[&str], &str); 6] = [
        (
            &["--linear", "0"],
            "--linear 0.0; allowed: more than 0, up to 0.25",
        ),
        (
            &["--angular", "nan"],
            "--angular nan; allowed: more than 0, up to 1.0",
        ),
        (
            &["--linear-acceleration", "3"],
            "--linear-acceleration 3.0; allowed: more than 0, up to 2.0",
        ),
        (
            &["--upper", "1", "-1", "1"],
            "--lower y = 0.0, --upper y = -1.0; allowed: -10 to 10 m, lower first",
        ),
        (
            &["--upper", "0.4", "1", "1"],
            "the tool's x = 0.5000 m in the base; allowed: the workspace, 0.0 to 0.4",
        ),
        (
            &["--hand-eye", "/nowhere.toml"],
            "[Errno 2] No such file or directory: '/nowhere.toml'",
        ),
    ];
    for (more, words) in cases {
        assert_eq!(refused("ur", &good, more), format!("robot_bridge: {words}"));
    }
    let words = refused("xarm", &bad_hand_eye, &[]);
    assert!(
        words.ends_with("translation = [0.0, 0.0]; allowed: three finite numbers"),
        "{words}"
    );
    let words = refused("panda", &good, &[]);
    assert!(words.contains("invalid choice: 'panda'"), "{words}");
    assert!(!log.exists());
}

#[test]
fn the_bridge_in_python_drives_robots_within_limits() {
    if let Some(python) =
        Environment::JUDGES.python("the_bridge_in_python_drives_robots_within_limits")
    {
        refusals(&python);
        robust(&python);
        for robot in ROBOTS {
            the_camera_follows(&python, robot);
            nothing_moves(&python, robot);
            the_caps_hold(&python, robot);
            the_walls_hold(&python, robot);
            a_lost_place_is_a_fault(&python, robot);
            a_fault_stays(&python, robot);
            a_dry_run_sends_nothing(&python, robot);
        }
    }
}
