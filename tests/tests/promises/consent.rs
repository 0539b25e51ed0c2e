//! After an unclean end nothing begins armed, until an operator arms: also across a start that
//! fails, a clean end without an operator, and a power cut. Only the first cycle of each process
//! counts, which no machine is too busy for. How the decision keeps a stop, and how long an armed
//! start waits, the simulation shows.

use std::fs::File;
use std::time::Duration;

use ipc::{CameraPorts, Domain, Observer, OperatorPorts};
use messages::{Action, Features, Hold, Outcome, Request, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{Ended, Place, Running, ended, eventually};

/// Features count for a second, so that they are good when the request comes.
const ARMED: &str =
    "[cycle]\nstale_periods = 30.0\n[safety]\narmed = true\nrobot = 'optional'\nlost_s = 10.0";

/// Starts the daemon, armed: the daemon, and why it is disarmed in its first cycle.
fn starts(place: &Place) -> (Running, Option<Hold>) {
    let domain = Domain::join(&place.domain()).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let daemon = Running::start(place.vpcd(ARMED));
    let first = eventually("a cycle", || observer.cycles.oldest().unwrap());
    assert_eq!(first.cycle, 1);
    let is_disarmed = first.state == TwistState::Disarmed.code();
    (daemon, first.hold().filter(|_| is_disarmed))
}

fn kill(daemon: Running) {
    daemon.signal(Signal::KILL);
    daemon.kill();
}

fn end(daemon: Running) {
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
}

/// A camera that stands, and an operator who arms.
fn arm(place: &Place) {
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut operator = OperatorPorts::open(&domain).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut id = ipc::now_ns();
    eventually("arming", || {
        let square = [
            [300.0, 300.0],
            [600.0, 300.0],
            [600.0, 600.0],
            [300.0, 600.0],
        ];
        let noisy = square.map(|p| p.map(|x: f64| x + random.random_range(-0.1..0.1)));
        let features = Features::new(&noisy, ipc::now_ns());
        camera.features.publish(&features).unwrap();
        id += 1;
        let request = Request::new(id, Action::Arm);
        let reply = operator
            .ask(&request, Duration::from_millis(200))
            .unwrap()?;
        (reply.outcome() == Some(Outcome::Done)).then_some(())
    });
}

#[test]
fn an_unclean_end_is_forgotten_by_an_operator_alone() {
    let place = Place::new();
    let (daemon, hold) = starts(&place);
    assert_eq!(hold, None, "armed, as the configuration wants it");
    kill(daemon);
    // A start that fails in between: its place is held, as by a process that hangs.
    let taken = File::open(place.domain().join("publishers/vpc-twist-1")).unwrap();
    taken.lock().unwrap();
    let Ended { code, stderr, .. } = ended(place.vpcd(ARMED));
    assert_eq!(code, Some(69), "{stderr}");
    drop(taken);
    let (daemon, hold) = starts(&place);
    assert_eq!(hold, Some(Hold::Unclean));
    // A clean end of one that nobody armed does not make it forgotten.
    end(daemon);
    let (daemon, hold) = starts(&place);
    assert_eq!(hold, Some(Hold::Unclean));
    arm(&place);
    end(daemon);
    let (daemon, hold) = starts(&place);
    assert_eq!(hold, None, "an operator has armed since");
    kill(daemon);
    // As a power cut does to /tmp and /run.
    for entry in std::fs::read_dir(place.domain()).unwrap().flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => std::fs::remove_dir_all(path).unwrap(),
            false => std::fs::remove_file(path).unwrap(),
        }
    }
    let (daemon, hold) = starts(&place);
    assert_eq!(hold, Some(Hold::Unclean));
    end(daemon);
}
