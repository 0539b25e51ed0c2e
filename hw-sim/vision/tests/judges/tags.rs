//! Rendered tags, read by OpenCV's ArUco detector: numbers, order of corners, places.

use std::path::Path;

use markers::Family;
use scene::{Pose, Scene};
use testkit::python::{Environment, run, script};
use testkit::{Place, root};
use vision::{Look, Renderer, Tag};

use super::write;

/// Where the camera sees a point of the plane z = 0, px.
fn project(scene: &Scene, pose: &Pose, [x, y]: [f64; 2]) -> [f64; 2] {
    let camera = &scene.camera;
    let turn = nalgebra::Rotation3::new(nalgebra::Vector3::from(pose.rotation));
    let at = turn * nalgebra::Vector3::new(x, y, 0.0) + nalgebra::Vector3::from(pose.translation);
    [
        camera.cx + camera.fx * at.x / at.z,
        camera.cy + camera.fy * at.y / at.z,
    ]
}

/// Tags found in an image: number and corners.
fn found(line: &str) -> Vec<(usize, [[f64; 2]; 4])> {
    let words: Vec<f64> = line
        .split_whitespace()
        .map(|word| word.parse().unwrap())
        .collect();
    words
        .chunks_exact(9)
        .map(|tag| {
            (
                tag[0] as usize,
                std::array::from_fn(|k| [tag[1 + 2 * k], tag[2 + 2 * k]]),
            )
        })
        .collect()
}

#[test]
fn opencv_reads_every_tag_of_a_board_where_it_is_drawn_upright() {
    let Some(python) = Environment::JUDGES.python("rendered tags") else {
        return;
    };
    // The family's numbers, from which on.
    for (name, first) in [
        ("DICT_APRILTAG_36h11", 563),
        ("DICT_APRILTAG_16h5", 6),
        ("DICT_APRILTAG_25h9", 11),
        ("DICT_4X4_50", 26),
        ("DICT_5X5_100", 76),
        ("DICT_6X6_250", 226),
        ("DICT_7X7_1000", 976),
        // Its last marker, 1023, looks the same upside down.
        ("DICT_ARUCO_ORIGINAL", 990),
    ] {
        reads(&python, name.parse().unwrap(), first);
    }
}

fn reads(python: &Path, family: Family, first: usize) {
    let place = Place::new();
    let mut scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
    scene.occlusions.clear();
    let board = Tag::board(6, 4, 0.02, 0.026);
    let boards = [
        board.clone(),
        board
            .iter()
            .map(|tag| Tag {
                number: tag.number + first,
                ..*tag
            })
            .collect(),
    ];
    let pose = |k: usize| Pose {
        translation: [0.002 * k as f64, 0.001 * k as f64, 0.3 + 0.01 * k as f64],
        rotation: [0.05 * k as f64, 0.2 - 0.06 * k as f64, 0.3 * k as f64],
    };
    let mut command = script(python, &root().join("hw-sim/vision/tests/judges/aruco.py"));
    command.arg(family.name());
    let look = Look {
        family,
        ..Look::default()
    };
    for k in 0..8 {
        let mut renderer = Renderer::with_tags(&scene, &look, &boards[k % 2]);
        let path = place.path(&format!("{k}.png"));
        write(&path, renderer.render(&pose(k)));
        command.arg(path);
    }
    let printed = run(&mut command).unwrap();
    let (mut squares, mut centers, mut mean, mut count) = (0.0, 0.0, [0.0; 2], 0.0);
    for (k, line) in printed.lines().enumerate() {
        let tags = found(line);
        assert_eq!(tags.len(), 24, "{family}, image {k}: {line}");
        for (number, corners) in tags {
            let tag = boards[k % 2]
                .iter()
                .find(|tag| tag.number == number)
                .unwrap();
            // OpenCV's AprilTags are turned by half a turn.
            let mut truth = tag
                .corners()
                .map(|corner| project(&scene, &pose(k), corner));
            if family.name().contains("APRILTAG") {
                truth.rotate_left(2);
            }
            let mut off = [0.0; 2];
            for (corner, truth) in corners.iter().zip(truth) {
                let apart = [corner[0] - truth[0], corner[1] - truth[1]];
                assert!(
                    apart[0].hypot(apart[1]) < 0.8,
                    "image {k}, tag {number}: {apart:?}"
                );
                squares += apart[0].powi(2) + apart[1].powi(2);
                off = [off[0] + apart[0] / 4.0, off[1] + apart[1] / 4.0];
            }
            mean = [mean[0] + off[0], mean[1] + off[1]];
            centers += off[0].powi(2) + off[1].powi(2);
            count += 1.0;
        }
    }
    let [corner, center] = [squares / (4.0 * count), centers / count].map(f64::sqrt);
    let mean = mean.map(|x| x / count);
    println!(
        "{family} by OpenCV: corners {corner:.3} px RMS, centres {center:.3} px RMS, mean {mean:.3?}"
    );
    assert!(corner < 0.4 && center < 0.1, "{corner} {center}");
    assert!(mean.iter().all(|x| x.abs() < 0.02), "{mean:?}");
}
