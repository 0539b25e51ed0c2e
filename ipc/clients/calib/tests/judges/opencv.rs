//! OpenCV judges: the same corners and poses, calibrated by it and by us.

use std::collections::BTreeMap;

use serde::Deserialize;
use tag_board::Board;
use testkit::python::{Environment, run, script};
use vision_calibration_core::{Iso3, Vec3};
use vpc_calib::hand_eye::{Mounting, Pair};
use vpc_calib::target::Target;
use vpc_calib::view::View;
use vpc_calib::{hand_eye, intrinsics};

use crate::station::{PANDA, mount, pairs};
use crate::synthetic::{CAMERA, Chance};

#[derive(Deserialize)]
struct Judgement {
    camera: [f64; 4],
    distortion: [f64; 5],
    rms: f64,
    mounts: BTreeMap<String, [f64; 6]>,
}

fn judged(python: &std::path::Path, pairs: &[Pair], target: &Target) -> Judgement {
    let places = |pair: &Pair| pair.view.pairs(target).collect::<Vec<_>>();
    let rows = |pair: &Pair| {
        let matrix = pair.flange.to_matrix();
        [0, 1, 2, 3].map(|row| [0, 1, 2, 3].map(|column| matrix[(row, column)]))
    };
    let given = serde_json::json!({
        "size": CAMERA.size,
        "views": pairs.iter().map(places).collect::<Vec<_>>(),
        "flanges": pairs.iter().map(rows).collect::<Vec<_>>(),
    });
    let place = testkit::Place::new();
    let file = place.file("given.json", given.to_string());
    let program = testkit::root().join("ipc/clients/calib/tests/judges/opencv.py");
    let said = run(script(python, &program).arg(file)).unwrap();
    serde_json::from_str(&said).unwrap()
}

#[test]
fn the_lens_is_opencvs_and_the_mounting_is_nearer_to_the_truth() {
    let Some(python) = Environment::JUDGES.python("calibrations beside OpenCV") else {
        return;
    };
    let target = Target::from(&Board::default());
    let off = |found: &Iso3| {
        let off = mount().inverse() * found;
        [
            1e3 * off.translation.vector.norm(),
            off.rotation.angle().to_degrees(),
        ]
    };
    let (mut ours, mut theirs) = ([0.0; 2], BTreeMap::new());
    let seeds = testkit::repeats("OpenCV", 3, 20);
    for seed in 0..seeds as u64 {
        let pairs = pairs(&mut Chance::new(seed), 14, 35.0, PANDA);
        let judgement = judged(&python, &pairs, &target);
        let views: Vec<View> = pairs.iter().map(|pair| pair.view.clone()).collect();
        let lens = intrinsics::calibrate(&views, &target, CAMERA.size, false).unwrap();
        let found = [lens.camera.focal, lens.camera.center].concat();
        // Both minimize the same errors; OpenCV takes corners as f32.
        for (found, judged) in found.iter().zip(judgement.camera) {
            assert!((found - judged).abs() < 0.02, "{found} {judged}");
        }
        for (found, judged) in lens.camera.distortion.iter().zip(judgement.distortion) {
            assert!((found - judged).abs() < 3e-4, "{found} {judged}");
        }
        assert!((lens.rms_px - judgement.rms).abs() < 1e-4);
        let found =
            hand_eye::calibrate(&pairs, Mounting::EyeInHand, &lens.camera, &target).unwrap();
        let add = |sum: &mut [f64; 2], off: [f64; 2]| {
            *sum = [0, 1].map(|k| sum[k] + off[k] * off[k] / seeds as f64);
        };
        add(&mut ours, off(&found.camera));
        for (name, [x, y, z, a, b, c]) in judgement.mounts {
            let mount = Iso3::new(Vec3::new(x, y, z), Vec3::new(a, b, c));
            add(theirs.entry(name).or_default(), off(&mount));
        }
    }
    let words = |[mm, deg]: [f64; 2]| format!("{:.3} mm, {:.4} deg", mm.sqrt(), deg.sqrt());
    testkit::tell(format_args!("hand-eye, RMS: ours {}", words(ours)));
    for (name, theirs) in theirs {
        testkit::tell(format_args!("OpenCV's {name} {}", words(theirs)));
        assert!(
            ours[0] <= 1.1 * theirs[0] && ours[1] <= 1.1 * theirs[1],
            "{name}"
        );
    }
}
