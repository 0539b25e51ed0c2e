//! The camera client for OpenCV (`ipc/python/opencv_camera.py`) on rendered frames: its points
//! against the truth, and what it says of a pattern that it cannot tell from itself turned.

use std::fs::File;
use std::path::Path;
use std::process::Command;

use scene::{Pose, Scene};
use testkit::python::{Environment, script};
use testkit::{Ended, Place, ended, root};
use vision::{Image, Look, Renderer, truth};

/// Frames of the video.
const FRAMES: usize = 40;

const OPENCV: Environment = Environment {
    name: "python-opencv",
    requirements: &[],
    packages: &["numpy", "opencv-python-headless>=4.10,<6"],
};

/// The client on files, as far as it goes without shared memory.
fn camera(python: &Path, scene: &Path, arguments: &[&str]) -> Ended {
    let client = root().join("ipc/python/opencv_camera.py");
    let mut camera: Command = script(python, &client);
    camera.arg("--scene").arg(scene).arg("--dry");
    ended(camera.args(arguments))
}

fn write(path: &Path, image: &Image) {
    let size = [image.width(), image.height()].map(|side| side as u32);
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(image.pixels()).unwrap();
}

/// The object beside the goal, down behind the grasped object until its lower markers are hidden,
/// and back.
fn pose(scene: &Scene, frame: usize) -> Pose {
    let share = (std::f64::consts::PI * frame as f64 / (FRAMES - 1) as f64).sin();
    let mut pose = scene.goal;
    pose.translation[0] += 0.004 * share;
    pose.translation[1] += 0.07 * share;
    pose.rotation = [0.05 * share, -0.04 * share, 0.06 * share];
    pose
}

/// A line of `--print`: frame, stamp, then "(u, v)" with a question mark where a marker is not
/// seen.
fn points(line: &str) -> Vec<([f64; 2], bool)> {
    let (_, rest) = line.split_once('(').unwrap();
    let each = rest.split('(').map(|text| {
        let (numbers, mark) = text.split_once(')').unwrap();
        let (u, v) = numbers.split_once(", ").unwrap();
        let pixel = [u, v].map(|x| x.parse().unwrap());
        (pixel, !mark.starts_with('?'))
    });
    each.collect()
}

#[test]
fn opencv_sees_rendered_markers_where_they_are_and_not_where_they_are_hidden() {
    let Some(python) = OPENCV.python("opencv_camera.py on rendered frames") else {
        return;
    };
    let place = Place::new();
    let scene = Scene::parse(scene::PAPER_ROBOT, "robot").unwrap();
    let mut renderer = Renderer::new(&scene, &Look::default());
    for frame in 0..FRAMES {
        let image = renderer.render(&pose(&scene, frame));
        write(&place.path(&format!("{frame:03}.png")), image);
    }
    let file = place.file("scene.toml", scene::PAPER_ROBOT);
    let video = place.path("%03d.png");
    let printed = camera(
        &python,
        &file,
        &["--print", "--video", video.to_str().unwrap()],
    )
    .stdout;

    let lines: Vec<&str> = printed.lines().filter(|line| line.contains('(')).collect();
    assert_eq!(lines.len(), FRAMES, "{printed}");
    let (mut squares, mut seen, mut hidden, mut worst) = (0.0, 0, 0, 0.0f64);
    for (frame, line) in lines.into_iter().enumerate() {
        let truths = truth(&scene, &pose(&scene, frame), 0.006, |_| true);
        for (truth, (pixel, visible)) in truths.iter().zip(points(line)) {
            assert!(!(truth.occluded && visible), "frame {frame}: {line}");
            hidden += usize::from(truth.occluded);
            if visible {
                let off = (pixel[0] - truth.pixel[0]).hypot(pixel[1] - truth.pixel[1]);
                (squares, seen, worst) = (squares + off * off, seen + 1, worst.max(off));
            }
        }
    }
    let rms = (squares / f64::from(seen)).sqrt();
    println!("OpenCV: {rms:.3} px RMS, worst {worst:.2} px, {seen} markers seen, {hidden} hidden");
    assert!(rms < 0.15 && worst < 1.0, "{rms} {worst}");
    assert!(seen > 100 && hidden > 20, "{seen} {hidden}");
}

#[test]
fn a_square_that_is_rolled_too_far_is_said_to_be_ambiguous_with_the_remedy() {
    let Some(python) = OPENCV.python("opencv_camera.py on a square") else {
        return;
    };
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let place = Place::new();
    let file = place.file("scene.toml", scene::PAPER_SIM);
    let mut renderer = Renderer::new(&scene, &Look::default());
    (0..scene.occlusions.len()).for_each(|occlusion| renderer.show(occlusion, false));
    let mut pose = scene.goal;
    pose.rotation[2] = 20f64.to_radians();
    let image = place.path("rolled.png");
    write(&image, renderer.render(&pose));
    let picture = ["--frames", "2", "--image-file", image.to_str().unwrap()];
    let silent = camera(&python, &file, &picture);
    assert_eq!(silent.code, Some(1), "{}", silent.stderr);
    for words in [
        "the pattern looks the same after 90 deg and is taken up only within 10 deg",
        "or give --turn-max 44",
        "frame 1: all markers are there, but which is which is not clear",
    ] {
        assert!(silent.stderr.contains(words), "{}", silent.stderr);
    }
    let found = camera(
        &python,
        &file,
        &[&picture[..], &["--turn-max", "44"]].concat(),
    );
    assert_eq!(found.code, Some(0), "{}", found.stderr);
}
