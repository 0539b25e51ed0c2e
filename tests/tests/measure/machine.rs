//! What this machine permits and has.

use std::process::{Command, Stdio};
use std::sync::OnceLock;

use rustix::process::Pid;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use serde_json::Value;

/// Whether real time is ours to take: SCHED_FIFO and locked memory, as `vpcd --preflight` finds.
pub fn may_be_real_time() -> bool {
    static MAY: OnceLock<bool> = OnceLock::new();
    *MAY.get_or_init(may_be_real_time_now)
}

fn may_be_real_time_now() -> bool {
    let found = testkit::command(testkit::program("vpcd"))
        .args(["--preflight", "--json"])
        .output();
    let found: Value = serde_json::from_slice(&found.unwrap().stdout).unwrap();
    ["real-time priority", "locked memory"].iter().all(|name| {
        let mut checks = found["checks"].as_array().unwrap().iter();
        checks.any(|check| check["name"] == *name && check["state"] == "ok")
    })
}

/// Gives the calling thread SCHED_FIFO at this priority, or with 0 the ordinary scheduler; whether
/// that was permitted.
pub fn take_priority(priority: i32) -> bool {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    let policy = if priority == 0 {
        libc::SCHED_OTHER
    } else {
        libc::SCHED_FIFO
    };
    // SAFETY: 0 names the calling thread, and the parameters outlive the call.
    unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) == 0 }
}

/// The processors that this process may run on, by their numbers.
pub fn processors() -> Vec<usize> {
    let allowed = sched_getaffinity(None).unwrap();
    (0..CpuSet::MAX_CPU)
        .filter(|number| allowed.is_set(*number))
        .collect()
}

/// Keeps a thread, or the first one of a process, or with `None` the calling one, on one processor.
pub fn keep(thread: Option<Pid>, processor: usize) {
    let mut set = CpuSet::new();
    set.set(processor);
    sched_setaffinity(thread, &set).unwrap();
}

/// A command that runs as an instrument: at this SCHED_FIFO priority where that can be had, so that
/// it is on time whatever else the machine does.
pub fn on_time(command: Command, priority: i32) -> Command {
    if !may_be_real_time() {
        return command;
    }
    let mut timely = testkit::command("chrt");
    timely.args(["-f", &priority.to_string()]);
    timely.arg(command.get_program()).args(command.get_args());
    timely.envs(
        command
            .get_envs()
            .filter_map(|(key, value)| Some((key, value?))),
    );
    timely.stdout(Stdio::null()).stderr(Stdio::piped());
    timely
}

/// Whether a mechanism is switched off by `VPC_WITHOUT`, to see the measurements of it fail.
pub fn is_without(mechanism: &str) -> bool {
    std::env::var("VPC_WITHOUT").is_ok_and(|without| without == mechanism)
}
