//! A camera that delivers late, in lockstep, against a law that sees the present.

use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain};
use messages::{Features, Stamp};
use scene::Scene;
use vpc::{Law, Measurement, Settings, Strategy};

use crate::fixture::{Place, Running, scene_file, vpcd_in};

/// Frames of delay.
const DELAY: u64 = 4;
/// Frames exposed.
const FRAMES: u64 = 60;

/// Steers the emulator's camera by a daemon that sees it late; for each answer, its largest
/// distance (m/s, rad/s) from that of the law to the true features of now.
fn distances(config: &str) -> Vec<f64> {
    let place = Place::new();
    let scene = Scene::read(&scene_file()).unwrap();
    let start = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap()[0];
    let domain = Domain::join(&place.domain()).unwrap();
    let mut ports = CameraPorts::open(&domain).unwrap();
    let config = format!("[law]\nstrategy = \"previous\"\n{config}");
    let config = place.file("vpcd.toml", &config);
    let mut command = vpcd_in(&place);
    command.arg("--config").arg(config);
    command.args(["--clock", "lockstep"]);
    command.args(["--cycles", &(FRAMES - DELAY).to_string()]);
    let daemon = Running::start(command);

    let mut camera = FreeCamera::new(&scene, &start);
    // Foresight keeps farther from borders the later the features are.
    let settings = Settings {
        strategy: Strategy::Previous,
        ..Settings::default()
    };
    let mut present = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    let begin_ns = ipc::now_ns();
    let time_ns = |k: u64| begin_ns + (k as f64 * 1e9 * scene.sampling_time()).round() as u64;
    let mut under_way = Vec::new();
    let mut distances = Vec::new();
    for k in 0..FRAMES {
        let now = camera.features().unwrap();
        under_way.push(now.clone());
        let mut twist = [0.0; 6];
        if let Some(exposed) = k.checked_sub(DELAY) {
            let mut features = Features::new(&under_way[exposed as usize], time_ns(exposed));
            features.stamp = Stamp {
                sequence: exposed + 1,
                published_ns: time_ns(k),
                data_ns: time_ns(exposed),
            };
            let sent = ports.features.publish_verbatim(&features).unwrap();
            let answer = ports.wait_for_answer(&sent, testkit::PATIENCE).unwrap();
            twist = answer.expect("an answer in time").twist;
            let expected = present.step(&Measurement::from_points(&now), None).unwrap();
            let apart = twist.iter().zip(expected.twist).map(|(a, b)| (a - b).abs());
            distances.push(apart.fold(0.0, f64::max));
            present.sent(&twist, time_ns(k));
        }
        camera.advance(&twist, scene.sampling_time());
    }
    let (code, log) = daemon.ended().log();
    assert_eq!(code, 0, "{log}");
    distances
}

#[test]
fn late_features_are_answered_as_those_of_now_would_be() {
    let worst = distances("").into_iter().fold(0.0, f64::max);
    assert!(worst < 1e-5, "{worst}");
    // The mechanism does it: without, the twists differ as soon as the camera moves.
    let uncompensated = distances("delay_compensation = false");
    assert!(uncompensated[0] < 1e-5, "{uncompensated:?}");
    assert!(uncompensated[3] > 1e-2, "{uncompensated:?}");
}
