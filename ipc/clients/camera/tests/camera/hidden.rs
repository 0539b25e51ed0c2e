//! Tags that pass behind the spot on the lens and the grasped object.

use markers::Family;
use scene::{Pose, Scene};
use testkit::repeats;
use vision::{Look, Renderer};
use vpc_camera::config::Targets;
use vpc_camera::finder::Finder;
use vpc_camera::lens::Lens;

use crate::drawing::{Errors, grey, project, truth};

/// How deep the tag is in an occlusion, with its white border: the share of it that is covered.
fn covered(scene: &Scene, pose: &Pose, index: usize) -> f64 {
    let [x, y, _] = scene.pattern[index];
    let half = 0.5 * scene.marker_size;
    let places = (0..441).map(|k| [(k % 21) as f64 / 10.0 - 1.0, (k / 21) as f64 / 10.0 - 1.0]);
    let is_covered = |[a, b]: [f64; 2]| {
        let [u, v] = project(&scene.camera, pose, [x + half * a, y + half * b]);
        let mut parts = scene.parts();
        let outside = !(0.0..=639.0).contains(&u) || !(0.0..=479.0).contains(&v);
        outside
            || parts.any(|part| {
                let term =
                    |k: usize, x: f64| ((x - part.center[k]).abs() / part.half[k]).powf(part.p);
                term(0, u) + term(1, v) < 1.0
            })
    };
    places.filter(|p| is_covered(*p)).count() as f64 / 441.0
}

#[test]
fn what_is_seen_is_exact_and_what_is_hidden_is_guessed() {
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
    let lens = Lens::pinhole(&scene.camera);
    let targets = Targets::Centres(vec![0, 1, 2, 3]);
    let mut renderer = Renderer::new(&scene, &Look::default());
    let (mut seen, mut guessed) = (Errors::default(), Errors::default());
    let (mut free, mut missed, mut hidden, mut leaked) = (0_usize, 0, 0_usize, 0);
    let passes = repeats("passes", 2, 6);
    for pass in (0..6).step_by(6 / passes) {
        let mut finder = Finder::new(&scene, &lens, Family::default(), &targets).unwrap();
        for n in 0..150 {
            // Across the image, each pass another way.
            let (t, side) = (f64::from(n) / 149.0, pass as f64 - 2.5);
            let pose = Pose {
                translation: [
                    0.2 * (t - 0.5),
                    0.02 * side + 0.06 * (t - 0.5) * side,
                    0.36 + 0.02 * side,
                ],
                rotation: [0.05 * side, 0.1 * (t - 0.5), 0.2 * side],
            };
            let image = renderer.render(&pose).clone();
            let found = finder.find(&grey(&image), n as u64 + 1).unwrap();
            for (i, (point, truth)) in found.points.iter().zip(truth(&scene, &pose)).enumerate() {
                let is_seen = found.visible >> i & 1 == 1;
                let share = covered(&scene, &pose, i);
                if is_seen {
                    seen.add(*point, truth);
                } else if found.visible.count_ones() > 0 && n > 0 {
                    guessed.add(*point, truth);
                }
                free += usize::from(share == 0.0);
                missed += usize::from(share == 0.0 && !is_seen);
                hidden += usize::from(share > 0.1);
                leaked += usize::from(share > 0.1 && is_seen);
            }
        }
    }
    println!(
        "seen: {:.3} px RMS, {:.3} at most; guessed: {:.2} px RMS, {:.2} at most; {missed} of {free} free tags missed, \
         {leaked} of {hidden} tags seen of which a tenth or more is covered",
        seen.rms(),
        seen.worst,
        guessed.rms(),
        guessed.worst
    );
    assert!(seen.rms() < 0.1 && seen.worst < 0.5, "{seen:?}");
    assert!(guessed.worst < 5.0, "{guessed:?}");
    assert!(guessed.count > 8.0 * passes as f64, "{guessed:?}");
    assert!(hidden > 30 * passes && leaked == 0, "{leaked} of {hidden}");
    assert!(
        free > 150 * passes && missed <= free / 50,
        "{missed} of {free}"
    );
}
