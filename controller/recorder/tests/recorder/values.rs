//! What was published comes back bit for bit, and others read the same.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

use messages::{Reply, Stamp};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use recorder::Account;
use recording::Recording;
use serde_json::Value;

use testkit::Place;
use testkit::python::run;

use crate::fixture::{FILE, MESSAGES, Stage, check, options, python, recorded, same};

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

#[test]
fn what_was_published_comes_back_and_others_read_the_same() {
    // A starved machine may lose messages, and says so: then once more.
    let complete = (0..5).any(published_and_read);
    assert!(complete, "messages were lost each time");
}

/// Whether nothing was lost.
fn published_and_read(seed: u64) -> bool {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut published = Recording::default();
    let mut before = Vec::new();
    let (ledger, notices) = recorded(&options(&place), || {
        stage.wait_for_recorder();
        for i in 0..MESSAGES {
            stage.publish(i, &mut random, &mut published);
            std::thread::sleep(Duration::from_millis(3));
        }
    });
    if ledger.accounts().any(|(_, account)| account.lost > 0) {
        return false;
    }
    let mut recording = Recording::read(&place.path(FILE)).unwrap();
    // The replies by which the recorder was waited for.
    let first = published.replies[0].stamp.sequence;
    recording.replies.retain(|reply| {
        let early = reply.stamp.sequence < first;
        if early {
            before.push(*reply);
        }
        !early
    });

    assert_eq!(notices, [], "nothing was lost");
    assert_eq!(recording.cut, None);
    assert_eq!(recording.metadata["vpc.ledger"], ledger.to_map());
    assert_eq!(recording.scene_toml(), Some(scene::PAPER_SIM));
    assert!(recording.config().unwrap().contains("[law]"));
    layout_names_what_is_recorded(&place.path(FILE));
    same(&recording.features, &published.features);
    same(&recording.twist, &published.twist);
    same(&recording.robot, &published.robot);
    same(&recording.cycles, &published.cycles);
    same(&recording.requests, &published.requests);
    same(&recording.replies, &published.replies);
    assert_eq!(
        ledger.of("/vpc/cycles"),
        Account {
            recorded: MESSAGES as u64,
            ..Account::default()
        }
    );

    let test = "what_was_published_comes_back_and_others_read_the_same";
    if let Some(python) = python(test) {
        others_read_the_same(&python, &place.path(FILE), &published, &before, &recording);
    }
    true
}

/// A topic of the layout that is not recorded here: the scene names no arm.
const OF_AN_ARM: &str = "/camera/joints";

/// Every topic in the layout for Foxglove is in the file, every field in the schema of its topic.
fn layout_names_what_is_recorded(file: &Path) {
    let summary = mcap::Summary::read(&std::fs::read(file).unwrap());
    let channels = summary.unwrap().unwrap().channels;
    let layout: Value = serde_json::from_str(include_str!(
        "../../../../ipc/recording/foxglove-layout.json"
    ))
    .unwrap();
    let mut found = Vec::new();
    texts(&layout, &mut found);
    let is_here = |text: &&String| text.starts_with('/') && *text != OF_AN_ARM;
    let paths: Vec<_> = found.iter().filter(is_here).collect();
    assert!(paths.len() > 15, "{paths:?}");
    for path in paths {
        let (topic, field) = path.split_once('.').unwrap_or((path, ""));
        let channel = channels.values().find(|channel| channel.topic == topic);
        let channel = channel.unwrap_or_else(|| panic!("{path}: no such topic"));
        let field = field.split('[').next().unwrap_or_default();
        if !field.is_empty() {
            let schema = &channel.schema.as_ref().unwrap().data;
            let schema: Value = serde_json::from_slice(schema).unwrap();
            assert!(schema["properties"].get(field).is_some(), "{path}");
        }
    }
}

/// Every text in some JSON, keys included.
fn texts(json: &Value, to: &mut Vec<String>) {
    match json {
        Value::String(text) => to.push(text.clone()),
        Value::Array(list) => list.iter().for_each(|value| texts(value, to)),
        Value::Object(map) => map.iter().for_each(|(key, value)| {
            to.push(key.clone());
            texts(value, to);
        }),
        _ => (),
    }
}

fn others_read_the_same(
    python: &Path,
    file: &Path,
    published: &Recording,
    before: &[Reply],
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
        ("/vpc/replies", before.len()),
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
