//! Emulators of the FR3's interface by other teams judge `vpc-panda`. franka-sim holds each command
//! against the vendor's limits, counts lost ones, and moves an arm in MuJoCo; so does franky-sim,
//! without the limits.

mod emulator;
mod servo;

use arm::Mount;
use std::process::Stdio;
use std::time::{Duration, Instant};

use emulator::Emulator;
use franka::{RealtimeConfig, RobotMode as Mode, RobotOptions};
use hand_eye::Frame;
use ipc::{ControllerPorts, Domain};
use messages::{RobotFaults, RobotMode, RobotState, TwistCommand, TwistState};
use panda::{Chain, Joints, Pose, Twist};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use testkit::{Ended, Place, Running, eventually, not_run, repeats, tell};

/// Between two commands, as from a camera.
const FRAME: Duration = Duration::from_nanos(33_333_333);
/// How long one command stays the same.
const LEG: Duration = Duration::from_secs(2);
/// After so long the arm moves as commanded: the ramps take less than 0.2 s.
const SETTLED: Duration = Duration::from_millis(800);
/// Fewer steady instants of a leg are not judged.
const LEAST: usize = 10;
/// How long a command is valid, ns.
const VALID_NS: u64 = 100_000_000;
/// Time without commands, now and then: longer than one is valid.
const SILENCE: Duration = Duration::from_millis(250);
/// In the middle of the arm's reach, around where it begins: (0.307, 0, 0.590).
const WORKSPACE: &str = "[workspace]\nlower = [0.25, -0.2, 0.35]\nupper = [0.5, 0.2, 0.65]\n";
/// Greatest speeds of the camera: the defaults of `vpc-panda`. m/s, rad/s.
const CAPS: [f64; 2] = [0.05, 0.25];

/// What the bridge says where the emulator, which is in Python, did not run for 20 ms or more.
const STALLS: [&str; 2] = [
    "UDP receive: Timeout",
    "[\"communication_constraints_violation\"]",
];

/// What one run showed.
#[derive(Debug, Default)]
struct Seen {
    states: u32,
    /// Instants at which the arm had to move as commanded.
    steady: u32,
    /// Greatest distance there between the command and what `vpc/robot` told, as a share of the
    /// caps.
    told_apart: f64,
    /// Greatest distance there between the command and the measured joints' twist, as a share of
    /// the caps, but for the worst quarter of each leg: a stall of the machine of some milliseconds
    /// leaves this emulator's arm behind, and it catches up at once, at up to one and a half times
    /// the command.
    moved_apart: f64,
    /// Legs of [`LEAST`] such instants.
    legs: u32,
    /// Greatest way of a joint from where it began, rad.
    way: f64,
    /// Share of commands that came in time, over the last hundred: the worst.
    least_rate: f64,
    stale: u32,
    limited: u32,
}

/// A command for the next leg: most within the caps, some far beyond.
fn leg(random: &mut ChaCha8Rng) -> Twist {
    let [linear, angular] = CAPS;
    let share = [0.2, 0.5, 0.5, 20.0][random.random_range(0..4)];
    Twist::from_fn(|k, _| {
        let cap = if k < 3 { linear } else { angular };
        share * cap * random.random_range(-1.0..1.0)
    })
}

/// The camera's twist of these joint velocities, the end effector being the flange.
fn camera(mount: &Mount, q: &[f64; 7], dq: &[f64; 7]) -> Twist {
    let posture = Chain::new(Pose::identity()).posture(&Joints::from(*q));
    let twist = posture.jacobian * Joints::from(*dq);
    mount.to_camera(&posture.pose.rotation, &Pose::identity(), &twist)
}

/// The bridge, and the controller's end of the domain that it is in.
struct Bench {
    bridge: Running,
    controller: ControllerPorts,
    mount: Mount,
    emulator: Emulator,
    _domain: Domain,
    _place: Place,
}

