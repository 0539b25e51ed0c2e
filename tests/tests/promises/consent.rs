//! Nothing moves that nobody asked for: after an unclean end, after a long wait for camera and
//! robot, and after somebody else's stop.

use std::fs::File;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use messages::{Action, Hold, Outcome, TwistState};
use rustix::process::Signal;

use crate::fixture::{
    CAMERA_PRIORITY, EndOnDrop, Ended, PATIENCE, Place, Running, Stage, Witness, ended, eventually,
    is_still, program, turn,
};
use crate::machine::on_time;

/// More than the wait of an armed start for its peers.
const LONG: Duration = Duration::from_millis(6_500);
const ARMED: &str = "[safety]\narmed = true";

/// Starts a camera and the daemon, armed: the daemon, and why it is disarmed after its first
/// cycles. The camera ends with the function.
fn starts(place: &Place, witness: &mut Witness) -> (Running, Option<Hold>) {
    let _camera = Running::start(on_time(place.hw_sim(1), CAMERA_PRIORITY));
    eventually("a camera", || witness.observer.features.oldest().unwrap());
    witness.records();
    let daemon = Running::start(place.vpcd(ARMED));
    eventually("a first cycle", || {
        witness.observer.cycles.oldest().unwrap()
    });
    std::thread::sleep(Duration::from_millis(500));
    let record = witness.records().pop().expect("cycles");
    let hold = match TwistState::from_code(record.state) {
        Some(TwistState::Disarmed) => record.hold(),
        _ => None,
    };
    (daemon, hold)
}

fn kill(daemon: Running) {
    daemon.signal(Signal::KILL);
    daemon.kill();
}

#[test]
fn an_unclean_end_is_forgotten_by_an_operator_alone() {
    let _turn = turn();
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let (daemon, hold) = starts(&place, &mut witness);
    assert_eq!(hold, None, "armed, as the configuration wants it");
    kill(daemon);
    // A start that fails in between: its place is held, as by a process that hangs.
    let taken = File::open(place.domain().join("publishers/vpc-twist-1")).unwrap();
    taken.lock().unwrap();
    let Ended { code, stderr, .. } = ended(place.vpcd(ARMED));
    assert_eq!(code, Some(69), "{stderr}");
    drop(taken);
    let (daemon, hold) = starts(&place, &mut witness);
    assert_eq!(hold, Some(Hold::Unclean));
    // A clean end of one that nobody armed does not make it forgotten.
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    let (daemon, hold) = starts(&place, &mut witness);
    assert_eq!(hold, Some(Hold::Unclean));
    let camera = Running::start(on_time(place.hw_sim(1), CAMERA_PRIORITY));
    eventually("arming", || {
        (witness.ask(Action::Arm) == Outcome::Done).then_some(())
    });
    drop(camera);
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    let (daemon, hold) = starts(&place, &mut witness);
    assert_eq!(hold, None, "an operator has armed since");
    kill(daemon);
    // As a power cut does to /tmp and /run.
    drop(witness);
    for entry in std::fs::read_dir(place.domain()).unwrap().flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => std::fs::remove_dir_all(path).unwrap(),
            false => std::fs::remove_file(path).unwrap(),
        }
    }
    let mut witness = Witness::new(&place);
    let (_daemon, hold) = starts(&place, &mut witness);
    assert_eq!(hold, Some(Hold::Unclean));
}

#[test]
fn a_start_that_begins_armed_does_not_wait_for_ever() {
    let _turn = turn();
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let _daemon = Running::start(place.vpcd(ARMED));
    witness.until("a first command", |_| true);
    std::thread::sleep(LONG);
    let _camera = Running::start(on_time(place.hw_sim(1), CAMERA_PRIORITY));
    eventually("a camera", || witness.observer.features.oldest().unwrap());
    std::thread::sleep(Duration::from_millis(500));
    assert!(
        witness.commands().iter().all(is_still),
        "it moves for who came late"
    );
    witness.set_in_motion();
}

#[test]
fn a_loop_of_arm_does_not_undo_a_stop() {
    let _turn = turn();
    let mut stage = Stage::in_motion(1);
    let domain = stage.place.domain();
    let end = AtomicBool::new(false);
    std::thread::scope(|threads| {
        let _end = EndOnDrop(&end);
        let arms = threads.spawn(|| {
            let mut refused = 0;
            while !end.load(Ordering::Relaxed) {
                let mut vpcctl = testkit::command(program("vpcctl"));
                let arm = vpcctl.arg("--domain").arg(&domain).arg("arm");
                refused += u32::from(ended(arm).code == Some(2));
            }
            refused
        });
        std::thread::sleep(Duration::from_millis(200));
        ipc::stop(&domain, PATIENCE).unwrap();
        stage.witness.commands();
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_millis(1500) {
            std::thread::sleep(Duration::from_millis(50));
            let commands = stage.witness.commands();
            assert!(commands.iter().all(is_still), "the loop has won");
        }
        end.store(true, Ordering::Relaxed);
        assert!(arms.join().unwrap() > 0, "it was refused");
    });
    // The second step, by somebody who has looked.
    let arm = |stops: &str| {
        let mut vpcctl = testkit::command(program("vpcctl"));
        vpcctl.arg("--domain").arg(&domain);
        ended(vpcctl.args(["arm", "--stops", stops]))
    };
    assert_eq!(arm("7").code, Some(2));
    let Ended { stdout, stderr, .. } = arm("1");
    assert!(stdout.starts_with("arm: "), "{stdout}{stderr}");
    assert!(!stdout.contains("stopped since"), "{stdout}");
    // Somebody else's stop makes what he has seen old.
    ipc::stop(&domain, PATIENCE).unwrap();
    let Ended { code, stdout, .. } = arm("1");
    assert_eq!(code, Some(2), "{stdout}");
    assert!(stdout.contains("vpcctl arm --stops 2"), "{stdout}");
}
