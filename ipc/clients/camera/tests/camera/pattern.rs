//! `pattern`: the program measures tags in rendered images.

use std::process::Command;

use scene::{Pose, Scene};
use testkit::{Place, ended};
use vision::{Look, Renderer};

use crate::drawing::{open_scene, poses};

/// A configuration of images of these tags, one from each pose; its scene has another pattern.
fn configured(place: &Place, tags: &Scene, poses: &[Pose]) {
    std::fs::create_dir(place.path("images")).unwrap();
    let look = Look {
        noise: 3.0,
        ..Look::default()
    };
    let mut renderer = Renderer::new(tags, &look);
    for (n, pose) in poses.iter().enumerate() {
        let image = renderer.render(pose);
        let mut pgm = format!("P5\n{} {}\n255\n", image.width(), image.height()).into_bytes();
        pgm.extend(image.pixels());
        std::fs::write(place.path(&format!("images/{n:03}.pgm")), pgm).unwrap();
    }
    place.file("tags.toml", scene::TAGS_ROBOT);
    let domain = place.domain();
    let images = place.path("images");
    let keys = format!(
        "source = 'files:{}'\nscene = 'tags.toml'\ndomain = {domain:?}\n",
        images.display()
    );
    place.file("camera.toml", keys);
}

fn pattern(place: &Place, black: &str) -> Command {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_vpc-camera"));
    command
        .arg("pattern")
        .arg("--config")
        .arg(place.path("camera.toml"));
    command.args(["--black", black, "--force", "-o"]);
    command.arg(place.path("own.toml"));
    command
}

#[test]
fn printed_tags_become_the_pattern_of_a_scene() {
    let mut tags = open_scene();
    for (point, moved) in
        tags.pattern
            .iter_mut()
            .zip([[0.0, 0.0], [0.012, -0.004], [0.02, 0.01], [0.0, 0.007]])
    {
        (point[0], point[1]) = (point[0] + moved[0], point[1] + moved[1]);
    }
    let mean = [0, 1].map(|k| tags.pattern.iter().map(|p| p[k]).sum::<f64>() / 4.0);
    let mut most_m = 0.0_f64;
    for pose in poses(&tags, 36, 20.0).take(6) {
        let place = Place::new();
        configured(&place, &tags, &[pose; 5]);
        let said = ended(pattern(&place, "0.024"));
        assert_eq!(said.code, Some(0), "{said:?}");
        let own = Scene::read(&place.path("own.toml")).unwrap();
        assert!((own.marker_size - 0.03).abs() < 1e-9);
        for (found, truth) in own.pattern.iter().zip(&tags.pattern) {
            let off = [0, 1].map(|k| found[k] - (truth[k] - mean[k]));
            most_m = most_m.max(off[0].hypot(off[1]));
        }
    }
    testkit::tell(format_args!("pattern: {:.2} mm off at most", 1e3 * most_m));
    assert!(most_m < 5e-4, "{most_m} m");
}

#[test]
fn what_gives_no_pattern_is_told() {
    let tags = open_scene();
    let seen: Vec<_> = poses(&tags, 36, 20.0).take(2).collect();
    let place = Place::new();
    configured(&place, &tags, &seen);
    for (black, words) in [
        ("0.024", "hold the camera still"),
        ("24", "--black = 24; allowed: 0.001 to 1 m"),
    ] {
        let said = ended(pattern(&place, black));
        assert_eq!(said.code, Some(1), "{said:?}");
        assert!(said.stderr.contains(words), "{words}: {said:?}");
    }
    assert!(!place.path("own.toml").exists());
    // Others than those that are seen.
    let place = Place::new();
    configured(&place, &tags, &seen[..1]);
    let keys = std::fs::read_to_string(place.path("camera.toml")).unwrap();
    place.file("camera.toml", format!("{keys}tags = [0, 1, 2, 9]\n"));
    let said = ended(pattern(&place, "0.024"));
    assert!(
        said.stderr
            .contains("none shows each of the tags [0, 1, 2, 9]"),
        "{said:?}"
    );
}
