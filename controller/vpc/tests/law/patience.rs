//! Where no way is known and nothing improves the camera stands, and goes on when there is one.

use nalgebra::Vector3;
use scene::{Pose, Scene};
use vpc::motion::Motion;
use vpc::{Law, Measurement, Settings, Strategy, camera, task};

/// The paper's scene with a wall across the whole image instead of its occlusions.
fn walled() -> Scene {
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let wall = "[[occlusion]]\nname = \"wall\"\nparts = [{ center = [512.0, 180.0], half = [700.0, 20.0], p = 8.0 }]\n";
    Scene::parse(&format!("{head}{wall}"), "walled").unwrap()
}

#[test]
fn the_camera_stands_where_no_way_is_known_until_there_is_one() {
    let scene = walled();
    let settings = Settings {
        strategy: Strategy::Foresight,
        // So few that a test takes no time.
        foresight_steps: 20,
        ..Settings::default()
    };
    let mut law = Law::new(&scene, settings, |len| vec![0.0; len]).unwrap();
    // Small, and above the wall.
    let start = Pose {
        translation: [0.0, -1.2, 2.2],
        rotation: [0.0; 3],
    };
    let period = scene.sampling_time();
    let mut points: Vec<Vector3<f64>> = task::placed(&scene.pattern, &start).collect();
    let cycle = |law: &mut Law<Vec<f64>>, points: &mut Vec<Vector3<f64>>, k: u64| {
        let see = |x: &Vector3<f64>| camera::project(&scene.camera, (*x).into()).unwrap();
        let pixels: Vec<_> = points.iter().map(see).collect();
        let now_ns = (k as f64 * period * 1e9) as u64;
        let measured = Measurement::from_points(&pixels).taken(now_ns, now_ns);
        let step = law.step(&measured, None).unwrap();
        law.sent(&step.twist, now_ns);
        law.think(None);
        let motion = Motion::of_camera(&step.twist, period);
        points.iter_mut().for_each(|x| *x = motion.apply(x));
        step
    };
    let (mut stood, mut k) = (None, 0);
    // It goes on standing for two seconds.
    while k < stood.map_or(800, |stood| stood + 60) {
        let step = cycle(&mut law, &mut points, k);
        if step.stands {
            assert_eq!(step.twist, [0.0; 6]);
            stood.get_or_insert(k);
        } else {
            assert_eq!(stood, None, "cycle {k}");
        }
        k += 1;
    }
    // Not before five seconds of 30 Hz.
    assert!(stood.is_some_and(|k| (150..800).contains(&k)), "{stood:?}");
    // The pattern is put below the wall: there is a way.
    points = task::placed(
        &scene.pattern,
        &Pose {
            translation: [0.05, 0.05, 0.8],
            ..start
        },
    )
    .collect();
    law.lose_sight();
    law.skip_mismatch();
    let later = (k..k + 60).map(|k| cycle(&mut law, &mut points, k));
    let last = later.last().unwrap();
    assert!(!last.stands && last.error_px < 2.0, "{}", last.error_px);
}
