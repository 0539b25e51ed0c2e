//! When the daemon hangs, the emulated robot stops by itself; when it goes on after a gap in time,
//! it starts no motion. `controller/tests/service/{notify,namespace}.rs` test that the watchdog is
//! no longer fed, and what systemd does then.

use std::time::Duration;

use anyhow::ensure;
use ipc::now_ns;
use messages::{Hold, TwistState};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{PERIOD_NS, Stage, WAKE_NS, is_still, repeats, some_time, tell, turn};
use crate::stall::{fairly, in_time};

#[test]
fn a_hung_daemon_stops_the_robot_and_a_gap_disarms() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut worst = 0;
    for round in 0..repeats("SIGSTOP of vpcd in motion, for 2 s", 1, 20) {
        worst = worst.max(fairly(&format!("hang {round}"), || {
            hang(round, &mut random)
        }));
    }
    tell(format!(
        "hang: the robot stands after {} ms at most",
        worst / 1_000_000
    ));
}

/// One hang, at a random phase of the cycle: how long until the robot stood, ns.
fn hang(round: usize, random: &mut impl Rng) -> anyhow::Result<u64> {
    let Stage {
        place: _place,
        mut witness,
        daemon,
        mut camera,
    } = Stage::in_motion(round);
    some_time(4, random);
    daemon.signal(Signal::STOP);
    let stopped_ns = now_ns();
    let Some(stands_ns) = witness.until_it_stands(stopped_ns, &mut camera) else {
        tell(format!(
            "start {round}: the run was decided just then: {:?}",
            camera.ended()
        ));
        return hang(round + 1, random);
    };
    let took = in_time(
        "the robot stands",
        stopped_ns,
        stands_ns,
        100_000_000 + WAKE_NS,
    )?;
    std::thread::sleep(Duration::from_secs(2));
    witness.commands();
    let before = witness.records().last().map(|record| record.overruns);
    // The camera went on all the time: good features are there at once.
    daemon.signal(Signal::CONT);
    std::thread::sleep(Duration::from_nanos(10 * PERIOD_NS));
    let commands = witness.commands();
    ensure!(commands.len() > 5, "{commands:?}");
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
    // One overrun, of all that time, and the grid goes on.
    let missed: Vec<_> = before
        .into_iter()
        .chain(records.iter().map(|record| record.overruns))
        .collect();
    let steps: Vec<_> = missed.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let gaps: Vec<_> = steps.iter().filter(|missed| **missed > 0).collect();
    ensure!(
        gaps.len() == 1,
        "releases missed, cycle by cycle: {steps:?}"
    );
    assert!(*gaps[0] >= 60, "{steps:?}");
    Ok(took)
}
