//! The README's figures: the cost of a millisecond, and how near the shaper comes to the joints'
//! bounds.
//!
//! `cargo run --release -p panda --example figures`

use std::time::Instant;

use arm::{Echo, Ramp, Shaper, ShaperSettings};
use nalgebra::{Rotation3, Translation3, Vector3};
use panda::limits::{Model, PERIOD};
use panda::{
    Chain, Command, Joints, Mode, Motion, MotionKind, PlacementError, Pose, READY, Robot,
    RobotSettings, State, Twist, place,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    cost()?;
    margins()
}

/// A command to the robot's present state.
fn answer(robot: &Robot, twist: Twist) -> Command {
    Command {
        id: robot.state().id,
        motion: Motion::Cartesian(twist),
        elbow: None,
        finished: false,
    }
}

/// The last command by the robot's account.
fn echo(state: &State) -> Echo {
    Echo {
        twist: state.o_dp_ee_c,
        acceleration: state.o_ddp_ee_c,
    }
}

fn cost() -> Result<(), Box<dyn std::error::Error>> {
    let mut robot = Robot::new(RobotSettings::default(), Joints::from(READY))?;
    let mut shaper = Shaper::new(ShaperSettings::default())?;
    robot.start(MotionKind::Cartesian)?;
    let mut batches = Vec::new();
    for batch in 0..2000 {
        let sign = if batch % 2 == 0 { 1.0 } else { -1.0 };
        shaper.aim(&(Twist::repeat(0.01) * sign), u64::MAX);
        let begin = Instant::now();
        for _ in 0..100 {
            let twist = shaper.step(&echo(robot.state()), 0);
            let command = answer(&robot, twist);
            robot.step(&[command]);
        }
        batches.push(begin.elapsed().as_secs_f64() / 100.0);
    }
    if robot.state().robot_mode != Mode::Move {
        return Err(format!("the robot tripped: {}", robot.state().current_errors).into());
    }
    batches.sort_by(f64::total_cmp);
    let at = |share: f64| batches[(share * (batches.len() - 1) as f64) as usize] * 1e6;
    println!(
        "shaper and robot, one millisecond: median {:.2} us, p99 {:.2} us (over batches of 100)",
        at(0.5),
        at(0.99)
    );
    Ok(())
}

/// The greatest share of a joint's acceleration and jerk over the hardest 30 Hz commands that the
/// scene `paper-robot` allows, in random postures.
fn margins() -> Result<(), Box<dyn std::error::Error>> {
    let wild = ShaperSettings {
        linear: Ramp {
            acceleration: 1.2,
            jerk: 150.0,
        },
        angular: Ramp {
            acceleration: 2.4,
            jerk: 300.0,
        },
    };
    for (name, settings) in [
        ("default", ShaperSettings::default()),
        ("1.2 m/s^2 an axis", wild),
    ] {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut worst = Worst::default();
        for _ in 0..RUNS {
            run(settings, &mut worst, &mut random)?;
        }
        println!(
            "{name}: {} reflexes in {RUNS} runs of 10 s; a joint takes at most {:.0} % of its acceleration, {:.0} % of \
             its jerk",
            worst.reflexes,
            100.0 * worst.acceleration,
            100.0 * worst.jerk
        );
    }
    Ok(())
}

const RUNS: usize = 100;

/// Shares of the joints' bounds.
#[derive(Default)]
struct Worst {
    reflexes: usize,
    acceleration: f64,
    jerk: f64,
}

/// Ten seconds in which every axis jumps between the scene's limits, 0.01 m/s and 0.03 rad/s.
fn run(
    settings: ShaperSettings,
    worst: &mut Worst,
    random: &mut ChaCha8Rng,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut robot = Robot::new(RobotSettings::default(), somewhere(random)?)?;
    robot.start(MotionKind::Cartesian)?;
    let mut shaper = Shaper::new(settings)?;
    for tick in 0..10_000 {
        if tick % 33 == 0 {
            let twist = Twist::from_fn(|axis, _| {
                let limit = if axis < 3 { 0.01 } else { 0.03 };
                limit * if random.random_bool(0.5) { 1.0 } else { -1.0 }
            });
            shaper.aim(&twist, u64::MAX);
        }
        let before = robot.state().ddq_d;
        let twist = shaper.step(&echo(robot.state()), 0);
        let state = *robot.step(&[answer(&robot, twist)]);
        if state.robot_mode != Mode::Move {
            worst.reflexes += 1;
            break;
        }
        for (k, bound) in Model::Panda.limits().joints.iter().enumerate() {
            let jerk = (state.ddq_d[k] - before[k]).abs() / PERIOD;
            worst.jerk = worst.jerk.max(jerk / bound.jerk);
            let acceleration = state.ddq_d[k].abs();
            worst.acceleration = worst.acceleration.max(acceleration / bound.acceleration);
        }
    }
    Ok(())
}

/// Joints with a flange that looks down on a table in front of the robot.
fn somewhere(random: &mut ChaCha8Rng) -> Result<Joints, PlacementError> {
    let mut draw = |most: f64| random.random_range(-most..most);
    let down = Rotation3::new(Vector3::x() * std::f64::consts::PI);
    let turn = Rotation3::new(Vector3::new(draw(0.3), draw(0.3), draw(0.8)));
    let at = Translation3::new(0.45 + draw(0.15), draw(0.25), 0.45 + draw(0.15));
    place(
        &Chain::default(),
        Model::Panda.limits(),
        &Pose::from_parts(at, down * turn),
    )
}
