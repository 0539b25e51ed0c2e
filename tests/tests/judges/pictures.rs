//! Pictures: other detectors and published corners say where the tags are.
//!
//! Those of real cameras are not here: `VPC_REAL` names a folder with `rbt/`, the pictures of
//! `rbt/sequence`, and `tags/`, the files of `AprilTag`, both of github.com/lagadic/visp-images.

use std::collections::BTreeMap;
use std::path::Path;

use markers::Family;
use scene::{Pose, Scene};
use serde::Deserialize;
use testkit::{Place, program, real, tell};
use vision::{Look, Renderer, Tag};

/// Centres of tags by number, px.
type Centres = BTreeMap<u32, [f64; 2]>;

#[derive(Deserialize)]
struct Found {
    detector: String,
    frames: Vec<Frame>,
    summary: Summary,
}

#[derive(Deserialize)]
struct Frame {
    tags: Centres,
}

#[derive(Deserialize)]
struct Summary {
    whole: usize,
    rms: f64,
    most: f64,
    ms: [f64; 2],
    beside: [f64; 2],
}

impl Found {
    fn tell(&self, pictures: &str) {
        let Summary {
            whole,
            rms,
            most,
            ms,
            beside,
        } = &self.summary;
        tell(format!(
            "{pictures} by {}: all tags in {whole} of {} frames, RMS {rms:.3} px, {most:.3} at most, {ms:.1?} ms, beside ours \
             {beside:.3?} px",
            self.detector,
            self.frames.len()
        ));
    }
}

/// Motion of the tags' centres from one frame to the next: the median and the largest, px.
fn motion(frames: &[Frame]) -> [f64; 2] {
    let pairs = frames.iter().zip(&frames[1..]);
    let moved = pairs.flat_map(|(a, b)| {
        let both = a
            .tags
            .iter()
            .filter_map(|(number, p)| Some((p, b.tags.get(number)?)));
        both.map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]))
    });
    let mut moved: Vec<f64> = moved.collect();
    moved.sort_by(f64::total_cmp);
    [moved[moved.len() / 2], moved[moved.len() - 1]]
}

