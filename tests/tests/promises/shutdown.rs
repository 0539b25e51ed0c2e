//! SIGTERM while the camera moves, at any phase of the cycle, once or twice: braking within the
//! limits, zero as the last command, exit code 0 within half a second.

use std::time::Duration;

use anyhow::ensure;
use ipc::now_ns;
use messages::{TwistCommand, TwistState};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{
    PERIOD_NS, Place, Running, Stage, Witness, assert_within_limits, eventually, is_still, repeats,
    some_time, speed, tell, turn,
};
use crate::stall::{fairly, in_time};

const BAR_NS: u64 = 500_000_000;
/// Largest loss of speed, as a share of the limits, in a period: 0.15 s from the limits to zero.
const STEEPEST: f64 = 1.0 / (0.15 * 30.0);

#[test]
fn sigterm_brakes_and_ends_with_zero_in_time() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut worst = 0;
    for round in 0..repeats("SIGTERM in motion", 6, 100) {
        let took = fairly(&format!("SIGTERM {round}"), || sigterm(round, &mut random));
        worst = worst.max(took);
    }
    tell(format!(
        "SIGTERM: ended after {} ms at most",
        worst / 1_000_000
    ));
}

/// One SIGTERM, or two, at a random phase of the cycle: how long until the end, ns.
fn sigterm(round: usize, random: &mut impl Rng) -> anyhow::Result<u64> {
    let Stage {
        place: _place,
        mut witness,
        daemon,
        camera,
    } = Stage::in_motion(round);
    some_time(4, random);
    let asked_ns = now_ns();
    daemon.signal(Signal::TERM);
    if round % 2 == 1 {
        some_time(1, random);
        daemon.signal(Signal::TERM);
    }
    let ended = daemon.ended();
    let ended_ns = now_ns();
    assert_eq!(ended.code, Some(0), "round {round}: {ended:?}");
    let took = in_time("ended", asked_ns, ended_ns, BAR_NS)?;
    camera.kill();
    ends_gently(&witness.commands())?;
    Ok(took)
}

/// Whether these commands are within the limits, lose speed no faster than braking does, and end
/// with zero.
fn ends_gently(commands: &[TwistCommand]) -> anyhow::Result<()> {
    let last = commands.last().expect("a last word");
    let ending = (last.state(), is_still(last));
    assert_eq!(ending, (Some(TwistState::Stopped), true), "{commands:?}");
    for pair in commands.windows(2) {
        assert_within_limits(&pair[0]);
        // Braking begins with the first command that is not the law's; without it the stop would be
        // one step.
        let is_slowing = matches!(
            pair[1].state(),
            Some(TwistState::Braking | TwistState::Disarmed | TwistState::Stopped)
        );
        if is_slowing {
            let lost = speed(&pair[0].twist) - speed(&pair[1].twist);
            // Each step lasts as long as it lasts; a late one may lose more.
            let elapsed = pair[1].stamp.published_ns - pair[0].stamp.published_ns;
            let most = STEEPEST * (elapsed as f64 / PERIOD_NS as f64).max(1.0);
            ensure!(lost <= most * 1.2, "{lost} > {most}: {commands:?}");
        }
    }
    Ok(())
}

#[test]
fn a_run_of_so_many_cycles_ends_as_gently() {
    let _turn = turn();
    fairly("--cycles", || {
        let place = Place::new();
        let mut witness = Witness::new(&place);
        let mut command = place.vpcd("");
        command.args(["--arm", "--cycles", "30"]);
        let camera = Running::start(place.hw_sim(0));
        let daemon = Running::start(command);
        witness.until("motion", |twist| speed(&twist.twist) > STEEPEST);
        let ended = daemon.ended();
        assert_eq!(ended.code, Some(0), "{ended:?}");
        camera.kill();
        ends_gently(&witness.commands())
    });
}

#[test]
fn sigterm_without_motion_ends_at_once() {
    let _turn = turn();
    fairly("SIGTERM at rest", || {
        let place = Place::new();
        let mut witness = Witness::new(&place);
        let daemon = Running::start(place.vpcd(""));
        eventually("a command", || witness.observer.twist.latest().unwrap());
        let asked_ns = now_ns();
        daemon.signal(Signal::TERM);
        assert_eq!(daemon.ended().code, Some(0));
        in_time("ended", asked_ns, now_ns(), BAR_NS)?;
        let last = witness.commands().pop().expect("a last word");
        assert_eq!(last.state(), Some(TwistState::Stopped));
        Ok(())
    });
}

#[test]
fn a_signal_during_start_up_ends_every_program() {
    ends_in_start_up("vpcd", &["--config", "controller/vpcd.toml"]);
    ends_in_start_up("hw-sim", &["--config", "hw-sim/hw-sim.toml"]);
    ends_in_start_up("vpcctl", &["serve", "--foxglove", "127.0.0.1:0"]);
    ends_in_start_up("vpcctl", &["serve", "--listen", "127.0.0.1:0"]);
}

#[test]
#[ignore = "needs vpc-camera"]
fn a_signal_during_start_up_ends_the_camera() {
    let scene = "ipc/scene/scenes/paper-robot.toml";
    ends_in_start_up("vpc-camera", &["--source", "shm", "--scene", scene]);
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
    let mut program = Running::start(program.current_dir(testkit::root()));
    std::thread::sleep(Duration::from_millis(500));
    assert!(program.is_running(), "{name} {words:?} does not wait");
    program.signal(Signal::TERM);
    let begin = std::time::Instant::now();
    let ended = program.ended();
    // The lock is waited for for 10 s.
    let took = begin.elapsed();
    assert!(
        took < Duration::from_secs(2),
        "{name} took {took:?}: {ended:?}"
    );
}
