//! An interrupted or killed `vpc-memory build` goes on from its state, which belongs to that build
//! alone.

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

const SETTINGS: &str =
    "trajectories = 16\niterations = 30\nbatch = 2\nplanner = false\nregression.samples = 100\n";

fn vpc_memory(directory: &Path, line: &str) -> Command {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_vpc-memory"));
    command.args(line.split_whitespace()).current_dir(directory);
    command
}

fn build(directory: &Path, flags: &str) -> Command {
    let line = "build scene.toml -o own.vpcmem --settings settings.toml --threads 1 ";
    vpc_memory(directory, &format!("{line} {flags}"))
}

fn done(mut command: Command) -> Output {
    let output = command.output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{error}");
    output
}

/// Runs a build that has to be refused, and returns why.
fn refused(directory: &Path, flags: &str) -> String {
    let output = build(directory, flags).output().unwrap();
    assert!(!output.status.success());
    String::from_utf8(output.stderr).unwrap()
}

/// A directory with a scene and settings.
fn place() -> TempDir {
    let directory = TempDir::new().unwrap();
    fs::write(directory.path().join("scene.toml"), scene::PAPER_SIM).unwrap();
    fs::write(directory.path().join("settings.toml"), SETTINGS).unwrap();
    directory
}

/// Starts a build, and ends it by a signal once it has saved its first batch.
fn ended_by(directory: &Path, signal: Signal) -> std::process::ExitStatus {
    let mut worker = build(directory, "--checkpoint-s 0")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let (begun, partial) = (Instant::now(), directory.join("own.vpcmem.partial"));
    while !partial.exists() {
        assert!(begun.elapsed() < Duration::from_secs(60), "saves nothing");
        std::thread::sleep(Duration::from_millis(1));
    }
    kill_process(Pid::from_child(&worker), signal).unwrap();
    worker.wait().unwrap()
}

#[test]
fn a_build_resumes_after_ctrl_c_and_after_a_kill() {
    let place = place();
    let here = place.path();
    let (memory, partial) = (here.join("own.vpcmem"), here.join("own.vpcmem.partial"));
    done(build(here, ""));
    let whole = fs::read(&memory).unwrap();
    for (signal, code, number) in [
        (Signal::INT, Some(130), None),
        (Signal::TERM, Some(130), None),
        (Signal::KILL, None, Some(9)),
    ] {
        fs::remove_file(&memory).unwrap();
        let status = ended_by(here, signal);
        assert_eq!((status.code(), status.signal()), (code, number));
        assert!(!memory.exists() && partial.exists(), "{signal:?}");
        done(build(here, ""));
        assert!(fs::read(&memory).unwrap() == whole, "{signal:?}");
        assert!(!partial.exists(), "{signal:?}");
    }
}

#[test]
fn a_state_of_another_build_or_a_damaged_one_is_refused_by_name() {
    let place = place();
    let here = place.path();
    let partial = here.join("own.vpcmem.partial");
    ended_by(here, Signal::INT);
    let state = fs::read(&partial).unwrap();
    let expect = |message: String, words: &str| {
        let named = format!("own.vpcmem.partial: {words}");
        assert!(message.contains(&named), "{message}; expected: {named}");
    };

    expect(refused(here, "--seed 2"), "seed is 1; expected: 2");
    expect(refused(here, "--np 9"), "np is 10; expected: 9");
    // One comment more is another scene, though the task is the same.
    let commented = format!("# mine\n{}", scene::PAPER_SIM);
    fs::write(here.join("scene.toml"), commented).unwrap();
    expect(refused(here, ""), "checksum of the scene is ");
    fs::write(here.join("scene.toml"), scene::PAPER_SIM).unwrap();
    assert_eq!(fs::read(&partial).unwrap(), state, "a refusal changes it");

    for at in [30, 120, state.len() / 2, state.len() - 1] {
        let mut hurt = state.clone();
        hurt[at] ^= 1;
        fs::write(&partial, hurt).unwrap();
        expect(refused(here, ""), "damaged: its SHA-256 is ");
    }
    fs::write(&partial, &state[..state.len() - 1]).unwrap();
    expect(refused(here, ""), "damaged: its SHA-256 is ");
    fs::write(&partial, b"").unwrap();
    expect(refused(here, ""), "not the state of a build");

    fs::write(&partial, state).unwrap();
    done(build(here, ""));
}