/// What the example `judge` of vpc-camera says of a folder.
fn judged(folder: &Path, tags: &str, flags: &[&str]) -> Vec<Found> {
    let mut judge = testkit::command(program("examples/judge"));
    judge.args(["--json", "--tags", tags]).args(flags);
    let said = testkit::python::run(judge.arg(folder)).unwrap();
    let lines = said.lines().filter(|line| line.starts_with('{'));
    lines
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn a_moving_cameras_tags_are_found_as_often_as_by_apriltag_3_and_as_exactly() {
    let Some(folder) = real("pictures of a moving camera", "rbt") else {
        return;
    };
    let all = judged(&folder, "0,1,2,3,4,5,6", &[]);
    for found in &all {
        found.tell("rbt");
    }
    let [ours, others @ ..] = all.as_slice() else {
        panic!("no detector");
    };
    // Motion and noise that tests/LABORATORY.md compares the emulator with.
    let [median, most] = motion(&ours.frames);
    tell(format!(
        "rbt: tags move by {median:.1} px a frame, {most:.1} at most"
    ));
    assert!(ours.summary.rms < 0.04 && ours.summary.most < 0.22);
    for other in others {
        assert!(
            ours.summary.whole >= other.summary.whole,
            "{}",
            other.detector
        );
        assert!(ours.summary.rms < other.summary.rms, "{}", other.detector);
    }
}

#[test]
fn tags_of_every_family_are_found_as_often_as_by_opencv_and_as_exactly() {
    for name in testkit::FAMILIES {
        let place = Place::new();
        let count = rendered(name.parse().unwrap(), &place.path("."));
        let all = judged(&place.path("."), "0,1,2,3,4,5", &["--family", name]);
        let ours = &all[0].summary;
        for found in &all {
            found.tell(name);
            let Summary {
                whole, rms, beside, ..
            } = &found.summary;
            assert!(ours.whole >= *whole, "{name}: {}", found.detector);
            assert!(ours.rms <= *rms, "{name}: {}", found.detector);
            let [u, v] = beside.map(f64::abs);
            assert!(u.max(v) < 0.05, "{name}: {}", found.detector);
        }
        assert!(ours.whole > count / 2, "{name}");
        assert!(ours.rms < 0.04 && ours.most < 0.22, "{name}");
    }
}

/// Draws a board of six tags that passes before a camera; the number of pictures.
fn rendered(family: Family, folder: &Path) -> usize {
    const FRAMES: usize = 60;
    let mut scene = Scene::parse(scene::TAGS_ROBOT, "tags").unwrap();
    scene.occlusions.clear();
    let look = Look {
        family,
        ..Look::default()
    };
    let mut renderer = Renderer::with_tags(&scene, &look, &Tag::board(3, 2, 0.024, 0.045));
    for n in 0..FRAMES {
        let t = n as f64 / FRAMES as f64;
        let image = renderer.render(&Pose {
            translation: [0.06 * (t - 0.5), 0.03 * (0.5 - t), 0.3 + 0.15 * t],
            rotation: [0.3 * (t - 0.5), 0.4 * (0.5 - t), 0.8 * t],
        });
        let mut bytes = format!("P5\n{} {}\n255\n", image.width(), image.height()).into_bytes();
        bytes.extend_from_slice(image.pixels());
        std::fs::write(folder.join(format!("{n:03}.pgm")), bytes).unwrap();
    }
    FRAMES
}

/// Centres by published corners: a line with the tag's name, which ends in its number, and four
/// lines of numbers, `[u, v]` px or the other way round. The origin is the corner of the first
/// pixel.
fn published(path: &Path, is_row_first: bool) -> Centres {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let mut centres = Centres::new();
    while let Some(name) = lines.next() {
        let number = name.rsplit('_').next().unwrap().trim().parse().unwrap();
        let mut corner = || {
            let numbers = lines.next().unwrap().split_whitespace();
            let numbers: Vec<f64> = numbers.map(|x| x.parse().unwrap()).collect();
            let (u, v) = if is_row_first {
                (numbers[1], numbers[0])
            } else {
                (numbers[0], numbers[1])
            };
            nalgebra::Vector2::new(u - 0.5, v - 0.5)
        };
        let [a, b, c, d] = [corner(), corner(), corner(), corner()];
        let share = (b - a).perp(&(d - b)) / (c - a).perp(&(d - b));
        centres.insert(number, (a + share * (c - a)).into());
    }
    centres
}

#[test]
fn tags_are_where_published_corners_have_them() {
    let Some(folder) = real("pictures with published corners", "tags") else {
        return;
    };
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (picture, corners, is_row_first, tags, least) in [
        (
            "AprilTag.png",
            "ground_truth_detection.txt",
            true,
            "8,10,12,13,14,15,17,19",
            8,
        ),
        (
            "tag36_11_640x480.png",
            "corners_tag36_11.txt",
            false,
            "0,1,2,3,4",
            3,
        ),
    ] {
        let place = Place::new();
        std::fs::copy(folder.join(picture), place.path(picture)).unwrap();
        let known = published(&folder.join(corners), is_row_first);
        let found = judged(&place.path("."), tags, &["--alone"]).remove(0);
        let tags = &found.frames[0].tags;
        assert!(tags.len() >= least, "{picture}: {tags:?}");
        let mut here = [0.0; 2];
        for (number, centre) in tags {
            here = [0, 1].map(|k| here[k] + centre[k] - known[number][k]);
        }
        tell(format!(
            "{picture}: {} tags, {:.3?} px on the mean",
            tags.len(),
            here.map(|x| x / tags.len() as f64)
        ));
        sum = [0, 1].map(|k| sum[k] + here[k]);
        count += tags.len() as f64;
    }
    let bias = sum.map(|sum: f64| sum / count);
    assert!(bias.iter().all(|bias| bias.abs() < 0.05), "{bias:?}");
}
