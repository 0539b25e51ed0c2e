//! Times of drawing a frame. `cargo bench -p vision`

use scene::Scene;
use vision::{Look, Renderer};

fn main() {
    divan::main();
}

/// Draws the goal, moved aside by so many metres during the exposure.
fn frames(bencher: divan::Bencher, look: Look, way: f64) {
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags-robot.toml").expect("the scene is valid");
    let mut renderer = Renderer::new(&scene, &look);
    let mut ends = [scene.goal; 2];
    ends[1].translation[0] += way;
    bencher.bench_local(|| renderer.render_moving(&[scene.goal; 2], &ends).at(320, 240));
}

#[divan::bench]
fn plain(bencher: divan::Bencher) {
    frames(bencher, Look::default(), 0.0);
}

/// By 4 px.
#[divan::bench]
fn blurred_by_motion(bencher: divan::Bencher) {
    frames(bencher, Look::default(), 0.0023);
}

#[divan::bench]
fn distorted(bencher: divan::Bencher) {
    let distortion = [-0.25, 0.08, 0.001, -0.001, 0.0];
    let look = Look {
        distortion,
        ..Look::default()
    };
    frames(bencher, look, 0.0);
}

#[divan::bench]
fn with_all_flaws(bencher: divan::Bencher) {
    let look = Look {
        distortion: [-0.25, 0.08, 0.001, -0.001, 0.0],
        defocus_px: 0.8,
        gain: 0.4,
        clutter: 6,
        ..Look::default()
    };
    frames(bencher, look, 0.0023);
}
