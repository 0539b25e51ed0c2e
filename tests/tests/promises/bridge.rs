//! `vpcd`, `vpc-panda` and the robot behind the vendor's interface: whichever process dies or
//! hangs, and with the cable pulled, the arm stands within 150 ms, as the camera sees, or the robot
//! stops itself as the real one would; 200 ms where `vpcd` is asked to end, and brakes. Nothing
//! moves in lockstep, and a reflex stays until somebody asks.

use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use ipc::{Domain, Observer, now_ns};
use messages::{RobotFaults, RobotMode, RobotState};
use rustix::process::Signal;

use crate::fixture::{
    PATIENCE, PERIOD_NS, Place, Running, WAKE_NS, are_installed, ended, eventually, program, root,
    tell, turn, within,
};
use crate::stall::{fairly, in_time};

/// Time from a fault to standstill, ns; and where `vpcd` is asked to end, which brakes within
/// `brake_s`, 0.15 s, from its next cycle on.
const STANDS_NS: u64 = 150_000_000;
const BRAKES_NS: u64 = 200_000_000;
/// Least motion of the image between two frames that shows an arm in motion, and most that shows
/// one that stands, px.
const MOVES_PX: f64 = 0.15;
const STANDS_PX: f64 = 0.02;
/// How long the camera looks on after a fault.
const LOOKS: Duration = Duration::from_millis(1500);
/// The robot's error: too many commands in a row did not come.
const COMMUNICATION: &str = "communication_constraints_violation";

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    DaemonKilled,
    DaemonHangs,
    DaemonTerminated,
    BridgeKilled,
    BridgeHangs,
    BridgeTerminated,
    /// No packet arrives any more, at either end.
    CablePulled,
}

/// A network of its own, with a cable that can be pulled.
struct Cable(String);

impl Cable {
    fn plugged() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let cable = Self(format!("vpc-{}-{count}", std::process::id()));
        cable.ip(&["netns", "add", &cable.0]);
        cable.ip(&["-n", &cable.0, "link", "set", "lo", "up"]);
        cable
    }

    fn ip(&self, words: &[&str]) {
        let done = ended(testkit::command("ip").args(words));
        assert_eq!(done.code, Some(0), "ip {words:?}: {done:?}");
    }

    /// This program at one end of it.
    fn end(&self, name: &str) -> Command {
        let mut command = testkit::command("ip");
        command.args(["netns", "exec", &self.0]).arg(program(name));
        command
    }

    /// A queue that holds nothing.
    fn pull(&self) {
        let mut tc = testkit::command("tc");
        tc.args(["-n", &self.0, "qdisc", "add", "dev", "lo", "root"]);
        let done = ended(tc.args(["pfifo", "limit", "0"]));
        assert_eq!(done.code, Some(0), "{done:?}");
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        let _ = testkit::command("ip")
            .args(["netns", "del", &self.0])
            .status();
    }
}

/// All three processes, the arm in motion. Taken apart in this order.
pub struct Cell {
    pub observer: Observer,
    bridge: Running,
    pub daemon: Running,
    robot: Running,
    cable: Cable,
    pub place: Place,
}

/// A robot's name for the bridge, and the version of its interface.
pub type Model = (&'static str, &'static str);
/// Both that the bridge knows.
pub const PANDA: Model = ("panda", "5");
pub const FR3: Model = ("fr3", "10");

fn bridge(cable: &Cable, place: &Place, (name, _): Model) -> Command {
    let mut bridge = cable.end("vpc-panda");
    bridge.args(["--robot", &format!("{name}:127.0.0.1"), "--hand-eye"]);
    bridge
        .arg(root().join("ipc/clients/panda/hand-eye.toml"))
        .arg("--scene");
    bridge.arg(root().join("ipc/scene/scenes/paper-robot.toml"));
    bridge.arg("--domain").arg(place.domain());
    bridge.stdout(Stdio::null()).stderr(Stdio::piped());
    bridge
}

impl Cell {
    fn new(more: &[&str]) -> Self {
        Self::with(PANDA, more)
    }

