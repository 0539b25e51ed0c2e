//! `record` and `plot` as processes, on a run of the real daemon and the real emulator.

use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::sync::OnceLock;

use recording::{Recording, RecordingFile};
use serde_json::Value;
use testkit::python::{self, Environment, script};
use testkit::{Place, Running, ended, memory_file, program, root, scene_file, starts_file};

use crate::{painted_scene, stderr, stdout, vpcctl};

/// A recorded run.
struct Flight {
    /// What `record` printed at its end.
    summary: String,
    /// ... and meanwhile, to standard error.
    said: String,
    place: Place,
}

impl Flight {
    fn file(&self) -> PathBuf {
        self.place.path("run.mcap")
    }

    fn words(&self) -> String {
        self.file().display().to_string()
    }
}

/// Recorded once for all tests. A starved machine may lose messages, and says so: then once more.
fn flight() -> &'static Flight {
    static FLIGHT: OnceLock<Flight> = OnceLock::new();
    FLIGHT.get_or_init(|| {
        let complete = |flight: &Flight| {
            let recording = Recording::read(&flight.file()).unwrap();
            let first = recording.cycles.first().map(|cycle| cycle.cycle);
            !flight.summary.contains("lost") && first == Some(1)
        };
        let mut flights = (0..5).map(|_| fly());
        let flight = flights.find(complete);
        flight.expect("messages were lost each time")
    })
}

/// Three seconds of the paper's scene from its 82nd start under `gpr`; the recording is begun
/// before.
fn fly() -> Flight {
    let place = Place::new();
    let config = place.file(
        "vpcd.toml",
        format!(
            "scene = '{}'\nmemory = '{}'\n[law]\nstrategy = 'gpr'\nnp = 4\n",
            scene_file().display(),
            memory_file().display()
        ),
    );
    let with_domain = |program: PathBuf| {
        let mut command = testkit::command(program);
        command.arg("--domain").arg(place.domain());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let mut record = with_domain(env!("CARGO_BIN_EXE_vpcctl").into());
    record.arg("record").arg(place.path("run.mcap"));
    let mut vpcd = with_domain(program("vpcd"));
    vpcd.arg("--config").arg(&config).arg("--arm");
    let mut hw_sim = with_domain(program("hw-sim"));
    hw_sim.arg("--scene").arg(scene_file());
    hw_sim.arg("--starts").arg(starts_file());
    hw_sim.args(["--start", "82", "--time-limit", "3"]);

    let mut record = Running::start(&mut record);
    record.line("waiting for vpcd in domain");
    let vpcd = Running::start(vpcd);
    // 1: it has not arrived yet.
    let code = ended(hw_sim).code;
    assert!(code.is_some_and(|code| code <= 1), "{code:?}");
    assert_eq!(vpcd.terminated().code, Some(0));
    let recorded = record.terminated();
    assert_eq!(recorded.code, Some(0), "{}", recorded.stderr);
    Flight {
        summary: recorded.stdout,
        said: recorded.stderr,
        place,
    }
}

/// `plot`, which does not look at a domain.
fn run(words: &[&str]) -> Output {
    vpcctl(Path::new("/nonexistent"), words)
}

fn json(output: &Output) -> Value {
    serde_json::from_str(&stdout(output)).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

#[test]
fn a_run_is_recorded_as_others_count_it() {
    let flight = flight();
    let recording = Recording::read(&flight.file()).unwrap();
    let counts = [
        ("/vpc/features", recording.features.len()),
        ("/vpc/twist", recording.twist.len()),
        ("/vpc/robot", recording.robot.len()),
        ("/vpc/cycles", recording.cycles.len()),
    ];
    for (topic, count) in counts {
        // Three seconds at 30 Hz, and each message once, from the first to the last.
        assert!(count > 20, "{topic}: {count}");
        let words = format!(" {topic} {count}");
        assert!(
            flight.summary.contains(&words),
            "{words}: {}",
            flight.summary
        );
    }
    assert_eq!(Recording::missing(&recording.features), 0);
    assert_eq!(Recording::missing(&recording.twist), 0);
    assert_eq!(
        (&recording.cut, recording.config().is_some()),
        (&None, true)
    );
    assert_eq!(recording.scene_toml(), Some(scene::PAPER_SIM));
    assert!(
        flight.said.contains("recording: vpcd is running"),
        "{}",
        flight.said
    );
    let environment = Environment {
        name: "python-mcap",
        requirements: &["controller/recorder/tests/python/requirements.txt"],
        packages: &[],
    };
    if let Some(python) = environment.python("a_run_is_recorded_as_others_count_it") {
        let program = root().join("controller/recorder/tests/python/check.py");
        let mut check = script(&python, &program);
        let found = python::run(check.arg("values").arg(flight.file())).unwrap();
        let found: Vec<_> = found.lines().map(str::to_owned).collect();
        for (topic, count) in counts {
            let line = format!("count {topic} {count}");
            assert!(found.contains(&line), "{line}");
        }
        // The values, too: as many exact messages as were counted (`check.py` compares numbers and
        // stamps inside).
        let twists = found
            .iter()
            .filter(|line| line.starts_with("message /vpc/twist "));
        assert_eq!(twists.count(), counts[1].1);
    }
}

#[test]
fn a_recording_is_drawn_and_reported() {
    let flight = flight();
    let plots = Path::new(env!("CARGO_TARGET_TMPDIR")).join("plots");
    let _ = std::fs::remove_dir_all(&plots);
    let output = plots.to_str().unwrap();
    let drawn = run(&["plot", &flight.words(), "-o", output, "--film"]);
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
    let report = json(&run(&["plot", &flight.words(), "--json"]));
    assert_rounded(&report);
    let recording = Recording::read(&flight.file()).unwrap();
    assert_eq!(report["cycles"], recording.cycles.len() as u64, "{report}");
    assert_eq!(
        report["overruns"],
        recording.cycles.last().unwrap().overruns
    );
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
    let flight = flight();
    let mut bytes = std::fs::read(flight.file()).unwrap();
    let file = flight.place.path("damaged.mcap");
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
    for tenth in 4..9 {
        bytes[whole * tenth / 10] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        bytes[whole * tenth / 10] ^= 1;
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
    let flight = flight();
    let run_file = flight.words();
    let text = "not MCAP at all, though long enough to be looked at";
    let text = flight.place.file("text.mcap", text);
    let text = text.to_str().unwrap();
    let empty = flight.place.path("empty.mcap");
    RecordingFile::create(&empty, true)
        .unwrap()
        .finish()
        .unwrap();
    let empty = empty.to_str().unwrap();
    let plots = flight.place.path("plots");
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
