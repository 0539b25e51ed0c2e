//! Others read the same as we.

use std::fmt::Write as _;
use std::path::Path;

use messages::{CycleRecord, Order, Stamp};
use recorder::Recorder;
use recording::Recording;
use scene::SceneFiles;
use testkit::Place;
use testkit::python::run;

use crate::fixture::{FILE, MESSAGES, OF_AN_ARM, published_and_read, same};
use crate::python::{check, python};

#[test]
fn others_read_what_was_published() {
    let Some(python) = python("a recording in Python") else {
        return;
    };
    let place = Place::new();
    let (published, recording, _) = published_and_read(&place);
    // The replies by which the recorder was waited for.
    let before = recording.replies.len() - published.replies.len();
    same(&recording.replies[before..], &published.replies);
    others_read_the_same(&python, &place.path(FILE), &published, before, &recording);
}

/// Up to the last flush, which nobody has indexed.
#[test]
fn others_read_a_file_that_was_not_finished() {
    let Some(python) = python("an unfinished recording in Python") else {
        return;
    };
    let place = Place::new();
    let mut file = Recorder::create(&place.path(FILE), false).unwrap();
    for number in 1..=40 {
        let mut cycle = CycleRecord::default();
        (cycle.cycle, cycle.stamp.sequence) = (number, number);
        file.take(&cycle, Order::Next).unwrap();
    }
    file.flush().unwrap();
    // As a kill leaves it.
    std::mem::forget(file);
    let recording = Recording::read(&place.path(FILE)).unwrap();
    assert!(recording.cut.is_some() && recording.cycles.len() == 40);
    let found = check(&python, "rest", &[&place.path(FILE)]);
    let line = "count /vpc/cycles 40".to_owned();
    assert!(found.contains(&line), "{found:?}");
}

#[test]
fn others_find_the_mask_of_a_scene() {
    let Some(python) = python("the mask in Python") else {
        return;
    };
    let place = Place::new();
    scene::write_mask(&place.path("ring.png"), 1024, 1024, |u, v| u + v < 200).unwrap();
    let bytes = std::fs::metadata(place.path("ring.png")).unwrap().len();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let text = format!("{head}[[occlusion]]\nname = \"ring\"\nmask = \"ring.png\"\n");
    let files = SceneFiles::read(&place.file("scene.toml", text)).unwrap();
    let mut file = Recorder::create(&place.path(FILE), false).unwrap();
    file.describe(&files).unwrap();
    file.finish().unwrap();
    let found = check(&python, "values", &[&place.path(FILE)]);
    let line = format!("attachment ring.png image/png {bytes}");
    assert!(found.contains(&line), "{line}: {found:?}");
}

/// Bits of numbers, as `check.py` prints them.
fn bits(numbers: &[f64]) -> String {
    let one = |x: &f64| {
        if x.is_nan() {
            "nan".to_owned()
        } else {
            format!("{:016x}", x.to_bits())
        }
    };
    numbers.iter().map(one).collect::<Vec<_>>().join(" ")
}

/// The lines that `check.py values` is to print about messages, by topic.
fn lines(published: &Recording) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = |topic: &str, stamp: &Stamp, whole: &[u64], real: &[&[f64]]| {
        let Stamp {
            sequence,
            published_ns,
            data_ns,
        } = stamp;
        let mut line = format!("message {topic} {sequence} {published_ns} {data_ns}");
        whole.iter().for_each(|n| write!(line, " {n}").unwrap());
        real.iter()
            .for_each(|x| write!(line, " {}", bits(x)).unwrap());
        lines.push(line);
    };
    for m in &published.features {
        let whole = [m.exposure_ns, m.count.into(), m.visible.into()];
        line("/vpc/features", &m.stamp, &whole, &[&m.points]);
    }
    for m in &published.twist {
        let whole = [
            m.features_sequence,
            m.features_published_ns,
            m.valid_until_ns,
            m.state.into(),
        ];
        line("/vpc/twist", &m.stamp, &whole, &[&m.twist]);
    }
    for m in &published.robot {
        let whole = [
            m.features_sequence,
            m.mode.into(),
            m.faults.into(),
            m.joints.into(),
        ];
        let real = [
            &m.translation[..],
            &m.rotation,
            &m.twist,
            &m.q,
            &m.dq,
            &[m.commands_in_time],
        ];
        line("/vpc/robot", &m.stamp, &whole, &real);
    }
    for m in &published.cycles {
        let whole = [
            m.cycle,
            m.step_ns,
            m.hold.into(),
            m.state.into(),
            m.way_point_count.into(),
        ];
        let law = [m.cost, m.violation_px, m.clearance_px, m.error_px];
        let real = [&m.points[..], &m.way_point, &m.twist, &law];
        line("/vpc/cycles", &m.stamp, &whole, &real);
    }
    for m in &published.requests {
        let whole = [
            m.id,
            m.action.into(),
            m.strategy.into(),
            m.neighbours.into(),
        ];
        line("/vpc/requests", &m.stamp, &whole, &[]);
    }
    for m in &published.replies {
        let whole = [m.id, m.action.into(), m.outcome.into(), m.state.into()];
        line("/vpc/replies", &m.stamp, &whole, &[]);
    }
    lines
}

