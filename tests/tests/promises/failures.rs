//! Failures of the daemon, caused from outside: its processor is taken away again and again, the
//! memory answers out of range, the law has no answer for the features. The camera is braked within
//! its limits and stands until somebody arms it again, even if all is well from then on. A single
//! late cycle does not disarm.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use controller::clock::sleep_until;
use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain, now_ns};
use memory_blob::MemoryFile;
use messages::{CycleRecord, Features, Hold, RecallCode, SolverStatus, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Pid;
use scene::{Pose, Scene};

use crate::fixture::{
    CAMERA_PRIORITY, EndOnDrop, PERIOD_NS, Place, Running, Stage, Witness, assert_within_limits,
    is_still, not_run, root, speed, turn,
};
use crate::machine::{keep, may_be_real_time, on_time, processors, take_priority};

/// SCHED_FIFO priority above the daemon's 60.
const HOG_PRIORITY: i32 = 70;
/// Time in which a twist at the limits is braked to zero, ns.
const BRAKE_NS: f64 = 0.15e9;
/// More than two periods.
const HOG_NS: u64 = 80_000_000;
/// Cycles in a row with a failure after which the camera is stopped.
const IN_A_ROW: usize = 3;

/// Watches until the camera is disarmed, for this cause, and for a second more. Gives the records.
fn disarmed(witness: &mut Witness, cause: Hold) -> Vec<CycleRecord> {
    let commands = witness.until("disarming", |twist| {
        twist.state() == Some(TwistState::Disarmed)
    });
    commands.iter().for_each(assert_within_limits);
    std::thread::sleep(Duration::from_nanos(30 * PERIOD_NS));
    let after = witness.commands();
    assert!(after.len() > 5, "{after:?}");
    for twist in &after {
        let stands = (twist.state(), is_still(twist));
        assert_eq!(stands, (Some(TwistState::Disarmed), true), "{twist:?}");
    }
    let records = witness.records();
    let last = records.last().unwrap();
    assert_eq!(Hold::from_code(last.hold), Some(cause), "{last:?}");
    // From the first cycle with this cause on there is no other, and no motion but braking within
    // the limits.
    let first = records.iter().position(|r| r.hold == cause.code()).unwrap();
    let goes = [TwistState::Moving.code(), TwistState::Arrived.code()];
    for record in &records[first..] {
        assert!(
            record.hold == cause.code() && !goes.contains(&record.state),
            "{record:?}"
        );
    }
    let decided_ns = |record: &CycleRecord| record.stamp.data_ns + record.receive_ns;
    for pair in records[first.saturating_sub(1)..].windows(2) {
        let lost = speed(&pair[0].twist) - speed(&pair[1].twist);
        let elapsed_ns = decided_ns(&pair[1]) - decided_ns(&pair[0]);
        assert!(lost <= elapsed_ns as f64 / BRAKE_NS + 1e-9, "{pair:?}");
    }
    records
}

/// Takes this processor away, for so long that a release is missed wherever it falls.
fn hog(processor: usize) {
    keep(None, processor);
    assert!(take_priority(HOG_PRIORITY));
    let end = now_ns() + HOG_NS;
    while now_ns() < end {
        std::hint::spin_loop();
    }
}

#[test]
fn a_loop_that_is_late_repeatedly_disarms() {
    let _turn = turn();
    let (Some(&processor), true) = (processors().get(1), may_be_real_time()) else {
        return not_run(
            "overruns",
            "needs two processors and the right to real time",
        );
    };
    let Stage {
        place: _place,
        mut witness,
        daemon,
        camera: _camera,
    } = Stage::in_motion(0);
    // The loop is the process's first thread.
    keep(Pid::from_raw(daemon.id() as i32), processor);
    witness.records();
    let missed = |records: &[CycleRecord]| records.last().unwrap().overruns;

    // Once: releases are missed, and the camera goes on.
    std::thread::scope(|threads| {
        threads.spawn(|| hog(processor));
    });
    std::thread::sleep(Duration::from_nanos(6 * PERIOD_NS));
    let once = witness.records();
    assert!(missed(&once) >= 1, "{once:?}");
    let states: Vec<_> = once.iter().map(|record| record.state).collect();
    assert!(!states.contains(&TwistState::Disarmed.code()), "{states:?}");
    witness.commands();

    // Again and again.
    let before = missed(&once);
    let records = std::thread::scope(|threads| {
        threads.spawn(|| {
            for _ in 0..10 {
                let hog = std::thread::spawn(move || hog(processor));
                hog.join().unwrap();
                sleep_until(now_ns() + 10_000_000);
            }
        });
        disarmed(&mut witness, Hold::Overruns)
    });
    let first = records
        .iter()
        .position(|record| record.hold == Hold::Overruns.code())
        .unwrap();
    let overruns: Vec<u64> = std::iter::once(before)
        .chain(records[..=first].iter().map(|record| record.overruns))
        .collect();
    let late = overruns.windows(2).filter(|pair| pair[1] > pair[0]).count();
    assert!((IN_A_ROW..3 * IN_A_ROW).contains(&late), "{overruns:?}");
    // It is armed again, and moves.
    witness.set_in_motion();
}

#[test]
fn an_answer_out_of_range_falls_back_to_the_neighbour() {
    let _turn = turn();
    let place = Place::new();
    // Right in its form, digests and probes, and far from any trajectory: weights a thousand times
    // too large.
    let shipped = root().join("memory-blob/default/paper-sim.vpcmem");
    let mut contents = MemoryFile::open(&shipped, None).unwrap().contents();
    let process = contents.regression.as_mut().unwrap();
    process
        .lambda
        .iter_mut()
        .flatten()
        .for_each(|weight| *weight *= 1e3);
    let wrong = place.path("wrong.vpcmem");
    contents.write(&wrong).unwrap();

    let mut witness = Witness::new(&place);
    // Asked in every cycle, near occlusions or not.
    let more = format!(
        "memory = '{}'\n[law]\nstrategy = 'gpr'\ntrigger_px = 1e4",
        wrong.display()
    );
    let _daemon = Running::start(place.vpcd(&more));
    let _camera = Running::start(on_time(place.hw_sim(0), CAMERA_PRIORITY));
    witness.set_in_motion();
    witness.records();
    std::thread::sleep(Duration::from_nanos(20 * PERIOD_NS));
    let records = witness.records();
    let count = |code: RecallCode| {
        let is_it = |record: &&CycleRecord| record.recalled == code.code();
        records.iter().filter(is_it).count()
    };
    assert!(count(RecallCode::Replaced) > 10, "{records:?}");
    let others = count(RecallCode::Followed) + count(RecallCode::Refused);
    assert_eq!(others, 0, "{records:?}");
    let disarmed = TwistState::Disarmed.code();
    assert!(records.iter().all(|record| record.state != disarmed));
}

#[test]
fn features_for_which_the_law_has_no_answer_brake_and_disarm() {
    let _turn = turn();
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let _daemon =
        Running::start(place.vpcd("[law]\nstrategy = 'ibvs'\n[safety]\nrobot = 'optional'"));
    let (ended, flattened) = (AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|threads| {
        let _end = EndOnDrop(&ended);
        threads.spawn(|| {
            take_priority(CAMERA_PRIORITY);
            let domain = Domain::join(&place.domain()).unwrap();
            let mut camera = CameraPorts::open(&domain).unwrap();
            let mut random = ChaCha8Rng::seed_from_u64(1);
            let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
            let far = Pose {
                translation: [0.1, 0.0, 3.2],
                rotation: [0.0; 3],
            };
            let mut eye = FreeCamera::new(&scene, &far);
            let mut twist = [0.0; 6];
            while !ended.load(Ordering::Relaxed) {
                eye.advance(&twist, PERIOD_NS as f64 * 1e-9);
                if let Some(newest) = camera.twist.latest().unwrap() {
                    twist = newest.message.twist;
                }
                let mut points = eye.features().unwrap();
                if flattened.load(Ordering::Relaxed) {
                    // Seen as a line, nearly: the interaction matrix is singular.
                    let middle = points.iter().map(|p| p[1]).sum::<f64>() / points.len() as f64;
                    let heights = points.iter_mut().map(|p| &mut p[1]);
                    heights.for_each(|v| *v = middle + 0.01 * (*v - middle));
                }
                // Not the last bit stays: the daemon would take the image for frozen.
                let shift = random.random_range(-0.1..0.1);
                points.iter_mut().for_each(|p| p[0] += shift);
                let features = Features::new(&points, now_ns());
                camera.features.publish(&features).unwrap();
                std::thread::sleep(Duration::from_nanos(PERIOD_NS));
            }
        });
        witness.set_in_motion();
        witness.until("speed", |twist| speed(&twist.twist) > 0.7);
        witness.records();
        flattened.store(true, Ordering::Relaxed);
        let records = disarmed(&mut witness, Hold::Solver);
        let failed: Vec<_> = records
            .iter()
            .filter(|record| record.status == SolverStatus::NumericalFailure.code())
            .collect();
        assert!(failed.len() >= IN_A_ROW, "{records:?}");
        // The first time already: no jump to the zero of a law that has no answer.
        let hold = Hold::from_code(failed[0].hold);
        assert!(
            hold == Some(Hold::Solver) && speed(&failed[0].twist) > 0.3,
            "{:?}",
            failed[0]
        );
        flattened.store(false, Ordering::Relaxed);
        witness.set_in_motion();
    });
}
