//! Time of drawing a frame. `cargo bench -p vision`

use scene::Scene;
use vision::{Look, Renderer};

fn main() {
    divan::main();
}

#[divan::bench]
fn render(bencher: divan::Bencher) {
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags-robot.toml").expect("the scene is valid");
    let mut renderer = Renderer::new(&scene, &Look::default());
    bencher.bench_local(|| renderer.render(&scene.goal).at(320, 240));
}
