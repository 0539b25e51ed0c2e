//! The camera client for OpenCV (`ipc/clients/python/opencv_camera.py`) on rendered frames: its
//! points against the truth.

use std::path::Path;

use scene::{Pose, Scene};
use testkit::python::{Environment, script};
use testkit::{Ended, Place, ended, root};
use vision::{Look, Renderer, truth};

use super::write;

/// Frames of the video.
const FRAMES: usize = 40;

/// The client on files, as far as it goes without shared memory.
fn camera(python: &Path, scene: &Path, arguments: &[&str]) -> Ended {
    let client = root().join("ipc/clients/python/opencv_camera.py");
    let mut camera = script(python, &client);
    camera.arg("--scene").arg(scene).arg("--dry");
    ended(camera.args(arguments))
}

/// The object beside the goal, down behind the grasped object until its lower tags are hidden, and
/// back.
fn pose(scene: &Scene, frame: usize) -> Pose {
    let share = (std::f64::consts::PI * frame as f64 / (FRAMES - 1) as f64).sin();
    let mut pose = scene.goal;
    pose.translation[0] += 0.004 * share;
    pose.translation[1] += 0.07 * share;
    pose.rotation = [0.05 * share, -0.04 * share, 0.06 * share];
    pose
}

/// A line of `--print`: frame, stamp, then "(u, v)" with a question mark where a tag is not seen.
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
fn opencv_sees_rendered_tags_only_where_they_are() {
    let Some(python) = Environment::JUDGES.python("opencv_camera.py on rendered frames") else {
        return;
    };
    let place = Place::new();
    let scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
    let mut renderer = Renderer::new(&scene, &Look::default());
    for frame in 0..FRAMES {
        let image = renderer.render(&pose(&scene, frame));
        write(&place.path(&format!("{frame:03}.png")), image);
    }
    let file = place.file("scene.toml", scene::TAGS_ROBOT);
    let video = place.path("%03d.png");
    let video = ["--print", "--video", video.to_str().unwrap()];
    let printed = camera(&python, &file, &video).stdout;

    let lines: Vec<&str> = printed.lines().filter(|line| line.contains('(')).collect();
    assert_eq!(lines.len(), FRAMES, "{printed}");
    let (mut squares, mut seen, mut hidden, mut missed, mut worst) = (0.0, 0, 0, 0, 0.0f64);
    for (frame, line) in lines.into_iter().enumerate() {
        let truths = truth(&scene, &pose(&scene, frame), scene.marker_size, |_| true);
        for (truth, (pixel, visible)) in truths.iter().zip(points(line)) {
            assert!(!(truth.occluded && visible), "frame {frame}: {line}");
            hidden += usize::from(truth.occluded);
            missed += usize::from(truth.covered == 0.0 && !visible);
            if visible {
                let off = (pixel[0] - truth.pixel[0]).hypot(pixel[1] - truth.pixel[1]);
                (squares, seen, worst) = (squares + off * off, seen + 1, worst.max(off));
            }
        }
    }
    let rms = (squares / f64::from(seen)).sqrt();
    println!(
        "OpenCV: {rms:.3} px RMS, worst {worst:.2} px; {seen} tags seen, {hidden} hidden, {missed} missed"
    );
    assert!(rms < 0.15 && worst < 0.7, "{rms} {worst}");
    assert!(
        seen > 100 && hidden > 20 && missed < 4,
        "{seen} {hidden} {missed}"
    );

    // The lower two under other numbers: they are not there.
    let other = camera(
        &python,
        &file,
        &[&video[..], &["--tags", "0,1,7,8"]].concat(),
    );
    assert_eq!(other.code, Some(1), "{}", other.stderr);
    let bits = |line: &str| points(line).iter().map(|point| point.1).collect::<Vec<_>>();
    let first = other.stdout.lines().next().unwrap();
    assert_eq!(bits(first), [true, true, false, false], "{first}");
    let few = camera(&python, &file, &[&video[..], &["--tags", "0,1"]].concat());
    assert!(
        few.stderr.contains("--tags: 2 numbers; allowed: 4"),
        "{}",
        few.stderr
    );
}
