//! `plot` as a process, on a recording that is written here, and what `record` refuses.

use std::path::{Path, PathBuf};
use std::process::Output;

use messages::{CycleRecord, Order};
use recorder::Recorder;
use recording::RecordingFile;
use scene::SceneFiles;
use serde_json::Value;
use testkit::{Place, scene_file};

use crate::{painted_scene, stderr, stdout, vpcctl};

/// Cycles of the recording.
const CYCLES: u64 = 4;

/// A recording of features on their way to the goal of the paper's scene.
fn recorded(place: &Place) -> PathBuf {
    let path = place.path("run.mcap");
    let files = SceneFiles::read(&scene_file()).unwrap();
    let goal: Vec<f64> = files.scene.goal_px().flatten().collect();
    let mut file = Recorder::create(&path, false).unwrap();
    file.describe(&files).unwrap();
    for k in 0..CYCLES {
        let mut cycle = CycleRecord {
            cycle: k + 1,
            features_sequence: k + 1,
            count: 4,
            overruns: k,
            step_ns: 30_000 + 17 * k,
            ..CycleRecord::default()
        };
        cycle.stamp.sequence = k + 1;
        cycle.stamp.data_ns = 1_000_000_000 + k * 33_333_333;
        cycle.stamp.published_ns = cycle.stamp.data_ns + 40_000;
        let away = 3.0 * (CYCLES - k) as f64;
        for (at, x) in goal.iter().enumerate() {
            cycle.points[at] = x + away;
        }
        cycle.error_px = away;
        file.take(&cycle, Order::Next).unwrap();
    }
    file.finish().unwrap();
    path
}

/// `plot`, which does not look at a domain.
fn run(words: &[&str]) -> Output {
    vpcctl(Path::new("/nonexistent"), words)
}

