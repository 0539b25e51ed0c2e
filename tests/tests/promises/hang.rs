//! A daemon that hangs: the emulated robot stops by itself; a daemon that goes on after a gap in time starts no motion.
//! That the watchdog is no longer fed, and what systemd does then, is `controller/tests/service/{notify,namespace}.rs`.

use std::time::Duration;

use ipc::{Hold, TwistState, now_ns};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{PERIOD_NS, Stage, WAKE_NS, is_still, repeats, some_time, turn};

#[test]
fn when_the_daemon_hangs_the_robot_stops_and_a_gap_in_time_disarms() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for round in 0..repeats("SIGSTOP of vpcd in motion, for 2 s", 2, 20) {
        let Stage {
            place: _place,
            mut witness,
            daemon,
            camera: _camera,
        } = Stage::in_motion(round);
        some_time(4, &mut random);
        daemon.signal(Signal::STOP);
        let stopped_ns = now_ns();
        let took = witness.until_it_stands(stopped_ns) - stopped_ns;
        assert!(took <= 100_000_000 + WAKE_NS, "round {round}: {took} ns");
        std::thread::sleep(Duration::from_secs(2));
        witness.commands();
        witness.records();
        // The camera went on all the time: good features are there at once.
        daemon.signal(Signal::CONT);
        std::thread::sleep(Duration::from_nanos(10 * PERIOD_NS));
        let commands = witness.commands();
        assert!(commands.len() > 5, "{commands:?}");
        // The one on its way when the daemon was stopped may still say what was decided before.
        for twist in &commands[1..] {
            assert_eq!(
                (twist.state(), is_still(twist)),
                (Some(TwistState::Disarmed), true)
            );
        }
        let records = witness.records();
        let causes: Vec<_> = records
            .iter()
            .filter_map(|r| Hold::from_code(r.hold))
            .collect();
        assert!(causes.contains(&Hold::Standstill), "{causes:?}");
        // One gap, and the grid goes on.
        let steps: Vec<_> = records
            .windows(2)
            .map(|r| r[1].overruns - r[0].overruns)
            .collect();
        assert!(
            steps.iter().filter(|missed| **missed > 0).count() <= 1,
            "{steps:?}"
        );
    }
}
