//! A free-flying camera that closes the loop in lockstep: publishes features and moves by the
//! twists that come back.
//!
//! ```sh
//! vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep &
//! cargo run --release -p ipc --example camera [DOMAIN]
//! ```
//!
//! The scene is that of paper-sim.toml, written out below.

use std::path::PathBuf;
use std::time::Duration;

use ipc::{CameraPorts, Domain};
use messages::Features;

const FOCAL_PX: f64 = 800.0;
const CENTRE_PX: f64 = 512.0;
const PERIOD_S: f64 = 1.0 / 30.0;
const CONVERGENCE_PX: f64 = 2.0;
/// Half the side of the square whose corners are the pattern, m.
const HALF: f64 = 0.15;
const CORNERS: [[f64; 2]; 4] = [[-HALF, -HALF], [HALF, -HALF], [HALF, HALF], [-HALF, HALF]];
/// Position of the object in the camera frame at the start and at the goal, m.
const START: [f64; 3] = [0.2, 0.0, 0.7];
const GOAL: [f64; 3] = [0.0, 0.0, 0.6];
/// Longest run.
const PERIODS: u32 = 450;

/// The corners in the frame of a camera that sees the object straight ahead, at this position.
fn placed(position: [f64; 3]) -> [[f64; 3]; 4] {
    CORNERS.map(|[x, y]| [x + position[0], y + position[1], position[2]])
}

fn projected(points: &[[f64; 3]; 4]) -> [[f64; 2]; 4] {
    points.map(|[x, y, z]| [x, y].map(|a| CENTRE_PX + FOCAL_PX * a / z))
}

/// Moves the camera by a twist in its own frame for one period: points go the other way, -v - w x
/// p, in small steps.
fn moved(points: &mut [[f64; 3]; 4], [vx, vy, vz, wx, wy, wz]: [f64; 6]) {
    const STEPS: u32 = 1000;
    let step_s = PERIOD_S / f64::from(STEPS);
    for _ in 0..STEPS {
        for [x, y, z] in &mut *points {
            let velocity = [
                vx + wy * *z - wz * *y,
                vy + wz * *x - wx * *z,
                vz + wx * *y - wy * *x,
            ];
            (*x, *y, *z) = (
                *x - step_s * velocity[0],
                *y - step_s * velocity[1],
                *z - step_s * velocity[2],
            );
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = std::env::args_os().nth(1);
    let directory = directory.map_or_else(ipc::default_directory, PathBuf::from);
    let domain = Domain::join(&directory)?;
    let mut camera = CameraPorts::open(&domain)?;
    let goal = projected(&placed(GOAL));
    let mut points = placed(START);
    // Simulated time: one period from frame to frame.
    let mut time_ns = ipc::now_ns();
    for period in 0..PERIODS {
        let pixels = projected(&points);
        let pairs = pixels.iter().flatten().zip(goal.iter().flatten());
        let error_px = pairs.fold(0.0, |worst, (s, goal)| f64::max(worst, (s - goal).abs()));
        if error_px <= CONVERGENCE_PX {
            println!("at the goal after {period} periods, error {error_px:.3} px");
            return Ok(());
        }
        let mut features = Features::new(&pixels, time_ns);
        features.stamp.sequence = u64::from(period) + 1;
        features.stamp.published_ns = time_ns;
        let sent = camera.features.publish_verbatim(&features)?;
        let answer = camera.wait_for_answer(&sent, Duration::from_secs(10))?;
        let answer =
            answer.ok_or("no answer; does vpcd run in this domain, with --clock lockstep?")?;
        moved(&mut points, answer.twist);
        time_ns += (1e9 * PERIOD_S) as u64;
    }
    Err(format!("not at the goal after {PERIODS} periods").into())
}
