//! `record`, `plot` and `replay` as processes, on a run of the real daemon and the real emulator.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use ipc::{Domain, Order};
use recording::{Context, Recording, RecordingFile};
use serde_json::Value;

use crate::{painted_scene, stderr, stdout, vpcctl};

#[path = "../../../recording/tests/python/mod.rs"]
mod python;

/// Longest wait for anything, on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(20);

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn paper_scene() -> PathBuf {
    root().join("ipc/scene/scenes/paper-sim.toml")
}

/// A program of the workspace, built in the profile of this test.
fn program(name: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        build.current_dir(root()).args(["build", "--quiet"]);
        build.args(["-p", "controller", "-p", "hw-sim", "-p", "recording"]);
        if !cfg!(debug_assertions) {
            build.arg("--release");
        }
        assert!(build.status().unwrap().success(), "the build failed");
    });
    Path::new(env!("CARGO_BIN_EXE_vpcctl")).with_file_name(name)
}

/// A process that ends with its owner.
struct Running(Child);

impl Running {
    fn start(command: &mut Command) -> Self {
        Self(command.spawn().unwrap())
    }

    /// Ends it by SIGTERM; what it printed.
    fn ended(mut self) -> Output {
        let id = self.0.id().to_string();
        let killed = Command::new("kill").args(["-TERM", &id]).status().unwrap();
        assert!(killed.success());
        let output = self.0.stdout.take().map(|mut output| {
            let mut text = Vec::new();
            std::io::Read::read_to_end(&mut output, &mut text).unwrap();
            text
        });
        Output {
            status: self.0.wait().unwrap(),
            stdout: output.unwrap_or_default(),
            stderr: Vec::new(),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A recorded run.
struct Flight {
    directory: tempfile::TempDir,
    /// What `record` said at its end.
    summary: String,
}

impl Flight {
    fn file(&self) -> PathBuf {
        self.directory.path().join("run.mcap")
    }

    fn words(&self) -> String {
        self.file().display().to_string()
    }

    fn config(&self) -> PathBuf {
        self.directory.path().join("vpcd.toml")
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
        let flights = (0..5).map(|_| flown());
        flights
            .into_iter()
            .find(complete)
            .expect("messages were lost each time")
    })
}

/// Three seconds of the paper's scene under `gpr`, recorded by `vpcctl record`.
fn flown() -> Flight {
    let directory = tempfile::tempdir().unwrap();
    let memory = root().join("memory-blob/default/paper-sim.vpcmem");
    let law = format!(
        "memory = '{}'\n[law]\nstrategy = 'gpr'\nnp = 4\n",
        memory.display()
    );
    fly(directory, &paper_scene(), &law, ["--time-limit", "3"], None)
}

/// A flight of the 82nd start; the recording is begun before, or so long after the daemon and the emulator.
fn fly(
    directory: tempfile::TempDir,
    scene: &Path,
    law: &str,
    camera: [&str; 2],
    begun_after: Option<Duration>,
) -> Flight {
    let domain = directory.path().join("domain");
    let config = directory.path().join("vpcd.toml");
    let text = format!("scene = '{}'\n{law}", scene.display());
    std::fs::write(&config, text).unwrap();
    let file = directory.path().join("run.mcap");
    let mut record = Command::new(env!("CARGO_BIN_EXE_vpcctl"));
    record.arg("--domain").arg(&domain).arg("record").arg(&file);
    record.arg("--config").arg(&config).stdout(Stdio::piped());
    let mut vpcd = Command::new(program("vpcd"));
    vpcd.arg("--config").arg(&config).arg("--arm");
    vpcd.arg("--domain").arg(&domain).stderr(Stdio::null());
    let mut hw_sim = Command::new(program("hw-sim"));
    hw_sim.arg("--scene").arg(scene).arg("--starts");
    hw_sim.arg(root().join("ipc/scene/scenes/paper-sim-starts.csv"));
    hw_sim.args(["--start", "82"]).args(camera);
    hw_sim.arg("--domain").arg(&domain).stdout(Stdio::null());

    let early = begun_after.is_none().then(|| {
        let record = Running::start(&mut record);
        // The file is made when all ports are open.
        let end = Instant::now() + PATIENCE;
        while !file.exists() {
            assert!(Instant::now() < end, "no recording is made");
            std::thread::sleep(Duration::from_millis(2));
        }
        record
    });
    let vpcd = Running::start(&mut vpcd);
    let mut emulator = Running::start(&mut hw_sim);
    let record = early.unwrap_or_else(|| {
        std::thread::sleep(begun_after.unwrap_or_default());
        Running::start(&mut record)
    });
    // 1: it has not arrived yet.
    let code = emulator.0.wait().unwrap().code();
    assert!(code.is_some_and(|code| code <= 1), "{code:?}");
    assert!(vpcd.ended().status.success());
    let recorded = record.ended();
    assert!(recorded.status.success());
    // Who joins and leaves alone clears away what is left in /dev/shm.
    drop(Domain::join(&domain));
    Flight {
        directory,
        summary: stdout(&recorded),
    }
}

/// `plot` or `replay`; neither looks at a domain.
fn run(words: &[&str]) -> Output {
    program("vpc-replay");
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
        (recording.cut, recording.config_toml.is_some()),
        (None, true)
    );
    if let Some(python) = python::python("a_run_is_recorded_as_others_count_it") {
        let found = python::check(&python, "values", &[&flight.file()]);
        for (topic, count) in counts {
            let line = format!("count {topic} {count}");
            assert!(found.contains(&line), "{line}");
        }
        // The values, too: as many exact messages as were counted (`check.py` compares numbers and stamps inside).
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
    let drawn = run(&["plot", &flight.words(), "-o", plots.to_str().unwrap()]);
    assert_eq!(drawn.status.code(), Some(0), "{}", stderr(&drawn));
    let names = [
        "run.svg",
        "run.png",
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
    let recording = Recording::read(&flight.file()).unwrap();
    assert_eq!(report["cycles"], recording.cycles.len() as u64, "{report}");
    assert_eq!(
        report["overruns"],
        recording.cycles.last().unwrap().overruns
    );
}

/// The same file but for the last bit of one number of one command.
fn one_ulp_changed(flight: &Flight, recording: &Recording, cycle: u64) -> PathBuf {
    let file = flight.directory.path().join("ulp.mcap");
    let context = Context::read(None, Some(&flight.config())).unwrap();
    let mut copy = RecordingFile::create(&file, true, &context).unwrap();
    for message in &recording.features {
        copy.features(message, Order::Next).unwrap();
    }
    for message in &recording.robot {
        copy.robot(message, Order::Next).unwrap();
    }
    for message in &recording.cycles {
        let mut message = *message;
        if message.cycle == cycle {
            message.twist[1] = f64::from_bits(message.twist[1].to_bits() ^ 1);
        }
        copy.cycle(&message, Order::Next).unwrap();
    }
    copy.finish().unwrap();
    file
}

#[test]
fn a_replay_finds_no_difference_and_one_ulp_where_there_is_one() {
    let flight = flight();
    let recording = Recording::read(&flight.file()).unwrap();
    let same = run(&["replay", &flight.words(), "--json"]);
    assert_eq!(same.status.code(), Some(0), "{}", stderr(&same));
    let found = json(&same);
    assert_eq!(found["different"], 0, "{found}");
    assert_eq!(found["equal"], recording.cycles.len() as u64, "{found}");
    assert!(found["steps"].as_u64().unwrap() > 15, "{found}");

    let moving = |cycle: &&ipc::CycleRecord| cycle.twist[1] != 0.0;
    let changed = recording.cycles.iter().find(moving).unwrap().cycle;
    let file = one_ulp_changed(flight, &recording, changed);
    let other = run(&["replay", file.to_str().unwrap(), "--json"]);
    assert_eq!(other.status.code(), Some(1), "{}", stderr(&other));
    let found = json(&other);
    assert_eq!(
        (&found["different"], &found["first"]["cycle"]),
        (&1.into(), &changed.into())
    );
    let words = run(&["replay", file.to_str().unwrap()]);
    assert_eq!(words.status.code(), Some(1));
    assert!(
        stdout(&words).contains(&format!("cycle {changed}")),
        "{}",
        stdout(&words)
    );
    let tolerant = run(&["replay", file.to_str().unwrap(), "--tolerance", "1e-12"]);
    assert_eq!(tolerant.status.code(), Some(0), "{}", stdout(&tolerant));
}

/// Recorded from its second second on, while the camera moved.
fn flown_late() -> Flight {
    let directory = tempfile::tempdir().unwrap();
    // A slow camera, that is under way for long.
    let scene = directory.path().join("slow.toml");
    let text = scene::PAPER_SIM.replace("linear = 0.5", "linear = 0.05");
    assert_ne!(text, scene::PAPER_SIM);
    std::fs::write(&scene, text).unwrap();
    let late = Duration::from_millis(1200);
    fly(directory, &scene, "", ["--time-limit", "6"], Some(late))
}

#[test]
fn a_recording_begun_while_the_camera_moves_is_compared_from_where_its_state_is_known() {
    let complete = |flight: &Flight| !flight.summary.contains("lost");
    let mut flights = (0..5).map(|_| flown_late());
    let flight = flights
        .find(complete)
        .expect("messages were lost each time");
    let recording = Recording::read(&flight.file()).unwrap();
    let first = &recording.cycles[0];
    assert!(first.cycle > 10 && first.twist != [0.0; 6], "{first:?}");

    let same = run(&["replay", &flight.words(), "--json"]);
    let found = json(&same);
    assert_eq!(same.status.code(), Some(0), "{}: {found}", stderr(&same));
    assert_eq!(
        (&found["different"], &found["missing_features"]),
        (&0.into(), &0.into())
    );
    assert_eq!(
        (&found["begins_at"], &found["equal"]),
        (&first.cycle.into(), &found["judged"])
    );
    let taken_over = &found["taken_over"][0];
    assert_eq!(taken_over["first"], first.cycle, "{found}");
    let last = taken_over["last"].as_u64().unwrap();
    assert!(last < first.cycle + 30, "{found}");
    assert!(found["judged"].as_u64().unwrap() > 30, "{found}");
    let words = stdout(&run(&["replay", &flight.words()]));
    let told = format!("not judged: cycles {} to {last}", first.cycle);
    assert!(words.contains(&told), "{words}");

    let file = one_ulp_changed(&flight, &recording, last + 5);
    let other = run(&["replay", file.to_str().unwrap(), "--json"]);
    let found = json(&other);
    assert_eq!(other.status.code(), Some(1), "{found}");
    assert_eq!(
        (&found["different"], &found["first"]["cycle"]),
        (&1.into(), &(last + 5).into())
    );

    // Of its first two cycles alone nothing can be said, and that is no difference.
    let mut short = recording;
    short.cycles.truncate(2);
    let file = one_ulp_changed(&flight, &short, 0);
    let short = run(&["replay", file.to_str().unwrap()]);
    assert_eq!(short.status.code(), Some(2), "{}", stdout(&short));
    assert!(stdout(&short).contains("nothing was compared"));
}

#[test]
fn one_changed_byte_and_a_cut_file_are_told_and_what_is_left_is_used() {
    let flight = flight();
    let mut bytes = std::fs::read(flight.file()).unwrap();
    let file = flight.directory.path().join("damaged.mcap");
    let name = file.to_str().unwrap();
    // Whether it is told, and the exit code; nothing else is said.
    let run = |words: &[&str]| {
        let output = run(words);
        let said = stderr(&output);
        let is_told = said.contains(&format!("{name}: cut short: "));
        assert!(is_told || said.is_empty(), "{words:?}: {said}");
        (is_told, output.status.code())
    };
    let whole = bytes.len();
    std::fs::write(&file, &bytes[..whole * 2 / 3]).unwrap();
    assert_eq!(run(&["plot", name]), (true, Some(0)));
    assert_eq!(run(&["replay", name]), (true, Some(0)));
    // In the compressed messages: their checksum tells, also where the damage makes a message unreadable before. A place
    // in an index between them is not looked at.
    let mut told = 0;
    for tenth in 4..9 {
        bytes[whole * tenth / 10] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        bytes[whole * tenth / 10] ^= 1;
        let (plot, replay) = (run(&["plot", name]), run(&["replay", name]));
        assert_eq!((plot.0, plot.1), (replay.0, Some(0)));
        // What was read before the checksum may differ.
        assert!(matches!(replay, (true, Some(0 | 1)) | (false, Some(0))));
        told += u32::from(plot.0);
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
fn what_cannot_be_drawn_or_replayed_is_told_with_its_exit_code() {
    let flight = flight();
    let directory = flight.directory.path();
    let run_file = flight.words();
    let text = directory.join("text.mcap");
    std::fs::write(&text, "not MCAP at all, though long enough to be looked at").unwrap();
    let text = text.to_str().unwrap();
    let empty = directory.join("empty.mcap");
    let file = RecordingFile::create(&empty, true, &Context::default()).unwrap();
    file.finish().unwrap();
    let empty = empty.to_str().unwrap();
    let robot = root().join("ipc/scene/scenes/paper-robot.toml");
    let robot = robot.to_str().unwrap();
    let plots = directory.join("plots");
    let plots = plots.to_str().unwrap();
    for (words, code, part) in [
        (
            &["plot", "/no/such.mcap"][..],
            66,
            "/no/such.mcap: cannot read the recording",
        ),
        (
            &["replay", "/no/such.mcap"],
            66,
            "/no/such.mcap: cannot read the recording",
        ),
        (&["plot", text], 65, "not a recording"),
        (&["replay", text], 65, "not a recording"),
        (
            &["plot", empty, "-o", plots],
            65,
            "no scene in the recording",
        ),
        (&["replay", empty], 65, "no cycles in the recording"),
        (
            &["plot", &run_file, "--scene", "/no/scene.toml"],
            66,
            "/no/scene.toml: cannot read",
        ),
        // The memory was built for the scene that was recorded.
        (
            &["replay", &run_file, "--scene", robot],
            65,
            "paper-sim.vpcmem",
        ),
        (
            &["replay", &run_file, "--tolerance", "11"],
            64,
            "allowed: 0 to 10",
        ),
        (&["plot"], 64, "FILE.mcap"),
    ] {
        let output = run(words);
        assert_refused(&output, code, part, words);
        assert!(stdout(&output).is_empty(), "{words:?}");
    }
}

#[test]
fn what_cannot_be_recorded_is_told_with_its_exit_code_and_disturbs_nobody() {
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
            &["record", file, "--config", "/no/vpcd.toml"],
            66,
            "/no/vpcd.toml: cannot read",
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
