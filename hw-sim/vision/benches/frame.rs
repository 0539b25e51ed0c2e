//! Times of a frame: drawing, following, searching the whole frame. `cargo bench -p vision`

use scene::Scene;
use vision::{Detector, DetectorSettings, Look, Renderer};

fn main() {
    divan::main();
}

fn robot() -> (Scene, Renderer, Detector) {
    let scene = Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml").expect("the scene is valid");
    let renderer = Renderer::new(&scene, &Look::default());
    let detector = Detector::new(&scene, &DetectorSettings::default());
    (scene, renderer, detector)
}

#[divan::bench]
fn render(bencher: divan::Bencher) {
    let (scene, mut renderer, _) = robot();
    bencher.bench_local(|| renderer.render(&scene.goal).at(320, 240));
}

#[divan::bench]
fn detect_followed(bencher: divan::Bencher) {
    let (scene, mut renderer, mut detector) = robot();
    let image = renderer.render(&scene.goal).clone();
    bencher.bench_local(|| detector.detect(&image).map(|found| found.len()));
    assert_eq!(detector.visible(), 0b1111);
}

/// Two of four behind the object: the search for them is in vain in every frame.
#[divan::bench]
fn detect_half_hidden(bencher: divan::Bencher) {
    let (scene, mut renderer, mut detector) = robot();
    let mut pose = scene.goal;
    pose.translation[1] += 0.02;
    let _ = detector.detect(renderer.render(&pose));
    for _ in 0..15 {
        pose.translation[1] += 0.0034;
        let _ = detector.detect(renderer.render(&pose));
    }
    assert_eq!(detector.visible(), 0b0011);
    let image = renderer.image().clone();
    bencher.bench_local(|| detector.detect(&image).map(|found| found.len()));
}

#[divan::bench]
fn detect_whole_frame(bencher: divan::Bencher) {
    let (scene, mut renderer, mut detector) = robot();
    let image = renderer.render(&scene.goal).clone();
    bencher.bench_local(|| {
        detector.expect(&scene.goal);
        detector.detect(&image).map(|found| found.len())
    });
    assert_eq!(detector.visible(), 0b1111);
}
