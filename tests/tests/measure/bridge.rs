//! `vpcd`, `vpc-panda` and the robot behind the vendor's interface: whichever process dies or
//! hangs, and with the cable pulled, the arm stands within 150 ms, as the camera sees, or the robot
//! stops itself as the real one would; 200 ms where `vpcd` is asked to end, and brakes. Nothing
//! moves in lockstep, and a reflex stays until somebody asks.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use ipc::{Domain, Observer, now_ns};
use messages::{RobotFaults, RobotMode, RobotState, TwistState};
use rustix::process::Signal;

use crate::fixture::{PERIOD_NS, Place, Running, WAKE_NS, ended, eventually, program, root};
use crate::judge::{Miss, in_time};
use crate::reference::Class;
use crate::sheet::Sheet;

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
pub enum Fault {
    DaemonKilled,
    DaemonHangs,
    DaemonTerminated,
    BridgeKilled,
    BridgeHangs,
    BridgeTerminated,
    /// No packet arrives any more, at either end.
    CablePulled,
}

/// All of them.
pub const FAULTS: [Fault; 7] = [
    Fault::DaemonKilled,
    Fault::DaemonHangs,
    Fault::DaemonTerminated,
    Fault::BridgeKilled,
    Fault::BridgeHangs,
    Fault::BridgeTerminated,
    Fault::CablePulled,
];

impl Fault {
    /// The name of its measurement.
    pub fn name(self) -> &'static str {
        match self {
            Self::DaemonKilled => "bridge, vpcd killed",
            Self::DaemonHangs => "bridge, vpcd hangs",
            Self::DaemonTerminated => "bridge, vpcd terminated",
            Self::BridgeKilled => "bridge killed",
            Self::BridgeHangs => "bridge hangs",
            Self::BridgeTerminated => "bridge terminated",
            Self::CablePulled => "bridge, cable pulled",
        }
    }

    /// From the fault to the first frame in which the arm stands, ns: it stood for up to a frame
    /// before.
    fn bar_ns(self) -> u64 {
        let stands_ns = match self {
            Self::DaemonTerminated => BRAKES_NS,
            _ => STANDS_NS,
        };
        stands_ns + PERIOD_NS + WAKE_NS
    }
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