    /// With this robot, and more words for the daemon.
    pub fn with(model: Model, more: &[&str]) -> Self {
        let (cable, place) = (Cable::plugged(), Place::new());
        let scenes = root().join("ipc/scene/scenes");
        let mut robot = cable.end("hw-sim");
        robot.args(["--robot", "panda", "--fci", "127.0.0.1:1337", "--scene"]);
        robot.arg(scenes.join("paper-robot.toml")).arg("--starts");
        robot.arg(scenes.join("paper-robot-starts.csv"));
        robot.arg("--domain").arg(place.domain());
        robot.args(["--fci-version", model.1]);
        let robot = Running::start(robot.stdout(Stdio::piped()).stderr(Stdio::piped()));
        let domain = Domain::join(&place.domain()).unwrap();
        let mut observer = Observer::open(&domain).unwrap();
        eventually("a frame", || observer.features.latest().unwrap());
        let bridge = Running::start(bridge(&cable, &place, model));
        let mut daemon = testkit::command(program("vpcd"));
        daemon.arg("--config");
        daemon.arg(root().join("controller/vpcd-robot.toml"));
        daemon.arg("--domain").arg(place.domain()).args(more);
        let daemon = Running::start(daemon.stdout(Stdio::null()).stderr(Stdio::piped()));
        Self {
            observer,
            bridge,
            daemon,
            robot,
            cable,
            place,
        }
    }

    /// Frames so far: when they were exposed, ns, and what was in them, px.
    fn frames(&mut self) -> Vec<(u64, [f64; 8])> {
        std::iter::from_fn(|| self.observer.features.oldest().unwrap())
            .map(|features| {
                let points = std::array::from_fn(|k| features.points[k]);
                (features.stamp.data_ns, points)
            })
            .collect()
    }

    /// Arms, as soon as camera and robot are there, and waits until the image moves.
    pub fn set_in_motion(&mut self) {
        eventually("arming", || {
            let mut vpcctl = testkit::command(program("vpcctl"));
            let arm = vpcctl.arg("--domain").arg(self.place.domain()).arg("arm");
            (ended(arm).code == Some(0)).then_some(())
        });
        self.until_it_moves();
    }

    /// Waits until the image moves.
    fn until_it_moves(&mut self) {
        let moves = within(PATIENCE, || {
            std::thread::sleep(Duration::from_millis(500));
            let frames = self.frames();
            let [.., (_, a), (_, b)] = frames.as_slice() else {
                return None;
            };
            (distance(a, b) > MOVES_PX).then_some(())
        });
        if moves.is_none() {
            let mut vpcctl = testkit::command(program("vpcctl"));
            let status = vpcctl.arg("--domain").arg(self.place.domain());
            panic!(
                "armed, it does not move: {:#?}",
                ended(status.arg("status"))
            );
        }
    }

    /// The newest state that the bridge told.
    fn state(&mut self) -> RobotState {
        eventually("a state", || self.observer.robot.latest().unwrap()).message
    }
}

fn distance(a: &[f64; 8], b: &[f64; 8]) -> f64 {
    let apart = std::iter::zip(a, b).map(|(a, b)| (a - b).abs());
    apart.fold(0.0, f64::max)
}

/// One fault: how long until the arm stood, ns.
fn strike(fault: Fault) -> anyhow::Result<u64> {
    let mut cell = Cell::new(&[]);
    cell.set_in_motion();
    let struck_ns = now_ns();
    match fault {
        Fault::DaemonKilled => cell.daemon.signal(Signal::KILL),
        Fault::DaemonHangs => cell.daemon.signal(Signal::STOP),
        Fault::DaemonTerminated => cell.daemon.signal(Signal::TERM),
        Fault::BridgeKilled => cell.bridge.signal(Signal::KILL),
        Fault::BridgeHangs => cell.bridge.signal(Signal::STOP),
        Fault::BridgeTerminated => cell.bridge.signal(Signal::TERM),
        Fault::CablePulled => cell.cable.pull(),
    }
    std::thread::sleep(LOOKS);
    let frames = cell.frames();
    let (_, last) = frames.last().unwrap();
    // The first frame of those in which it stands.
    let is_moving = |(_, points): &(u64, [f64; 8])| distance(points, last) > STANDS_PX;
    let moving = frames.iter().rposition(is_moving);
    let (stands_ns, _) = frames[moving.map_or(0, |k| k + 1)];
    // It stood for up to a frame before.
    let stands_within = match fault {
        Fault::DaemonTerminated => BRAKES_NS,
        _ => STANDS_NS,
    };
    let bar = stands_within + PERIOD_NS + WAKE_NS;
    let took = in_time("it stands", struck_ns, stands_ns.max(struck_ns), bar)?;

    // Whether the robot stopped itself, as the real one would.
    match fault {
        Fault::DaemonKilled | Fault::DaemonHangs | Fault::DaemonTerminated => {
            let state = cell.state();
            assert!(!state.faults().any(RobotFaults::REFLEX), "{state:?}");
            assert_ne!(state.mode(), Some(RobotMode::Fault));
            cell.daemon.signal(Signal::CONT);
        }
        Fault::BridgeTerminated => {
            let Cell { bridge, robot, .. } = cell;
            let said = bridge.ended();
            assert_eq!(said.code, Some(0), "{said:?}");
            let said = robot.terminated();
            assert!(said.stdout.contains("\"reflexes\":0"), "{said:?}");
        }
        Fault::BridgeKilled => {
            // Another one finds the error, and does not clear it unasked.
            cell.bridge = Running::start(bridge(&cell.cable, &cell.place, PANDA));
            recover(cell);
        }
        Fault::BridgeHangs => {
            cell.bridge.signal(Signal::CONT);
            recover(cell);
        }
        Fault::CablePulled => {
            let said = cell.bridge.ended();
            assert_eq!(said.code, Some(69), "{said:?}");
            assert!(said.stderr.contains("robot 127.0.0.1: "), "{said:?}");
        }
    }
    Ok(took)
}

