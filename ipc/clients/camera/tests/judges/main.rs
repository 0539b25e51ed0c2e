//! OpenCV judges how lenses distort, on calibrations that it wrote itself.

use std::collections::BTreeMap;

use serde::Deserialize;
use testkit::python::{Environment, run, script};
use vpc_camera::lens;

/// How far a pixel may be from OpenCV's, px.
const BAR: f64 = 1e-4;

#[derive(Deserialize)]
struct Judgement {
    pixels: Vec<[f64; 2]>,
    /// Of the pixels, on the plane at z = 1.
    points: Vec<[f64; 2]>,
    /// The points seen again, px.
    projected: Vec<[f64; 2]>,
    /// Of the pixels, in the scene's camera, px.
    scene: Vec<[f64; 2]>,
    /// Pixels for which OpenCV found no inverse.
    unsound: usize,
}

fn far(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[test]
fn pixels_are_where_opencv_has_them() {
    let Some(python) = Environment::JUDGES.python("the lens beside OpenCV") else {
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    let program = testkit::root().join("ipc/clients/camera/tests/judges/lens.py");
    let said = run(script(&python, &program).arg(directory.path())).unwrap();
    let judged: BTreeMap<String, Judgement> = serde_json::from_str(&said).unwrap();
    assert_eq!(judged.len(), 5);
    let scene = scene::Camera {
        width: 640.0,
        height: 480.0,
        fx: 800.0,
        fy: 790.0,
        cx: 320.0,
        cy: 240.0,
        rate_hz: 30.0,
    };
    for (name, judgement) in judged {
        let path = directory.path().join(format!("{name}.yaml"));
        let lens = lens::read(&path).unwrap();
        let mut worst = [0.0_f64; 2];
        for (index, &pixel) in judgement.pixels.iter().enumerate() {
            let there = lens.undistort(pixel, &scene).unwrap();
            worst[0] = worst[0].max(far(there, judgement.scene[index]));
            let seen = lens.project(judgement.points[index]).unwrap();
            worst[1] = worst[1].max(far(seen, judgement.projected[index]));
        }
        let (pixels, unsound) = (judgement.pixels.len(), judgement.unsound);
        let [back, forth] = worst;
        println!("{name}: {pixels} pixels ({unsound} left out), {back:.1e} px, {forth:.1e} px");
        assert!(
            pixels > 20 * unsound && worst < [BAR; 2],
            "{name}: {worst:?}"
        );
    }
}
