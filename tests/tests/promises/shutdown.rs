//! SIGTERM during start-up ends each program. How `vpcd` brakes before it ends the simulation shows,
//! and how soon it ends `cargo xtask measure shutdown`.

use rustix::process::Signal;

use crate::fixture::{Place, Running, eventually};

#[test]
fn a_signal_during_start_up_ends_every_program() {
    ends_in_start_up("vpcd", &["--config", "controller/vpcd.toml"]);
    ends_in_start_up("hw-sim", &["--config", "hw-sim/hw-sim.toml"]);
    ends_in_start_up("vpcctl", &["serve", "--foxglove", "127.0.0.1:0"]);
    ends_in_start_up("vpcctl", &["serve", "--listen", "127.0.0.1:0"]);
}

/// A program that waits in its start-up, here for the domain's lock, ends at once.
fn ends_in_start_up(name: &str, words: &[&str]) {
    let place = Place::new();
    drop(ipc::Domain::join(&place.domain()).unwrap());
    let startup = std::fs::File::options()
        .write(true)
        .open(place.domain().join("startup"));
    let startup = startup.unwrap();
    startup.lock().unwrap();
    let mut program = testkit::command(testkit::program(name));
    program.arg("--domain").arg(place.domain()).args(words);
    let program = Running::start(program.current_dir(testkit::root()));
    // It has the file of the lock open.
    let files = format!("/proc/{}/fd", program.id());
    eventually("a program that waits", || {
        let files = std::fs::read_dir(&files).ok()?;
        let mut paths = files
            .map_while(Result::ok)
            .filter_map(|file| file.path().read_link().ok());
        paths.find(|path| path.ends_with("startup"))
    });
    program.signal(Signal::TERM);
    let ended = program.ended();
    // Whoever waits in vain, for 10 s, says so.
    assert!(
        !ended.stderr.contains("joining or leaving for"),
        "{name}: {ended:?}"
    );
}