/// The robot stopped itself for want of commands; it stays so, and `vpcctl recover` clears it.
fn recover(mut cell: Cell) {
    let is_at_fault = |state: &RobotState| state.mode() == Some(RobotMode::Fault);
    eventually("a reflex", || is_at_fault(&cell.state()).then_some(()));
    std::thread::sleep(Duration::from_millis(300));
    let state = cell.state();
    assert!(is_at_fault(&state) && state.faults().any(RobotFaults::REFLEX));
    let mut vpcctl = testkit::command(program("vpcctl"));
    let said = ended(
        vpcctl
            .arg("--domain")
            .arg(cell.place.domain())
            .arg("recover"),
    );
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(said.stdout.starts_with("recover: done"), "{said:?}");
    assert!(!is_at_fault(&cell.state()));
    let said = cell.robot.terminated();
    assert!(said.stdout.contains(COMMUNICATION), "{said:?}");
}

pub fn is_possible(what: &str) -> bool {
    testkit::is_root(what) && are_installed(what, &["ip=iproute2", "tc=iproute2"])
}

#[test]
fn whatever_dies_or_hangs_the_arm_stands_within_150_ms() {
    let _turn = turn();
    if !is_possible("faults about the bridge") {
        return;
    }
    for fault in [
        Fault::DaemonKilled,
        Fault::DaemonHangs,
        Fault::DaemonTerminated,
        Fault::BridgeKilled,
        Fault::BridgeHangs,
        Fault::BridgeTerminated,
        Fault::CablePulled,
    ] {
        let took = fairly("a fault about the bridge", || strike(fault));
        let took = took / 1_000_000;
        tell(format!(
            "bridge, {fault:?}: the arm is seen to stand after {took} ms, in frames 33 ms apart"
        ));
    }
}

#[test]
fn a_missing_robot_ends_the_bridge_and_disarms() {
    let _turn = turn();
    if !is_possible("a robot that is gone") {
        return;
    }
    let mut cell = Cell::new(&[]);
    cell.set_in_motion();
    cell.robot.signal(Signal::KILL);
    let said = cell.bridge.ended();
    assert_eq!(said.code, Some(69), "{said:?}");
    let disarmed =
        |twist: &messages::TwistCommand| twist.state() == Some(messages::TwistState::Disarmed);
    eventually("a controller that disarms", || {
        let twist = cell.observer.twist.oldest().unwrap()?;
        disarmed(&twist).then_some(())
    });
}

#[test]
fn a_controller_in_lockstep_moves_nothing() {
    let _turn = turn();
    if !is_possible("lockstep") {
        return;
    }
    let mut cell = Cell::new(&["--clock", "lockstep"]);
    eventually("commands that ask for motion", || {
        let twist = cell.observer.twist.oldest().unwrap()?;
        (twist.twist != [0.0; 6]).then_some(())
    });
    let before = cell.state().q;
    std::thread::sleep(LOOKS);
    assert_eq!(cell.state().q, before);
    let said = cell.bridge.terminated();
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(said.stderr.contains("lockstep"), "{said:?}");
}
