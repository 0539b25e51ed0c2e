//! From wake to send the loop costs nothing but time: no page fault, no call that blocks, no call
//! of the heap, in thousands of cycles that steer (18,000 with `VPC_LONG=1`), with every strategy
//! and the shipped memory.
//!
//! The daemon itself counts, by RUSAGE_THREAD and its counting allocator, and writes the sums into
//! its report; the unit tests of `controller::usage` and `heap_meter` check that both count. Every
//! thousand cycles the test asks the kernel to take the daemon's memory away, as the kernel does by
//! itself when memory is short: what is not locked must be faulted in again.
//! `VPC_WITHOUT=realtime` runs the daemon without locked memory, to see the test fail.

use std::process::Stdio;
use std::time::Duration;

use controller::report::Report;
use rustix::process::Signal;
use scene::Scene;

use crate::camera::Camera;
use crate::fixture::{
    Place, Running, memory_file, not_run, program, repeats, scene_file, tell, turn,
};
use crate::machine::{is_without, may_be_real_time, press_out};

/// Most runs of one strategy.
const TRIALS: usize = 4;
/// Cycles between two attempts of the kernel to take the daemon's memory.
const PRESS: u64 = 1000;
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// A run of the daemon against a camera in lockstep, as fast as both can.
fn run(strategy: &str, cycles: u64) -> Report {
    let place = Place::new();
    let realtime = match is_without("realtime") {
        true => "",
        false => "[realtime]\npriority = 80\ncpu = 0\n",
    };
    // What foresight finds does not matter here.
    let law = "[law]\nforesight_steps = 30\n";
    let config = place.file("vpcd.toml", format!("{realtime}{law}"));
    let report = place.path("report.json");
    let mut daemon = testkit::command(program("vpcd"));
    daemon.arg("--config").arg(config);
    daemon.arg("--scene").arg(scene_file());
    daemon.arg("--memory").arg(memory_file());
    daemon.args(["--clock", "lockstep", "--strategy", strategy]);
    daemon.arg("--domain").arg(place.domain());
    daemon.arg("--report").arg(&report);
    let scene = Scene::read(&scene_file()).unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let mut camera = Camera::new(&scene, &starts, &place.domain()).in_lockstep();
    let daemon = Running::start(daemon.stderr(Stdio::null()));
    // And those in which the camera has just jumped, and shows nothing.
    for cycle in 0..Report::WARM_UP + cycles + cycles / 20 {
        if cycle % PRESS == PRESS / 2 {
            press_out(daemon.id());
        }
        let sent = camera.show();
        let answer = camera.ports.wait_for_answer(&sent, PATIENCE).unwrap();
        camera.obey(&answer.expect("an answer within ten seconds"));
    }
    // While the camera is there: its leaving is no part of the promise.
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    let text = std::fs::read_to_string(report).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// A run of which all cycles are told. Lockstep is as fast as it can be, faster than an ordinary
/// thread that a busy machine keeps from its records for half a second: such a run cannot tell, and
/// is tried again.
fn whole(strategy: &str, cycles: u64) -> Report {
    for _ in 1..TRIALS {
        let report = run(strategy, cycles);
        if report.lost_records == 0 {
            return report;
        }
        tell(format!(
            "VOID, tried again: faultless, {strategy}: {} records lost",
            report.lost_records
        ));
    }
    run(strategy, cycles)
}

#[test]
fn from_wake_to_send_nothing_faults_blocks_or_allocates() {
    let _turn = turn();
    if !may_be_real_time() {
        return not_run("faultless", "no right to real time (vpcd --preflight)");
    }
    // They steer, after those in which the peers are met.
    let cycles = repeats("faultless, cycles of each strategy", 2_000, 18_000) as u64;
    for strategy in ["previous", "knn", "gpr", "foresight", "ibvs"] {
        let report = whole(strategy, cycles);
        tell(format!(
            "faultless: {strategy}: {} cycles, {} with the memory, {} + {} faults, {} blocked, {} heap calls, busy p99 {} us",
            report.armed,
            report.recalled,
            report.minor_faults,
            report.major_faults,
            report.blocked,
            report.allocations,
            report.busy_ns.p99 / 1000
        ));
        let found = format!("{strategy}: {report:#?}");
        // Zero is not for want of work, or of counting.
        assert!(
            report.armed >= cycles && report.lost_records == 0,
            "{found}"
        );
        let has_memory = ["knn", "gpr", "foresight"].contains(&strategy);
        // Foresight follows a sample in few cycles: it refines its way.
        let few = match strategy {
            "foresight" => 0,
            _ => cycles / 200,
        };
        assert_eq!(report.recalled > few, has_memory, "{found}");
        let faults = (report.minor_faults, report.major_faults);
        assert_eq!(
            (faults, report.blocked, report.allocations),
            ((0, 0), 0, 0),
            "{found}"
        );
        if !is_without("realtime") {
            assert_eq!(report.realtime, 1, "{found}");
        }
    }
}