impl Bench {
    fn start(test: &str, interface: &str) -> Option<Self> {
        let emulator = Emulator::start(test)?;
        let place = Place::new();
        let hand_eye = testkit::root().join("ipc/clients/panda/hand-eye.toml");
        let mut command = testkit::command(env!("CARGO_BIN_EXE_vpc-panda"));
        command
            .arg("--config")
            .arg(place.file("vpc-panda.toml", WORKSPACE))
            .args(["--robot", &format!("fr3:{}", emulator.address())])
            .arg("--scene")
            .arg(testkit::scene_file())
            .arg("--hand-eye")
            .arg(&hand_eye)
            .args(["--interface", interface])
            .arg("--domain")
            .arg(place.domain())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut bridge = Running::start(command);
        bridge.line("the robot follows vpc/twist");
        let domain = Domain::join(&place.domain()).unwrap();
        let hand_eye = hand_eye::read(&hand_eye, Frame::Flange).unwrap();
        Some(Self {
            bridge,
            controller: ControllerPorts::open(&domain).unwrap(),
            mount: hand_eye.mount(&Pose::identity()),
            emulator,
            _domain: domain,
            _place: place,
        })
    }

    fn state(&mut self) -> RobotState {
        eventually("a state", || self.controller.robot.latest().unwrap()).message
    }

    /// Commands at random for so long.
    ///
    /// # Errors
    /// The bridge's log, where the bridge or the motion ended.
    fn drive(&mut self, length: Duration, random: &mut ChaCha8Rng) -> Result<Seen, String> {
        let mut seen = Seen {
            least_rate: 1.0,
            ..Seen::default()
        };
        let first = self.state();
        let begin = Instant::now();
        let (mut command, mut since, mut undisturbed) = (Twist::zeros(), begin, begin);
        let (mut frame, mut legs) = (0, 0);
        let mut moved = Vec::new();
        let (mut due, mut silent_until) = (begin, begin);
        while begin.elapsed() < length {
            if since.elapsed() > LEG {
                seen.end(&mut moved);
                // There and back, so that the arm stays where it can move.
                legs += 1;
                command = if legs % 2 == 0 { -command } else { leg(random) };
                since = Instant::now();
            }
            frame += 1;
            let twist = match (frame % 200, random.random::<f64>()) {
                (50, _) => Some(Twist::repeat(f64::NAN)),
                (100, _) => Some(Twist::repeat(-1e300)),
                (150, _) => {
                    silent_until = Instant::now() + SILENCE;
                    None
                }
                (_, x) if x < 0.05 => None,
                _ => (Instant::now() > silent_until).then_some(command),
            };
            if let Some(twist) = twist {
                let mut sent =
                    TwistCommand::zero(TwistState::Moving).valid_until(ipc::now_ns() + VALID_NS);
                sent.twist = twist.into();
                self.controller.twist.publish(&sent).unwrap();
            }
            due += FRAME;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            if !self.bridge.is_running() {
                return Err(self.bridge.stderr());
            }
            let state = self.state();
            if state.mode() == Some(RobotMode::Fault) {
                self.bridge.line("the robot stopped");
                return Err(self.bridge.stderr());
            }
            if Instant::now() < silent_until || twist.is_some_and(|twist| twist != command) {
                undisturbed = Instant::now();
            }
            if seen.take(&state, &first) {
                undisturbed = Instant::now();
            }
            if since.max(undisturbed).elapsed() > SETTLED {
                moved.push(seen.judge(&state, &command, &self.mount));
            }
        }
        seen.end(&mut moved);
        Ok(seen)
    }

    /// SIGTERM in motion: the arm stands then.
    fn stop(mut self) {
        let Ended { code, stderr, .. } = self.bridge.terminated();
        assert_eq!(code, Some(0), "{stderr}");
        let last = self.controller.robot.latest().unwrap();
        let last = last.expect("the bridge told how it ended").message;
        assert_eq!(last.mode(), Some(RobotMode::Idle));
        assert!(!stderr.contains("the robot stopped"), "{stderr}");
        // The emulator's own word, to a client of its own.
        let options = RobotOptions::new(RealtimeConfig::Ignore);
        let address = self.emulator.address().to_string();
        let robot = franka::Robot::with_options(&address, options).unwrap();
        let state = robot.read_once().unwrap();
        assert_eq!(state.robot_mode, Mode::Idle);
        assert!(Joints::from(state.dq).amax() < 1e-3, "{:?}", state.dq);
        drop(robot);
        let log = self.emulator.stopped();
        for words in ["violation", "discontinuity", "Traceback"] {
            assert!(!log.contains(words), "{log}");
        }
    }
}

