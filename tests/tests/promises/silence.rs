//! A camera that freezes, goes silent, pauses, or dies: the daemon brakes within three periods of the last features,
//! stands within 300 ms, and stays so until somebody arms it again.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ipc::{Action, CameraPorts, Domain, Features, Outcome, TwistCommand, TwistState, now_ns};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{
    EndOnDrop, PERIOD_NS, Place, Running, Stage, WAKE_NS, Witness, assert_within_limits,
    eventually, is_still, repeats, some_time, turn,
};

const BRAKING_NS: u64 = 3 * PERIOD_NS;
const ZERO_NS: u64 = 300_000_000;

/// The features of a camera that is far from the goal and does not move: the law always wants to.
const FAR: [[f64; 2]; 4] = [
    [250.0, 250.0],
    [420.0, 260.0],
    [410.0, 430.0],
    [240.0, 420.0],
];

/// What goes wrong with a camera.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// It sends one exposure again and again.
    Freeze,
    /// It sends nothing more.
    Silence,
    /// It pauses for 0.4 s and goes on.
    Pause,
    /// It sends exposures that are older than those before.
    Older,
    /// It loses sight of one point.
    Hidden,
}

/// Asserts what must follow the last good features.
fn assert_stops(commands: &[TwistCommand], last_good_ns: u64, what: &str) {
    let after = |twist: &&TwistCommand| twist.stamp.published_ns > last_good_ns;
    let since = |twist: &TwistCommand| twist.stamp.published_ns - last_good_ns;
    let moves = |twist: &TwistCommand| {
        matches!(
            twist.state(),
            Some(TwistState::Moving | TwistState::Arrived)
        )
    };
    commands.iter().for_each(assert_within_limits);
    let last_of_the_law = commands
        .iter()
        .filter(after)
        .filter(|twist| moves(twist))
        .map(since)
        .max();
    // The last command of the law stands until the next one replaces it.
    let braking = commands
        .iter()
        .filter(after)
        .find(|twist| !moves(twist))
        .map(since);
    let braking = braking.unwrap_or_else(|| panic!("{what}: it never brakes: {commands:?}"));
    assert!(
        braking <= BRAKING_NS + WAKE_NS && last_of_the_law.unwrap_or(0) <= BRAKING_NS + WAKE_NS,
        "{what}: brakes after {braking} ns; the law's last: {last_of_the_law:?} ns"
    );
    let zero = commands
        .iter()
        .filter(after)
        .find(|twist| is_still(twist))
        .map(since);
    let zero = zero.unwrap_or_else(|| panic!("{what}: it never stands"));
    assert!(zero <= ZERO_NS + WAKE_NS, "{what}: stands after {zero} ns");
    let moves_again = |twist: &TwistCommand| since(twist) > zero && !is_still(twist);
    assert!(
        !commands.iter().filter(after).any(moves_again),
        "{what}: {commands:?}"
    );
}

/// A camera that works until it is told to fail, then fails, and after `over` works again.
fn film(place: &Path, fault: Fault, fail: &AtomicBool, over: &AtomicBool, end: &AtomicBool) -> u64 {
    let domain = Domain::join(place).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let (mut last_good_ns, mut exposure_ns) = (0, 0);
    let mut paused = false;
    while !end.load(Ordering::Relaxed) {
        let is_failing = fail.load(Ordering::Relaxed) && !over.load(Ordering::Relaxed);
        let mut features = Features::new(&FAR, now_ns());
        match fault {
            Fault::Freeze if is_failing => features.stamp.data_ns = exposure_ns,
            Fault::Older if is_failing => features.stamp.data_ns = exposure_ns - 1,
            Fault::Hidden if is_failing => features.visible = 0b1011,
            Fault::Pause if is_failing && !paused => {
                std::thread::sleep(Duration::from_millis(400));
                paused = true;
                features = Features::new(&FAR, now_ns());
            }
            _ => (),
        }
        if !(is_failing && matches!(fault, Fault::Silence)) {
            let sent = camera.features.publish(&features).unwrap();
            if !fail.load(Ordering::Relaxed) {
                (last_good_ns, exposure_ns) = (sent.published_ns, features.stamp.data_ns);
            }
        }
        std::thread::sleep(Duration::from_nanos(PERIOD_NS));
    }
    last_good_ns
}

#[test]
fn a_camera_that_fails_is_met_with_brakes_and_a_disarmed_controller() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for fault in [
        Fault::Freeze,
        Fault::Silence,
        Fault::Pause,
        Fault::Older,
        Fault::Hidden,
    ] {
        for _ in 0..repeats(&format!("{fault:?}"), 2, 20) {
            let place = Place::new();
            let mut witness = Witness::new(&place);
            let _daemon = Running::start(place.vpcd(""));
            let (fail, over, end) = Default::default();
            let (commands, last_good_ns) = std::thread::scope(|threads| {
                let _end = EndOnDrop(&end);
                let camera = threads.spawn(|| film(&place.domain(), fault, &fail, &over, &end));
                witness.set_in_motion();
                some_time(6, &mut random);
                fail.store(true, Ordering::Relaxed);
                let mut commands = witness.until("a controller that gave up", |twist| {
                    twist.state() == Some(TwistState::Disarmed)
                });
                over.store(true, Ordering::Relaxed);
                // Good features alone do not set it in motion.
                std::thread::sleep(Duration::from_nanos(8 * PERIOD_NS));
                commands.extend(witness.commands());
                assert!(commands.len() > 6, "{commands:?}");
                assert_eq!(witness.ask(Action::Arm), Outcome::Done);
                witness.set_in_motion();
                end.store(true, Ordering::Relaxed);
                (commands, camera.join().unwrap())
            });
            assert_stops(&commands, last_good_ns, &format!("{fault:?}"));
        }
    }
}

#[test]
fn a_camera_that_dies_or_hangs_is_met_with_brakes() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for round in 0..repeats("kill -9 and SIGSTOP of the camera", 10, 100) {
        let Stage {
            place: _place,
            mut witness,
            daemon: _daemon,
            camera,
        } = Stage::in_motion(round);
        some_time(6, &mut random);
        camera.signal(if round % 2 == 0 {
            Signal::KILL
        } else {
            Signal::STOP
        });
        let last_good_ns = eventually("the last features", || Some(witness.newest_features_ns()));
        let commands = witness.until("a controller that gave up", |twist| {
            twist.state() == Some(TwistState::Disarmed)
        });
        assert_stops(&commands, last_good_ns, &format!("round {round}"));
    }
}
