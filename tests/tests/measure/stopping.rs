//! The stopping time and distance of the whole chain, as ISO 13855 wants them: from the instant at
//! which somebody asks to the arm at rest, by what the robot itself reports. The shell, `vpcd`, the
//! bridge and the robot's controller are in it; a person's reaction is not.

use std::time::Duration;

use ipc::{OperatorPorts, now_ns};
use messages::{Action, Request, RobotState};
use rustix::process::Signal;

use crate::bridge::{Cell, FR3, Model, PANDA, is_possible};
use crate::fixture::{PATIENCE, WAKE_NS};
use crate::judge::{Miss, in_time};
use crate::reference::Class;
use crate::sheet::Sheet;

/// How it is stopped.
#[derive(Clone, Copy, Debug)]
enum Way {
    Stop,
    Disarm,
    Terminate,
    Kill,
}

/// From the asking to the arm at rest, ns, at most: a period until it is noticed, two that the
/// bridge's dead man may wait, the braking time, and what the robot's own filter takes.
const RESTS_NS: u64 = 300_000_000;
/// Speed below which the arm is at rest, m/s and rad/s.
const AT_REST: f64 = 1e-3;
const LOOKS: Duration = Duration::from_millis(800);

/// A stop: how long it took, ns, how fast the camera was, m/s and rad/s, and how far it went, m and
/// rad.
struct Stopped {
    took_ns: u64,
    speed: [f64; 2],
    way: [f64; 2],
}

fn speed(state: &RobotState) -> [f64; 2] {
    let [x, y, z, a, b, c] = state.twist;
    [[x, y, z], [a, b, c]].map(|v| v.iter().map(|x| x * x).sum::<f64>().sqrt())
}

fn stop(model: Model, way: Way) -> anyhow::Result<Stopped> {
    let mut cell = Cell::with(model, &[]);
    cell.set_in_motion()?;
    let mut states = Vec::new();
    while let Some(state) = cell.observer.robot.oldest().unwrap() {
        states.push(state.message);
    }
    let asked_ns = now_ns();
    match way {
        Way::Stop => _ = ipc::stop(&cell.place.domain(), PATIENCE)?,
        Way::Disarm => {
            let domain = ipc::Domain::join(&cell.place.domain())?;
            let mut operator = OperatorPorts::open(&domain)?;
            // Joining takes longer than stopping.
            let asked_ns = now_ns();
            operator.ask(&Request::new(1, Action::Disarm), PATIENCE)?;
            return rests(&mut cell, states, asked_ns);
        }
        Way::Terminate => cell.daemon.signal(Signal::TERM),
        Way::Kill => cell.daemon.signal(Signal::KILL),
    }
    rests(&mut cell, states, asked_ns)
}

fn rests(cell: &mut Cell, mut states: Vec<RobotState>, asked_ns: u64) -> anyhow::Result<Stopped> {
    let begin = std::time::Instant::now();
    while begin.elapsed() < LOOKS {
        while let Some(state) = cell.observer.robot.oldest().unwrap() {
            states.push(state.message);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let before = states.iter().rfind(|state| state.stamp.data_ns <= asked_ns);
    let moved = states.iter().rposition(|state| {
        let [v, w] = speed(state);
        v > AT_REST || w > AT_REST
    });
    let rest = states[moved.map_or(0, |k| k + 1).min(states.len() - 1)];
    let since = states
        .windows(2)
        .filter(|pair| pair[1].stamp.data_ns > asked_ns);
    let mut way = [0.0; 2];
    for pair in since {
        let from_ns = pair[0].stamp.data_ns.max(asked_ns);
        let seconds = (pair[1].stamp.data_ns - from_ns) as f64 / 1e9;
        for k in 0..2 {
            way[k] += seconds * (speed(&pair[0])[k] + speed(&pair[1])[k]) / 2.0;
        }
    }
    let speed = before.map_or([0.0; 2], speed);
    if speed.iter().all(|speed| *speed <= AT_REST) {
        let what = format!("it stood when it was asked: {}", cell.place.state());
        let from_ns = states.first().map_or(asked_ns, |state| state.stamp.data_ns);
        return Err(Miss::upset(what, Class::Ordinary, from_ns.min(asked_ns), asked_ns).into());
    }
    let rest_ns = rest.stamp.data_ns.max(asked_ns);
    Ok(Stopped {
        took_ns: in_time(
            "the arm rests",
            Class::Ordinary,
            asked_ns,
            rest_ns,
            RESTS_NS + WAKE_NS,
        )?,
        speed,
        way,
    })
}

/// A robot, and how it is stopped.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub name: &'static str,
    model: Model,
    way: Way,
}

/// All of them.
pub const CASES: [Case; 8] = [
    case("stopping panda, stop", PANDA, Way::Stop),
    case("stopping panda, disarm", PANDA, Way::Disarm),
    case("stopping panda, terminate", PANDA, Way::Terminate),
    case("stopping panda, kill", PANDA, Way::Kill),
    case("stopping fr3, stop", FR3, Way::Stop),
    case("stopping fr3, disarm", FR3, Way::Disarm),
    case("stopping fr3, terminate", FR3, Way::Terminate),
    case("stopping fr3, kill", FR3, Way::Kill),
];

const fn case(name: &'static str, model: Model, way: Way) -> Case {
    Case { name, model, way }
}

/// Measures this case.
pub fn measure(case: Case, sheet: &mut Sheet) {
    if !is_possible(sheet) {
        return;
    }
    let (mut speed, mut path) = ([0.0_f64; 2], [0.0_f64; 2]);
    let mut count = 0;
    for round in 0..sheet.repeats(1, 20) {
        let what = format!("stop {round}");
        let stopped = sheet.round(&[Class::Ordinary], &what, || stop(case.model, case.way));
        if let Some(stopped) = stopped {
            sheet.longest("at rest after", stopped.took_ns, RESTS_NS + WAKE_NS);
            count += 1;
            for k in 0..2 {
                speed[k] = speed[k].max(stopped.speed[k]);
                path[k] = path[k].max(stopped.way[k]);
            }
        }
    }
    if count == 0 {
        return;
    }
    sheet.figure("stops", f64::from(count), "");
    sheet.figure("from", speed[0], "m/s");
    sheet.figure("and", speed[1], "rad/s");
    sheet.figure("went on by", path[0] * 1e3, "mm");
    sheet.figure("and turned by", path[1].to_degrees(), "degrees");
}
