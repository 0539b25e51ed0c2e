//! Markers of another family: `hw-sim` renders them, `vpc-camera` finds them, and `vpcd` brings the
//! camera to the goal, in lockstep.

use std::path::Path;
use std::process::Stdio;

use testkit::{PATIENCE, Place, Running, program, root, tell};

const FAMILY: &str = "DICT_4X4_50";

#[test]
fn a_camera_arrives_by_aruco_markers() {
    let place = Place::new();
    let scene = root().join("ipc/scene/scenes/tags-robot.toml");
    let scene = scene.display();
    // Without a memory, which takes minutes in a debug build: the law alone, from a near start.
    let law = "[law]\nstrategy = \"previous\"\nstep_s = 0.4\niterations = 10\ntolerance = 1e-6\nmargin_px = 8.0";
    let law = place.file("vpcd.toml", format!("scene = '{scene}'\n{law}\n"));
    let begin = |name: &str, configuration: &Path, words: &[&str]| {
        let mut command = testkit::command(program(name));
        command
            .arg("--config")
            .arg(configuration)
            .arg("--domain")
            .arg(place.domain());
        command.args(["--clock", "lockstep"]).args(words);
        Running::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()))
    };
    let _daemon = begin("vpcd", &law, &[]);
    let shipped = root().join("ipc/clients/camera/vpc-camera.toml");
    let _camera = begin("vpc-camera", &shipped, &["--family", FAMILY]);
    let shipped = root().join("hw-sim/hw-sim-tags.toml");
    let told = begin("hw-sim", &shipped, &["--family", FAMILY, "--start", "0"]);
    let told = told.ended_within(6 * PATIENCE);
    tell(format_args!("{}{}", told.stdout, told.stderr));
    assert!(told.stdout.contains("\"verdict\":\"arrived\""), "{told:?}");
}
