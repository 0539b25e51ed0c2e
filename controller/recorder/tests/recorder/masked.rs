//! A recording carries all of its scene.

use messages::{CycleRecord, Order};
use recorder::{Films, Recorder};
use recording::Recording;
use scene::SceneFiles;
use testkit::Place;

use crate::fixture::FILE;

#[test]
fn a_masked_scene_is_whole_in_the_recording() {
    let place = Place::new();
    let ring = place.path("ring.png");
    let is_white = |u: u32, v: u32| {
        let square = u.abs_diff(300).pow(2) + v.abs_diff(700).pow(2);
        (120 * 120..200 * 200).contains(&square)
    };
    scene::write_mask(&ring, 1024, 1024, is_white).unwrap();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let text = format!("{head}[[occlusion]]\nname = \"ring\"\nmask = \"ring.png\"\n");
    let path = place.path("scene.toml");
    std::fs::write(&path, &text).unwrap();
    let files = SceneFiles::read(&path).unwrap();
    // What is painted after the start is not what was recorded.
    std::fs::remove_file(&ring).unwrap();
    std::fs::remove_file(&path).unwrap();

    let mut file = Recorder::create(&place.path(FILE), false).unwrap();
    file.describe(&files).unwrap();
    for i in 0..40 {
        let mut cycle = CycleRecord {
            cycle: i + 1,
            features_sequence: i + 1,
            count: 4,
            ..CycleRecord::default()
        };
        cycle.stamp.data_ns = i * 33_333_333;
        for (place, corner) in [300.0, 300.0, 700.0, 300.0, 700.0, 700.0, 300.0, 700.0]
            .into_iter()
            .enumerate()
        {
            cycle.points[place] = corner + 5.0 * i as f64;
        }
        file.take(&cycle, Order::Next).unwrap();
    }
    file.finish().unwrap();

    let recording = Recording::read(&place.path(FILE)).unwrap();
    let scene = recording.scene().unwrap().unwrap();
    assert_eq!(recording.scene_toml(), Some(&*text));
    assert_eq!(scene.fingerprint(), files.scene.fingerprint());
    assert!(scene.masks().next().unwrap().is_forbidden(140, 700));
    let plots = place.path("plots");
    let drawn = recorder::plot(&recording, None, &plots, Films::Unwanted).unwrap();
    let svg = std::fs::read_to_string(plots.join("run.svg")).unwrap();
    assert!(drawn.contains(&plots.join("run.png")), "{drawn:?}");
    assert!(svg.contains("crispEdges"), "the mask is not in run.svg");
}
