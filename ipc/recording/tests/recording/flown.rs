//! A run of the real programs: recorded, drawn, replayed.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;

use recording::{Context, Recording, record};

use crate::fixture::{Place, Running, Stopping, eventually, scene_file};

/// A program of the workspace beside this test; `None`, loudly, where it was not built.
fn program(name: &str) -> Option<PathBuf> {
    let test = std::env::current_exe().unwrap();
    let path = test.parent().unwrap().parent().unwrap().join(name);
    if path.is_file() {
        return Some(path);
    }
    assert!(
        std::env::var_os("VPC_REQUIRE_PROGRAMS").is_none(),
        "{}: not built",
        path.display()
    );
    let message = format!(
        "the run with a real daemon was skipped: {} was not built\n",
        path.display()
    );
    let _ = std::io::Write::write_all(&mut std::io::stderr(), message.as_bytes());
    None
}

#[test]
fn a_run_of_daemon_and_emulator_is_recorded_drawn_and_replayed_bit_for_bit() {
    let (Some(vpcd), Some(hw_sim)) = (program("vpcd"), program("hw-sim")) else {
        return;
    };
    // A starved machine may lose messages, and says so: then once more.
    let complete = (0..5).any(|_| flown(&vpcd, &hw_sim));
    assert!(complete, "messages were lost each time");
}

/// Whether nothing was lost.
fn flown(vpcd: &Path, hw_sim: &Path) -> bool {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let place = Place::new();
    let config = place.0.path().join("vpcd.toml");
    let text = format!(
        "scene = \"{}\"\nmemory = \"{}\"\n[law]\nstrategy = \"gpr\"\nnp = 4\n",
        scene_file().display(),
        root.join("memory-blob/default/paper-sim.vpcmem").display()
    );
    std::fs::write(&config, text).unwrap();
    let context = Context::read(None, Some(&config)).unwrap();
    let stop = AtomicBool::new(false);
    let options = place.options();
    let ledger = std::thread::scope(|threads| {
        let recorder = threads.spawn(|| record(&options, &context, &stop, |_| ()));
        let stopped = Stopping(&stop);
        // The recorder makes the domain.
        eventually("the recorder", || {
            place.file().exists() && place.domain().exists()
        });
        let mut daemon = Running(
            Command::new(vpcd)
                .arg("--config")
                .arg(&config)
                .arg("--arm")
                .arg("--domain")
                .arg(place.domain())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
        let emulator = Command::new(hw_sim)
            .arg("--scene")
            .arg(scene_file())
            .arg("--starts")
            .arg(root.join("ipc/scene/scenes/paper-sim-starts.csv"))
            .args(["--start", "82", "--time-limit", "3"])
            .arg("--domain")
            .arg(place.domain())
            .output()
            .unwrap();
        assert!(
            emulator.status.code().is_some_and(|code| code <= 1),
            "{emulator:?}"
        );
        daemon.signal("-TERM");
        assert!(daemon.0.wait().unwrap().success());
        drop(stopped);
        recorder.join().unwrap().unwrap()
    });
    if ledger.total().lost > 0 {
        return false;
    }
    let recording = Recording::read(&place.file()).unwrap();
    assert!(recording.features.len() > 20 && recording.cycles.len() > 20);
    let first = &recording.cycles[0];
    if first.cycle != 1 {
        // The recorder came late.
        return false;
    }
    let drawn = recording::plot(&recording, None, &place.0.path().join("plots")).unwrap();
    assert!(
        drawn.iter().all(|file| file.is_file()) && drawn.len() == 6,
        "{drawn:?}"
    );

    let replay = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_vpc-replay"));
        let output = command
            .arg(place.file())
            .arg("--json")
            .args(words)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        (output.status.code().unwrap(), text)
    };
    let (code, text) = replay(&[]);
    assert_eq!(code, 0, "{text}");
    let found: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(found["equal"], recording.cycles.len() as u64, "{text}");
    assert!(found["steps"].as_u64().unwrap() > 15, "{text}");
    // Another law is told from this one.
    std::fs::write(
        &config,
        std::fs::read_to_string(&config).unwrap() + "margin_px = 9.0\n",
    )
    .unwrap();
    let (code, text) = replay(&["--config", config.to_str().unwrap()]);
    assert_eq!(code, 1, "{text}");
    true
}