fn others_read_the_same(
    python: &Path,
    file: &Path,
    published: &Recording,
    before: usize,
    recording: &Recording,
) {
    let found = check(python, "values", &[file]);
    let messages = |lines: &[String], topic: &str| -> Vec<String> {
        let head = format!("message {topic} ");
        lines
            .iter()
            .filter(|line| line.starts_with(&head))
            .cloned()
            .collect()
    };
    let expected = lines(published);
    for (topic, skipped) in [
        ("/vpc/features", 0),
        ("/vpc/twist", 0),
        ("/vpc/robot", 0),
        ("/vpc/cycles", 0),
        ("/vpc/requests", 0),
        ("/vpc/replies", before),
    ] {
        let (theirs, ours) = (messages(&found, topic), messages(&expected, topic));
        let count = format!("count {topic} {}", ours.len() + skipped);
        assert!(found.contains(&count), "{count}");
        for (theirs, ours) in theirs[skipped..].iter().zip(&ours) {
            assert_eq!(theirs, ours, "Python first, then Rust");
        }
        assert_eq!(theirs.len(), ours.len() + skipped, "{topic}");
    }
    let readme = include_str!("../../../../ipc/recording/README.md");
    let (_, block) = readme.split_once("```python\n").unwrap();
    let (lines_of_pandas, _) = block.split_once("```").unwrap();
    let mut pandas = testkit::command(python);
    pandas.current_dir(file.parent().unwrap());
    pandas.args([
        "-c",
        &format!("{lines_of_pandas}print(cycles['stamp.sequence'].max())"),
    ]);
    let last = published
        .cycles
        .iter()
        .map(|cycle| cycle.stamp.sequence)
        .max();
    assert_eq!(run(&mut pandas).unwrap().trim(), last.unwrap().to_string());
    let clock = recording.clock().unwrap();
    for line in [
        format!("metadata vpc.ledger /vpc/features.recorded {MESSAGES}"),
        "metadata vpc.ledger /vpc/features.lost 0".to_owned(),
        format!("metadata vpc.origin wall_ns {}", clock.wall_ns),
        format!(
            "attachment scene.toml application/toml {}",
            scene::PAPER_SIM.len()
        ),
        "count /camera/image 1".to_owned(),
    ] {
        assert!(found.contains(&line), "{line}");
    }
    let layout =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../ipc/recording/foxglove-layout.json");
    assert_eq!(check(python, "layout", &[&layout]).len(), 8);
    // Every topic and path that the layout names is in the recording; numbers that are not finite
    // are left out.
    let paths = check(python, "paths", &[file, &layout]);
    assert!(paths.len() > 15, "{paths:?}");
    for line in &paths {
        let words: Vec<_> = line.split(' ').collect();
        if words[1] == OF_AN_ARM {
            continue;
        }
        let [heard, values] = [words[2], words[3]].map(|count| count.parse::<u64>().unwrap());
        let all = ["clearance_px", "error_px"]
            .iter()
            .all(|name| !words[1].ends_with(name));
        let is_there = heard > 0 && (values == heard || !all);
        assert!(is_there, "{line}: topic or path, messages, values");
    }
    let known = check(python, "schemas", &[file]);
    for name in [
        "ImageAnnotations",
        "RawImage",
        "CameraCalibration",
        "FrameTransform",
        "SceneUpdate",
        "PoseInFrame",
        "Log",
    ] {
        let head = format!("known foxglove.{name} ");
        let line = known.iter().find(|line| line.starts_with(&head)).unwrap();
        assert!(!line.ends_with(" 0"), "{line}");
    }
}
