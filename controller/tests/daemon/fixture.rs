//! What the tests share: a domain, a memory, random features, the daemon's process.

use std::path::Path;
use std::process::{Command, Stdio};

use memory_blob::{Contents, Regression};
use rand::{Rng, RngExt};
use scene::Scene;
use serde_json::Map;
pub use testkit::{Place, Running, eventually, not_run, scene_file};

/// A square pattern somewhere in the image, in any orientation.
pub fn square(scene: &Scene, random: &mut impl Rng) -> Vec<[f64; 2]> {
    let size = random.random_range(20.0..120.0);
    let angle = random.random_range(0.0..std::f64::consts::TAU);
    let reach = size * std::f64::consts::SQRT_2;
    let cu = random.random_range(reach..scene.camera.width - reach);
    let cv = random.random_range(reach..scene.camera.height - reach);
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
        .map(|[x, y]: [f64; 2]| {
            let (sin, cos) = angle.sin_cos();
            [
                cu + size * (cos * x - sin * y),
                cv + size * (sin * x + cos * y),
            ]
        })
        .to_vec()
}

/// Writes a memory for this scene: 300 random samples and a regression over 100 of them. It steers
/// nowhere sensible, but it is asked as a real one is.
pub fn write_memory(scene: &Scene, path: &Path, random: &mut impl Rng) {
    let points = scene.pattern.len();
    let (inputs, outputs) = (2 * points + 2, 6 + 2 * points);
    let row = |random: &mut _| -> Vec<f64> {
        let square = square(scene, random);
        square.into_iter().flatten().chain([5e3, 0.1]).collect()
    };
    let answer = |random: &mut _| -> Vec<f64> {
        let way_point = square(scene, random).into_iter().flatten();
        [0.05, 0.0, 0.0, 0.0, 0.0, 0.1]
            .into_iter()
            .chain(way_point)
            .collect()
    };
    let x: Vec<Vec<f64>> = (0..300).map(|_| row(random)).collect();
    let y: Vec<Vec<f64>> = (0..300).map(|_| answer(random)).collect();
    let regression = Regression {
        x: x[..100].to_vec(),
        length_scale: vec![1.0; inputs],
        signal_variance: 1.0,
        noise_variance: 1e-3,
        mean: answer(random),
        lambda: vec![vec![1e-3; outputs]; 100],
        output_scale: vec![1.0; outputs],
        cholesky: None,
    };
    let contents = Contents {
        task: *scene.fingerprint().bytes(),
        offset: vec![0.0; inputs],
        scale: (0..inputs)
            .map(|i| if i == 2 * points { 1e4 } else { 100.0 })
            .collect(),
        trajectory: vec![0; x.len()],
        step: (0..x.len() as u32).collect(),
        cost_to_go: vec![0.0; x.len()],
        x,
        y,
        regression: Some(regression),
        provenance: Map::new(),
    };
    contents.write(path).unwrap();
}

/// The daemon's command.
pub fn vpcd() -> Command {
    testkit::command(env!("CARGO_BIN_EXE_vpcd"))
}

/// The daemon in a domain, with the paper's scene, armed.
pub fn vpcd_in(place: &Place) -> Command {
    let mut command = vpcd();
    command
        .arg("--scene")
        .arg(scene_file())
        .arg("--domain")
        .arg(place.domain())
        .arg("--arm");
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// Runs a command to its end: exit code and standard error.
pub fn ended(command: Command) -> (i32, String) {
    testkit::ended(command).log()
}
