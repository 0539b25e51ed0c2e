//! From an image of 640 x 480 px to features. `cargo bench -p vpc-camera`

use markers::Family;
use scene::Scene;
use vision::{Look, Renderer};
use vpc_camera::config::Targets;
use vpc_camera::finder::Finder;
use vpc_camera::grey::Grey;
use vpc_camera::lens::Lens;

fn main() {
    // One thread, as in the program.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread();
    let _pool = pool.build();
    divan::main();
}

/// The goal of the scene with tags, with its occlusions.
fn image() -> (Scene, vision::Image) {
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags").expect("the scene is valid");
    let mut renderer = Renderer::new(&scene, &Look::default());
    let image = renderer.render(&scene.goal).clone();
    (scene, image)
}

fn bench(bencher: divan::Bencher, is_followed: bool) {
    let (scene, image) = image();
    let grey = Grey::new(image.pixels(), 640, 480, 640).expect("an image");
    let targets = Targets::Centres(vec![0, 1, 2, 3]);
    let lens = Lens::pinhole(&scene.camera);
    let new = || Finder::new(&scene, &lens, Family::default(), &targets).expect("a finder");
    let mut followed = new();
    let mut sequence = 0;
    let mut look = |finder: &mut Finder| {
        sequence += 1;
        let found = finder.find(&grey, sequence).expect("features");
        assert_eq!(
            (found.visible, found.is_whole),
            (0b1111, !is_followed || sequence == 1)
        );
    };
    if is_followed {
        look(&mut followed);
        bencher.bench_local(|| look(&mut followed));
    } else {
        bencher.with_inputs(new).bench_local_refs(look);
    }
}

/// All of the image, as when tags are lost.
#[divan::bench(sample_count = 500, sample_size = 1)]
fn everywhere(bencher: divan::Bencher) {
    bench(bencher, false);
}

/// Windows about four tags, as while they are followed.
#[divan::bench(sample_count = 500, sample_size = 1)]
fn in_windows(bencher: divan::Bencher) {
    bench(bencher, true);
}
