//! A memory whose Gaussian process scikit-learn fitted (`memory-blob/python/fit_gpr.py`) steers:
//! `vpcd` reaches the goal with it from a start from which it does not without a memory. A damaged
//! copy is refused.

use std::path::Path;
use std::process::Stdio;

use memory_blob::MemoryFile;
use serde_json::Value;

use testkit::python::{Environment, run};
use testkit::{
    Ended, Place, Running, ended, memory_file, program, root, scene_file, starts_file, tell,
};

/// The demo's start: without a memory, the camera stays in front of an occlusion.
const START: &str = "74";

/// The daemon's answer to a memory.
fn judged(memory: &Path) -> Ended {
    let mut command = testkit::command(program("vpcd"));
    command
        .arg("--scene")
        .arg(scene_file())
        .arg("--memory")
        .arg(memory);
    ended(command.args(["--strategy", "gpr", "--check-only"]))
}

/// What the referee says of a run of both processes, in lockstep.
fn verdict(strategy: &str, memory: &Path) -> Value {
    let place = Place::new();
    let mut vpcd = testkit::command(program("vpcd"));
    vpcd.arg("--scene").arg(scene_file()).arg("--memory");
    vpcd.arg(memory).arg("--domain").arg(place.domain());
    vpcd.args(["--clock", "lockstep", "--strategy", strategy]);
    vpcd.stdout(Stdio::null()).stderr(Stdio::null());
    let _vpcd = Running::start(vpcd);
    let mut camera = testkit::command(program("hw-sim"));
    camera.arg("--scene").arg(scene_file()).arg("--starts");
    camera.arg(starts_file());
    camera.args(["--start", START, "--clock", "lockstep"]);
    let said = camera.arg("--domain").arg(place.domain()).output().unwrap();
    let verdict: Value = serde_json::from_slice(&said.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&said.stderr)));
    tell(format!(
        "start {START}, {strategy}, {}: {} after {} frames, clearance {:.2} px",
        memory.file_name().unwrap().display(),
        verdict["verdict"],
        verdict["frames"],
        verdict["least_clearance_px"].as_f64().unwrap(),
    ));
    verdict
}

#[test]
fn the_daemon_reaches_the_goal_with_a_process_of_scikit_learn() {
    let Some(python) = Environment::JUDGES.python("a process of scikit-learn") else {
        return;
    };
    let place = Place::new();
    let refit = place.path("refit.vpcmem");
    let mut fit = testkit::command(python);
    fit.arg(root().join("memory-blob/python/fit_gpr.py"))
        .arg(memory_file());
    tell(run(fit.arg(&refit)).unwrap().trim());

    assert_ne!(verdict("previous", &refit)["verdict"], "arrived");
    let with_it = verdict("gpr", &refit);
    assert_eq!(with_it["verdict"], "arrived", "{with_it}");
    // Another process than that of the builder: other commands, and so another run.
    let with_ours = verdict("gpr", &memory_file());
    assert_ne!(with_it["error_px"], with_ours["error_px"]);

    let good = std::fs::read(&refit).unwrap();
    assert_eq!(judged(&refit).code, Some(0));
    let header = 8 + u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    let layout: Value = serde_json::from_slice(&good[8..header]).unwrap();
    let tensors = layout.as_object().unwrap().iter();
    let fitted: Vec<_> = tensors
        .filter(|(name, _)| name.starts_with("gpr."))
        .collect();
    assert_eq!(fitted.len(), 6, "{layout}");
    for (name, tensor) in fitted {
        let at = header + tensor["data_offsets"][0].as_u64().unwrap() as usize;
        let mut bad = good.clone();
        bad[at] ^= 1;
        let said = judged(&place.file("bad.vpcmem", bad));
        assert_eq!(said.code, Some(65), "{name}: {said:?}");
        assert!(said.stderr.contains(name.as_str()), "{name}: {said:?}");
    }
    assert!(MemoryFile::open(&refit, None).is_ok());
}
