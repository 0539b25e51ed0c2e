//! The programs together, in lockstep: `vpcd` steers the emulator's camera, an operator arms it, and a
//! recorder listens.

use std::path::PathBuf;
use std::process::Stdio;

use messages::{Outcome, TwistState};
use recording::Recording;
use testkit::{Place, Running, eventually, program, scene_file, starts_file};

use crate::{stdout, vpcctl};

#[test]
fn an_armed_camera_arrives_and_its_run_is_recorded() {
    // Before anything runs: they may have to be built.
    let [vpcd, hw_sim] = ["vpcd", "hw-sim"].map(program);
    let place = Place::new();
    let start = |program: PathBuf, words: &[&str]| {
        let mut command = testkit::command(program);
        command.arg("--domain").arg(place.domain()).args(words);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Running::start(command)
    };
    let file = place.path("run.mcap");
    let scene = scene_file().display().to_string();
    let starts = starts_file().display().to_string();
    let config = place.file("vpcd.toml", "[safety]\narmed = false\n");
    let config = config.display().to_string();
    let vpcctl_program = PathBuf::from(env!("CARGO_BIN_EXE_vpcctl"));
    let mut record = start(vpcctl_program, &["record", file.to_str().unwrap()]);
    record.line("waiting for vpcd in domain");
    let mut vpcd = start(
        vpcd,
        &[
            "--config", &config, "--scene", &scene, "--clock", "lockstep",
        ],
    );
    vpcd.line("INFO scene ");
    // Its clock is the answers: as long as it is disarmed, hardly any of its hour is over.
    let hw_sim = start(
        hw_sim,
        &[
            "--scene",
            &scene,
            "--starts",
            &starts,
            "--start",
            "0",
            "--clock",
            "lockstep",
            "--time-limit",
            "3600",
        ],
    );
    eventually("arming", || {
        let said = vpcctl(&place.domain(), &["arm", "--timeout", "20"]);
        let done = stdout(&said).starts_with(&format!("arm: {}", Outcome::Done));
        done.then_some(())
    });
    let run = hw_sim.ended();
    assert_eq!(run.code, Some(0), "{run:?}");
    let daemon = vpcd.terminated();
    assert_eq!(daemon.code, Some(0), "{daemon:?}");
    let recorded = record.terminated();
    assert_eq!(recorded.code, Some(0), "{recorded:?}");
    let recording = Recording::read(&file).unwrap();
    assert!(recording.cut.is_none() && recording.config().is_some());
    assert_eq!(recording.scene_toml(), Some(scene::PAPER_SIM));
    let has = |state: TwistState| recording.cycles.iter().any(|r| r.state == state.code());
    assert!(has(TwistState::Disarmed) && has(TwistState::Moving));
    for (topic, count) in [
        ("/vpc/features", recording.features.len()),
        ("/vpc/twist", recording.twist.len()),
        ("/vpc/robot", recording.robot.len()),
        ("/vpc/cycles", recording.cycles.len()),
    ] {
        let words = format!(" {topic} {count}");
        assert!(
            count > 0 && recorded.stdout.contains(&words),
            "{words}: {}",
            recorded.stdout
        );
    }
}
