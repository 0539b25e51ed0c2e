//! From wake to send the loop costs nothing but time: no page fault, no call that blocks, no call
//! of the heap, in thousands of cycles that steer, with every strategy and the shipped memory.
//!
//! The daemon itself counts, by RUSAGE_THREAD and its counting allocator, and writes the sums into
//! its report; the unit tests of `controller::usage` and `heap_meter` check that both count. Every
//! thousand cycles the kernel is asked to take the daemon's memory away, as it does by itself when
//! memory is short: what is not locked must be faulted in again. `VPC_WITHOUT=realtime` runs the
//! daemon without locked memory, to see this break.

use std::os::fd::AsRawFd;
use std::process::Stdio;
use std::time::Duration;

use controller::report::Report;
use rustix::process::Signal;
use scene::Scene;

use crate::camera::Camera;
use crate::fixture::{Place, Running, memory_file, program, scene_file};
use crate::machine::{is_without, may_be_real_time, processors};
use crate::sheet::Sheet;

/// Cycles between two attempts of the kernel to take the daemon's memory.
const PRESS: u64 = 1000;
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// A way of the law.
#[derive(Clone, Copy, Debug)]
pub struct Strategy {
    pub name: &'static str,
    word: &'static str,
    /// Least share of the cycles that ask the memory, and most.
    asks: [f64; 2],
}

/// Foresight follows a sample in few cycles: it refines its way.
pub const STRATEGIES: [Strategy; 5] = [
    Strategy {
        name: "faultless previous",
        word: "previous",
        asks: [0.0, 0.0],
    },
    Strategy {
        name: "faultless knn",
        word: "knn",
        asks: [0.005, 1.0],
    },
    Strategy {
        name: "faultless gpr",
        word: "gpr",
        asks: [0.005, 1.0],
    },
    Strategy {
        name: "faultless foresight",
        word: "foresight",
        asks: [1e-9, 1.0],
    },
    Strategy {
        name: "faultless ibvs",
        word: "ibvs",
        asks: [0.0, 0.0],
    },
];

/// A run of the daemon against a camera in lockstep, as fast as both can.
fn run(strategy: &str, cycles: u64) -> Report {
    let place = Place::new();
    let realtime = match is_without("realtime") {
        true => String::new(),
        false => format!("[realtime]\npriority = 80\ncpu = {}\n", processors()[0]),
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

/// Measures with this strategy.
pub fn measure(strategy: Strategy, sheet: &mut Sheet) {
    if !may_be_real_time() {
        return sheet.lacks("no right to real time (vpcd --preflight)");
    }
    let cycles = sheet.repeats(2_000, 18_000) as u64;
    let report = run(strategy.word, cycles);
    let counted = [
        ("page faults", report.minor_faults + report.major_faults),
        ("blocking calls", report.blocked),
        ("heap calls", report.allocations),
    ];
    sheet.figure("cycles", report.armed as f64, "");
    sheet.figure("with the memory", report.recalled as f64, "");
    for (name, count) in counted {
        sheet.bar(name, count as f64, "", 0.0);
        sheet.check(count == 0, || format!("{count} {name}"));
    }
    sheet.figure("busy p99", report.busy_ns.p99 as f64 / 1e3, "us");
    if !is_without("realtime") {
        let is_given = report.realtime == 1;
        sheet.check(is_given, || format!("real time is {}", report.realtime));
    }
    // Lockstep is as fast as it can be, faster than the ordinary thread that a busy machine keeps
    // from its records: what was lost was not counted.
    if report.lost_records > 0 {
        return sheet.lacks(format!("{} records lost", report.lost_records));
    }
    // Zero is not for want of work.
    sheet.check(report.armed >= cycles, || {
        format!("{} of {cycles} cycles steered", report.armed)
    });
    let [least, most] = strategy.asks.map(|share| share * cycles as f64);
    let recalled = report.recalled as f64;
    sheet.check((least..=most.max(least)).contains(&recalled), || {
        format!("{recalled} cycles asked the memory")
    });
}

/// Asks the kernel to take away all the memory of a process that it may take, as it does when
/// memory is short: what is not locked must be faulted in again.
fn press_out(pid: u32) {
    let maps = std::fs::read_to_string(format!("/proc/{pid}/maps")).unwrap();
    let ranges = maps.lines().filter_map(|line| {
        let (start, end) = line.split_once(' ')?.0.split_once('-')?;
        let start = usize::from_str_radix(start, 16).ok()?;
        let end = usize::from_str_radix(end, 16).ok()?;
        Some(libc::iovec {
            iov_base: start as *mut libc::c_void,
            iov_len: end - start,
        })
    });
    let pid = rustix::process::Pid::from_raw(pid as i32).unwrap();
    let process = rustix::process::pidfd_open(pid, rustix::process::PidfdFlags::empty()).unwrap();
    for range in ranges {
        // SAFETY: the pointer is to one live range; the addresses are of the other process, whose
        // memory keeps its contents: a hint to the kernel, which refuses it for locked memory.
        unsafe {
            libc::syscall(
                libc::SYS_process_madvise,
                process.as_raw_fd(),
                std::ptr::from_ref(&range),
                1,
                libc::MADV_PAGEOUT,
                0,
            );
        }
    }
}