fn json(output: &Output) -> Value {
    serde_json::from_str(&stdout(output)).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

#[test]
fn a_recording_is_drawn_and_reported() {
    let place = Place::new();
    let file = recorded(&place).display().to_string();
    let plots = place.path("plots");
    let output = plots.to_str().unwrap();
    let drawn = run(&["plot", &file, "-o", output, "--film"]);
    assert_eq!(drawn.status.code(), Some(0), "{}", stderr(&drawn));
    let names = [
        "run.svg",
        "run.png",
        "run.gif",
        "latency.svg",
        "latency.png",
        "latency.txt",
        "latency.json",
    ];
    for name in names {
        let path = plots.join(name);
        assert!(stdout(&drawn).contains(&format!("wrote {}\n", path.display())));
        assert!(std::fs::metadata(&path).unwrap().len() > 500, "{name}");
    }
    for name in ["run.png", "latency.png"] {
        let bytes = std::fs::read(plots.join(name)).unwrap();
        assert!(bytes.starts_with(b"\x89PNG\r\n"), "{name}");
    }
    let report = json(&run(&["plot", &file, "--json"]));
    assert_rounded(&report);
    assert_eq!(report["cycles"], CYCLES, "{report}");
    assert_eq!(report["overruns"], 3, "{report}");
}

/// No number of a report has more digits than a clock in nanoseconds gives.
fn assert_rounded(report: &Value) {
    match report {
        Value::Number(number) => {
            let text = number.to_string();
            let digits = text.split_once('.').map_or(0, |(_, digits)| digits.len());
            assert!(digits <= 3, "{text}");
        }
        Value::Array(list) => list.iter().for_each(assert_rounded),
        Value::Object(map) => map.values().for_each(assert_rounded),
        _ => (),
    }
}

#[test]
fn a_changed_byte_or_cut_file_is_told_and_the_rest_is_used() {
    let place = Place::new();
    let mut bytes = std::fs::read(recorded(&place)).unwrap();
    let file = place.path("damaged.mcap");
    let name = file.to_str().unwrap();
    // Whether it is told; nothing else is said.
    let is_told = || {
        let output = run(&["plot", name]);
        let said = stderr(&output);
        let is_told = said.contains(&format!("{name}: cut short: "));
        assert!(is_told || said.is_empty(), "{said}");
        assert_eq!(output.status.code(), Some(0));
        is_told
    };
    let whole = bytes.len();
    std::fs::write(&file, &bytes[..whole * 2 / 3]).unwrap();
    assert!(is_told());
    // In the compressed messages: their checksum tells, also where the damage makes a message
    // unreadable before. A place in an index between them is not looked at.
    let mut told = 0;
    for part in 4..18 {
        bytes[whole * part / 20] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        bytes[whole * part / 20] ^= 1;
        told += u32::from(is_told());
    }
    assert!(told > 0);
}

/// Asserts that a command ended with this code, and said this among others.
fn assert_refused(output: &Output, code: i32, part: &str, words: &[&str]) {
    let said = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{words:?}: {said}");
    assert!(said.contains(part), "{words:?}: {said}");
}

#[test]
fn what_cannot_be_drawn_is_told_with_its_exit_code() {
    let place = Place::new();
    let run_file = recorded(&place).display().to_string();
    let text = "not MCAP at all, though long enough to be looked at";
    let text = place.file("text.mcap", text);
    let text = text.to_str().unwrap();
    let empty = place.path("empty.mcap");
    RecordingFile::create(&empty, true)
        .unwrap()
        .finish()
        .unwrap();
    let empty = empty.to_str().unwrap();
    let plots = place.path("plots");
    let plots = plots.to_str().unwrap();
    for (words, code, part) in [
        (
            &["plot", "/no/such.mcap"][..],
            66,
            "/no/such.mcap: cannot read the recording",
        ),
        (&["plot", text], 65, "not a recording"),
        (
            &["plot", empty, "-o", plots],
            65,
            "no scene in the recording",
        ),
        (
            &["plot", &run_file, "--scene", "/no/scene.toml"],
            66,
            "/no/scene.toml: cannot read",
        ),
        (&["plot"], 64, "FILE.mcap"),
    ] {
        let output = run(words);
        assert_refused(&output, code, part, words);
        assert!(stdout(&output).is_empty(), "{words:?}");
    }
}

#[test]
fn what_cannot_be_recorded_is_told_with_its_exit_code() {
    let directory = tempfile::tempdir().unwrap();
    let domain = directory.path().join("domain");
    let file = directory.path().join("run.mcap");
    let file = file.to_str().unwrap();
    let painted = painted_scene(directory.path());
    std::fs::remove_file(directory.path().join("ring.png")).unwrap();
    let painted = painted.to_str().unwrap();
    let wrong = directory.path().join("wrong.toml");
    std::fs::write(
        &wrong,
        scene::PAPER_SIM.replace("rate_hz = ", "rate_hz = -"),
    )
    .unwrap();
    let wrong = wrong.to_str().unwrap();
    let dear = directory.path().join("dear.mcap");
    std::fs::write(&dear, "dear to somebody").unwrap();
    let dear_words = dear.to_str().unwrap();
    for (words, code, part) in [
        (
            &["record", file, "--scene", "/no/scene.toml"][..],
            66,
            "/no/scene.toml: cannot read",
        ),
        (
            &["record", file, "--scene", wrong],
            65,
            "camera.rate_hz = -30",
        ),
        (
            &["record", file, "--scene", painted],
            65,
            "ring.png\": cannot read it",
        ),
        (
            &["record", dear_words, "--duration", "0.1"],
            64,
            "exists; allowed: a new file, or --force",
        ),
        (
            &["record", "/no/directory/run.mcap", "--duration", "0.1"],
            70,
            "cannot create the recording",
        ),
        (&["record", file, "--duration", "0"], 64, "0.05 to 86400"),
    ] {
        let output = vpcctl(&domain, words);
        assert_refused(&output, code, part, words);
    }
    assert_eq!(std::fs::read(&dear).unwrap(), b"dear to somebody");
    // Not even a domain was made, nor a file.
    assert!(!domain.exists() && !Path::new(file).exists());
}
