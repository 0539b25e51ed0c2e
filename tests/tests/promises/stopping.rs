//! The stopping time and distance of the whole chain, as ISO 13855 wants them: from the instant at
//! which somebody asks to the arm at rest, by what the robot itself reports. The shell, `vpcd`, the
//! bridge and the robot's controller are in it; a person's reaction is not.

use std::time::Duration;

use ipc::{OperatorPorts, now_ns};
use messages::{Action, Request, RobotState};
use rustix::process::Signal;

use crate::bridge::{Cell, FR3, Model, PANDA, is_possible};
use crate::fixture::{PATIENCE, WAKE_NS, repeats, tell, turn};
use crate::stall::{fairly, in_time};

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
    cell.set_in_motion();
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
    let rest_ns = rest.stamp.data_ns.max(asked_ns);
    Ok(Stopped {
        took_ns: in_time("the arm rests", asked_ns, rest_ns, RESTS_NS + WAKE_NS)?,
        speed: before.map_or([0.0; 2], speed),
        way,
    })
}

#[test]
fn the_chain_stops_within_its_time_and_distance() {
    let _turn = turn();
    if !is_possible("stops of the whole chain") {
        return;
    }
    let count = repeats("stops of the whole chain, of each kind", 1, 20);
    for model in [PANDA, FR3] {
        for way in [Way::Stop, Way::Disarm, Way::Terminate, Way::Kill] {
            let (mut took_ns, mut speed, mut path) = (0, [0.0_f64; 2], [0.0_f64; 2]);
            for _ in 0..count {
                let stopped = fairly("a stop of the whole chain", || stop(model, way));
                took_ns = took_ns.max(stopped.took_ns);
                for k in 0..2 {
                    speed[k] = speed[k].max(stopped.speed[k]);
                    path[k] = path[k].max(stopped.way[k]);
                }
            }
            tell(format!(
                "{}, {way:?}: at rest after {} ms at most, from up to {:.3} m/s and {:.3} rad/s; {:.1} mm and {:.2} degrees",
                model.0,
                took_ns / 1_000_000,
                speed[0],
                speed[1],
                path[0] * 1e3,
                path[1].to_degrees()
            ));
        }
    }
}
