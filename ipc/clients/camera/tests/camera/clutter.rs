//! Other tags and textures beside ours.

use markers::Family;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use vision::{Look, Renderer, Tag};
use vpc_camera::config::Targets;
use vpc_camera::finder::Finder;
use vpc_camera::grey::Grey;
use vpc_camera::lens::Lens;

use crate::drawing::{Errors, grey, open_scene, poses, truth};

fn finder(scene: &Scene) -> Finder {
    let lens = Lens::pinhole(&scene.camera);
    Finder::new(
        scene,
        &lens,
        Family::default(),
        &Targets::Centres(vec![0, 1, 2, 3]),
    )
    .unwrap()
}

/// Ours, and others about them, two of which have numbers of ours.
fn tags(scene: &Scene) -> Vec<Tag> {
    let mut tags = Tag::of_pattern(scene, 0.024);
    for (n, number) in [7, 1, 12, 3, 30, 8].into_iter().enumerate() {
        tags.push(Tag {
            number,
            center: [
                0.045 * (n as f64 - 2.5),
                if n % 2 == 0 { 0.0 } else { 0.105 },
            ],
            size: 0.02,
        });
    }
    tags
}

#[test]
fn a_visible_feature_is_ours_whatever_lies_about_it() {
    let scene = open_scene();
    let mut finder = finder(&scene);
    let mut renderer = Renderer::with_tags(&scene, &Look::default(), &tags(&scene));
    let mut errors = Errors::default();
    const FRAMES: usize = 60;
    for (n, pose) in poses(&scene, 3, 40.0).take(FRAMES).enumerate() {
        let image = renderer.render(&pose).clone();
        for k in 1..3 {
            let found = finder.find(&grey(&image), 2 * n as u64 + k).unwrap();
            for (bit, (point, truth)) in found.points.iter().zip(truth(&scene, &pose)).enumerate() {
                if found.visible >> bit & 1 == 1 {
                    errors.add(*point, truth);
                }
            }
        }
    }
    println!(
        "among others: {} found, {:.3} px at most",
        errors.count, errors.worst
    );
    assert!(errors.worst < 0.5, "{errors:?}");
    assert!(errors.count > 0.95 * 8.0 * FRAMES as f64, "{errors:?}");
}

#[test]
fn where_ours_are_not_nothing_is_seen() {
    let scene = open_scene();
    let others = tags(&scene).into_iter().filter(|tag| tag.number > 3);
    let others: Vec<Tag> = others.collect();
    let look = Look {
        texture: 60.0,
        noise: 10.0,
        ..Look::default()
    };
    let mut renderer = Renderer::with_tags(&scene, &look, &others);
    let mut finder = finder(&scene);
    for (n, pose) in poses(&scene, 4, 20.0).take(60).enumerate() {
        let image = renderer.render(&pose).clone();
        let found = finder.find(&grey(&image), n as u64 + 1).unwrap();
        assert_eq!(found.visible, 0, "{n}");
    }
    // Blocks of random levels, of every size.
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for n in 0..100_usize {
        let side = 2 + n % 24;
        let levels: Vec<u8> = (0..640 * 480)
            .map(|_| if random.random::<bool>() { 220 } else { 20 })
            .collect();
        let pixel = |k: usize| levels[(k / 640 / side) * 640 + k % 640 / side];
        let pixels: Vec<u8> = (0..640 * 480).map(pixel).collect();
        let image = Grey::new(&pixels, 640, 480, 640).unwrap();
        let found = finder.find(&image, 1000 + n as u64).unwrap();
        assert_eq!(found.visible, 0, "blocks of {side} px");
    }
}