/// The configuration for this robot, in real time where that is permitted.
fn config(place: &Place) -> PathBuf {
    let file = root().join("controller/vpcd-robot.toml");
    let text = std::fs::read_to_string(file).unwrap();
    let above = format!("\"{}/", root().display());
    let text = text.replace("\"../", &above);
    place.file("vpcd.toml", text + "\n[realtime]\npriority = 60\n")
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
        daemon.arg("--config").arg(config(&place));
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
    ///
    /// # Errors
    /// If it is disarmed before it moves, as a late machine may cause.
    pub fn set_in_motion(&mut self) -> Result<(), Miss> {
        eventually("arming", || {
            let mut arm = self.place.vpcctl();
            (ended(arm.arg("arm")).code == Some(0)).then_some(())
        });
        let armed_ns = now_ns();
        while self.observer.twist.oldest().unwrap().is_some() {}
        eventually("motion", || {
            while let Some(twist) = self.observer.twist.oldest().unwrap() {
                if twist.state() == Some(TwistState::Disarmed) {
                    let state = self.place.state();
                    let what = format!("disarmed before it moves: {state}");
                    let class = Class::Ordinary;
                    return Some(Err(Miss::upset(what, class, armed_ns, now_ns())));
                }
            }
            std::thread::sleep(Duration::from_millis(500));
            let frames = self.frames();
            let [.., (_, a), (_, b)] = frames.as_slice() else {
                return None;
            };
            (distance(a, b) > MOVES_PX).then_some(Ok(()))
        })
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
    let armed_ns = now_ns();
    cell.set_in_motion()?;
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
    let Some(moving) = frames.iter().rposition(is_moving) else {
        let what = "it stood before";
        return Err(Miss::upset(what, Class::Ordinary, armed_ns, struck_ns).into());
    };
    let (stands_ns, _) = frames[moving + 1];
    let stands_ns = stands_ns.max(struck_ns);
    let took = in_time(
        "it stands",
        Class::Ordinary,
        struck_ns,
        stands_ns,
        fault.bar_ns(),
    )?;

    // Whether the robot stopped itself, as the real one would.
    match fault {
        Fault::DaemonKilled | Fault::DaemonHangs | Fault::DaemonTerminated => {
            let state = cell.state();
            let is_ready =
                !state.faults().any(RobotFaults::REFLEX) && state.mode() != Some(RobotMode::Fault);
            let what = || format!("the robot stopped itself: {state:?}");
            Miss::unless(is_ready, what, Class::Ordinary, struck_ns)?;
            cell.daemon.signal(Signal::CONT);
        }
        Fault::BridgeTerminated => {
            let Cell { bridge, robot, .. } = cell;
            let said = bridge.ended();
            assert_eq!(said.code, Some(0), "{said:?}");
            let said = robot.terminated();
            let is_without = said.stdout.contains("\"reflexes\":0");
            let what = || format!("the robot stopped itself: {said:?}");
            Miss::unless(is_without, what, Class::Ordinary, struck_ns)?;
        }
        Fault::BridgeKilled => {
            // Another one finds the error, and does not clear it unasked.
            cell.bridge = Running::start(bridge(&cell.cable, &cell.place, PANDA));
            recover(cell)?;
        }
        Fault::BridgeHangs => {
            cell.bridge.signal(Signal::CONT);
            recover(cell)?;
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
fn recover(mut cell: Cell) -> Result<(), Miss> {
    let from_ns = now_ns();
    let is_at_fault = |state: &RobotState| state.mode() == Some(RobotMode::Fault);
    eventually("a reflex", || is_at_fault(&cell.state()).then_some(()));
    std::thread::sleep(Duration::from_millis(300));
    let state = cell.state();
    assert!(is_at_fault(&state) && state.faults().any(RobotFaults::REFLEX));
    let said = ended(cell.place.vpcctl().arg("recover"));
    let is_done = said.code == Some(0) && said.stdout.starts_with("recover: done");
    Miss::unless(is_done, || format!("{said:?}"), Class::Ordinary, from_ns)?;
    assert!(!is_at_fault(&cell.state()));
    let said = cell.robot.terminated();
    assert!(said.stdout.contains(COMMUNICATION), "{said:?}");
    Ok(())
}

/// Whether the machine has what the cable needs.
pub fn is_possible(sheet: &mut Sheet) -> bool {
    sheet.is_root() && sheet.has(&["ip=iproute2", "tc=iproute2"])
}

/// Measures this fault.
pub fn measure(fault: Fault, sheet: &mut Sheet) {
    if !is_possible(sheet) {
        return;
    }
    let struck = sheet.round(&[Class::Ordinary], fault.name(), || strike(fault));
    if let Some(ns) = struck {
        sheet.longest("the arm is seen to stand after", ns, fault.bar_ns());
    }
}

/// Measures a robot that is gone.
pub fn measure_missing_robot(sheet: &mut Sheet) {
    if !is_possible(sheet) {
        return;
    }
    sheet.round(&[Class::Ordinary], "a robot that is gone", || {
        let mut cell = Cell::new(&[]);
        cell.set_in_motion()?;
        cell.robot.signal(Signal::KILL);
        let said = cell.bridge.ended();
        assert_eq!(said.code, Some(69), "{said:?}");
        eventually("a controller that disarms", || {
            let twist = cell.observer.twist.oldest().unwrap()?;
            (twist.state() == Some(TwistState::Disarmed)).then_some(())
        });
        Ok(())
    });
}

/// Measures a controller in lockstep.
pub fn measure_lockstep(sheet: &mut Sheet) {
    if !is_possible(sheet) {
        return;
    }
    sheet.round(&[Class::Ordinary], "lockstep", || {
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
        Ok(())
    });
}
