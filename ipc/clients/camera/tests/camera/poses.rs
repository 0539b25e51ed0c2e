//! How exact features are over random poses.

use markers::Family;
use scene::Scene;
use testkit::repeats;
use vision::{Image, Look, Renderer};
use vpc_camera::config::Targets;
use vpc_camera::finder::Finder;
use vpc_camera::lens::{Distortion, Lens};

use crate::drawing::{Errors, grey, open_scene, poses, smeared, through, truth};

fn centres() -> Targets {
    Targets::Centres(vec![0, 1, 2, 3])
}

/// Looks at each pose twice, at the jump and a frame later; the errors of the second look, and the
/// share of tags that it found.
fn measured(
    scene: &Scene,
    lens: &Lens,
    look: &Look,
    change: &dyn Fn(&Image) -> Image,
    frames: usize,
) -> (Errors, f64) {
    let mut finder = Finder::new(scene, lens, look.family, &centres()).unwrap();
    let mut renderer = Renderer::new(scene, look);
    let (mut errors, mut sequence) = (Errors::default(), 0);
    let poses = poses(scene, 11, 40.0).take(frames);
    for pose in poses {
        let image = change(renderer.render(&pose));
        sequence += 2;
        finder.find(&grey(&image), sequence).unwrap();
        let found = finder.find(&grey(&image), sequence + 1).unwrap();
        for (bit, (point, truth)) in found.points.iter().zip(truth(scene, &pose)).enumerate() {
            if found.visible >> bit & 1 == 1 {
                errors.add(*point, truth);
            }
        }
    }
    let share = errors.count / (4 * frames) as f64;
    (errors, share)
}

#[test]
fn features_are_within_a_tenth_of_a_pixel_of_the_truth() {
    let scene = open_scene();
    let pinhole = Lens::pinhole(&scene.camera);
    let curved = Lens {
        focal: [602.0, 604.0],
        centre: [326.0, 236.0],
        distortion: Distortion::perspective([-0.21, 0.06, 8e-4, -6e-4, 0.0, 0.0, 0.0, 0.0]),
        ..pinhole.clone()
    };
    let plain = Look::default();
    let noisy = Look {
        noise: 6.0,
        ..plain
    };
    let dim = Look {
        white_level: 110.0,
        black_level: 40.0,
        noise: 4.0,
        ..plain
    };
    let of = |name: &str| Look {
        family: name.parse().unwrap(),
        ..plain
    };
    let same = |image: &Image| image.clone();
    let across = |image: &Image| smeared(image, 3, false);
    let down = |image: &Image| smeared(image, 3, true);
    let bent = |image: &Image| through(&curved, &scene.camera, image);
    let frames = repeats("frames of each kind", 10, 1000);
    // A name, how images are made, errors (px RMS) and shares of tags. Of contrast and lens
    // 0.95 would be within the scatter of a few hundred tags.
    for (name, lens, look, change, most, least) in [
        (
            "as rendered",
            &pinhole,
            plain,
            &same as &dyn Fn(&Image) -> Image,
            0.05,
            0.95,
        ),
        ("noise of 6 levels", &pinhole, noisy, &same, 0.1, 0.95),
        ("contrast of 70 levels", &pinhole, dim, &same, 0.1, 0.9),
        ("moved by 3 px across", &pinhole, plain, &across, 0.1, 0.95),
        ("moved by 3 px down", &pinhole, plain, &down, 0.1, 0.95),
        ("distorted", &curved, plain, &bent, 0.1, 0.9),
        (
            "DICT_4X4_50",
            &pinhole,
            of("DICT_4X4_50"),
            &same,
            0.05,
            0.95,
        ),
        (
            "DICT_5X5_100",
            &pinhole,
            of("DICT_5X5_100"),
            &same,
            0.05,
            0.95,
        ),
        (
            "DICT_ARUCO_ORIGINAL",
            &pinhole,
            of("DICT_ARUCO_ORIGINAL"),
            &same,
            0.05,
            0.95,
        ),
    ] {
        let (errors, share) = measured(&scene, lens, &look, change, frames);
        println!(
            "{name}: {:.1} % found, {:.3} px RMS, {:.3} px at most",
            100.0 * share,
            errors.rms(),
            errors.worst
        );
        assert!(share > least, "{name}: {share}");
        assert!(
            errors.rms() < most && errors.worst < 0.5,
            "{name}: {errors:?}"
        );
    }
}

#[test]
fn the_corners_of_one_tag_are_features_in_the_patterns_order() {
    // The pattern is the black square of tag 2, upright.
    let text = scene::TAGS_ROBOT;
    let points = "points = [[-0.012, -0.012, 0.0], [0.012, -0.012, 0.0], [0.012, 0.012, 0.0], [-0.012, 0.012, 0.0]]";
    let line = text
        .lines()
        .find(|line| line.starts_with("points"))
        .unwrap();
    let mut corners = Scene::parse(&text.replace(line, points), "corners").unwrap();
    corners.occlusions.clear();
    let tag = vision::Tag {
        number: 2,
        center: [0.0; 2],
        size: 0.024,
    };
    let mut renderer = Renderer::with_tags(&corners, &Look::default(), &[tag]);
    let lens = Lens::pinhole(&corners.camera);
    let mut errors = Errors::default();
    for pose in poses(&corners, 5, 20.0).take(40) {
        let image = renderer.render(&pose).clone();
        // A lone tag that jumps is somebody else's, until ours was lost for a while.
        let mut finder =
            Finder::new(&corners, &lens, Family::default(), &Targets::Corners(2)).unwrap();
        for k in 1..3 {
            let found = finder.find(&grey(&image), k).unwrap();
            if k == 2 && found.visible == 0b1111 {
                let points = found.points.iter().zip(truth(&corners, &pose));
                points.for_each(|(point, truth)| errors.add(*point, truth));
            }
        }
    }
    println!(
        "corners: {:.3} px RMS, {:.3} px at most",
        errors.rms(),
        errors.worst
    );
    assert!(errors.count >= 4.0 * 39.0, "{errors:?}");
    assert!(errors.rms() < 0.1 && errors.worst < 0.5, "{errors:?}");
}