impl Seen {
    /// Counts a state. Returns whether something limits the arm.
    fn take(&mut self, state: &RobotState, first: &RobotState) -> bool {
        let is_stale = state.mode() != Some(RobotMode::Moving);
        let is_limited = state.faults().any(RobotFaults::COMMAND_LIMITED);
        self.states += 1;
        self.stale += u32::from(is_stale);
        self.limited += u32::from(is_limited);
        let way = Joints::from(state.q) - Joints::from(first.q);
        self.way = self.way.max(way.amax());
        self.least_rate = self.least_rate.min(state.commands_in_time);
        is_stale || is_limited
    }

    /// Returns the distance between the command and the measured joints' twist, a share of the caps.
    fn judge(&mut self, state: &RobotState, command: &Twist, mount: &Mount) -> f64 {
        let apart = |twist: Twist| {
            let [linear, angular] = CAPS;
            let apart = twist - command;
            let share = |first: usize, cap: f64| apart.fixed_rows::<3>(first).norm() / cap;
            share(0, linear).max(share(3, angular))
        };
        self.steady += 1;
        self.told_apart = self.told_apart.max(apart(Twist::from(state.twist)));
        apart(camera(mount, &state.q, &state.dq))
    }

    /// A leg ended.
    fn end(&mut self, moved: &mut Vec<f64>) {
        moved.sort_by(f64::total_cmp);
        if moved.len() >= LEAST {
            self.moved_apart = self.moved_apart.max(moved[moved.len() * 3 / 4]);
            self.legs += 1;
        }
        moved.clear();
    }
}

/// Drives the arm by one interface; `None` where franka-sim cannot be had, or the machine stood
/// still, and with it an emulator that is not of real time.
fn judged(test: &str, interface: &str) -> Option<Seen> {
    let _turn = testkit::turn();
    let seconds = repeats(&format!("{test}: seconds"), 20, 120) as u64;
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut bench = Bench::start(test, interface)?;
    match bench.drive(Duration::from_secs(seconds), &mut random) {
        Ok(seen) => {
            tell(format_args!("{test}: {seen:?}"));
            bench.stop();
            Some(seen)
        }
        Err(log) if STALLS.iter().any(|words| log.contains(words)) => {
            not_run(test, format_args!("the machine stood still: {log}"));
            None
        }
        Err(log) => panic!("{test}: {log}"),
    }
}

#[test]
#[ignore = "long: runs in real time on another team's emulator"]
fn another_teams_fr3_follows_joint_velocities_without_a_reflex() {
    let Some(seen) = judged("franka-sim, joint velocities", "joint") else {
        return;
    };
    assert!(
        seen.way > 0.05 && seen.steady > 30 && seen.legs > 2,
        "{seen:?}"
    );
    assert!(seen.stale > 0 && seen.limited > 0, "{seen:?}");
    assert!(seen.told_apart < 0.02 && seen.moved_apart < 0.1, "{seen:?}");
}

#[test]
#[ignore = "long: runs in real time on another team's emulator"]
fn another_teams_fr3_follows_without_a_reflex() {
    let Some(seen) = judged("franka-sim, Cartesian velocities", "cartesian") else {
        return;
    };
    assert!(
        seen.way > 0.05 && seen.steady > 30 && seen.legs > 2,
        "{seen:?}"
    );
    assert!(seen.stale > 0 && seen.limited > 0, "{seen:?}");
    // It tells no desired joints in Cartesian motions.
    assert!(seen.moved_apart < 0.1, "{seen:?}");
}
