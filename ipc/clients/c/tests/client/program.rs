//! Programs in C, compiled with the header and linked with the shared library.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ipc::{ControllerPorts, Domain};
use messages::{Stamp, TwistCommand, TwistState};
use testkit::{Ended, Place, Running, eventually};

/// Steps in which the camera is driven to its goal.
const STEPS: u32 = 30;

/// The shared library, beside this executable.
pub fn library() -> PathBuf {
    let tests = std::env::current_exe().unwrap();
    tests.with_file_name("libvpcclient.so")
}

/// Compiles a source; warnings are errors.
pub fn compiled(place: &Place, source: &Path) -> PathBuf {
    let library = library();
    assert!(library.exists(), "{} is missing", library.display());
    testkit::c::compiled(place, source, &library)
}

/// Compiles an example.
pub fn example(place: &Place, name: &str) -> PathBuf {
    let source = testkit::root().join("ipc/clients/c/examples").join(name);
    compiled(place, &source)
}

/// Returns whether there is a compiler.
pub fn compiler(test: &str) -> bool {
    testkit::are_installed(test, &["cc=gcc"])
}

/// `camera.c` starts `start` away from its goal, which a constant twist reaches in [`STEPS`].
pub fn closes_the_loop(place: &Place, mut camera: Command, start: [f64; 6], twist: [f64; 6]) {
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    camera.arg(place.domain()).stdout(Stdio::piped());
    camera
        .arg((STEPS + 1).to_string())
        .args(start.map(|x| x.to_string()));
    let mut camera = Running::start(camera);
    let mut answered = 0;
    eventually("the end of the camera", || {
        if let Some(features) = controller.features.latest().unwrap() {
            // An answer to something else first: the camera must pass over it.
            let other = Stamp {
                published_ns: features.stamp.published_ns - 1,
                ..features.stamp
            };
            let wrong = TwistCommand::answer_to(&other, [9.0; 6], TwistState::Holding);
            controller.twist.publish(&wrong).unwrap();
            let answer = TwistCommand::answer(&features, twist, TwistState::Moving);
            controller.twist.publish(&answer).unwrap();
            answered += 1;
        }
        (!camera.is_running()).then_some(())
    });
    let Ended {
        code, stdout: text, ..
    } = camera.ended();
    let arrived = text.strip_prefix(&format!("{answered} steps, final error "));
    let arrived = arrived.unwrap_or_else(|| panic!("{answered} answers: {text}"));
    let error: f64 = arrived.split(' ').next().unwrap().parse().unwrap();
    // It stops where it is within 2 px, which is at most two steps early.
    assert!(code == Some(0) && error <= 2.0, "{text}");
    assert!((STEPS - 2..=STEPS).contains(&answered), "{text}");
    assert!(text.trim().ends_with("controller moving"), "{text}");
}
