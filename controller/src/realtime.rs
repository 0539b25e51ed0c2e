//! Real-time scheduling of the loop's thread, if it is asked for and permitted: SCHED_FIFO, a
//! processor of its own, a prefaulted stack, locked memory. Each is read back after it was set.

use std::io;

use messages::RealTime;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use crate::stack;

/// Number of the capability to lock any amount of memory, `capabilities(7)`.
pub(crate) const CAP_IPC_LOCK: u32 = 14;
/// Number of CAP_SYS_NICE, which permits SCHED_FIFO, `capabilities(7)`.
pub(crate) const CAP_SYS_NICE: u32 = 23;

/// What the loop's thread asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealtimeRequest {
    /// SCHED_FIFO priority, 1 to 99.
    pub priority: i32,
    /// The processor to stay on, from 0; `None`: any.
    pub cpu: Option<usize>,
}

/// Gives the calling thread what it asks for, as far as that is permitted, and reads back what it
/// got. If something is missing the daemon runs degraded: this function logs it once, and status
/// and telemetry show the returned bits all the time. Late cycles are counted, and stale commands
/// stop the camera.
pub fn enter(wanted: RealtimeRequest) -> RealTime {
    let mut bits = RealTime::ASKED;
    let mut lacks = Vec::new();
    let mut lack = |bit: RealTime, outcome: io::Result<()>, what: &str| {
        if let Err(error) = outcome {
            bits = bits.with(bit);
            lacks.push(format!("{what}: {error}"));
        }
    };
    if let Some(cpu) = wanted.cpu {
        let what = format!("not on processor {cpu} (realtime.cpu; CPUAffinity= in the unit)");
        lack(RealTime::NO_CPU, pin(cpu), &what);
    }
    let what = format!(
        "no SCHED_FIFO at priority {}, expect wake-ups late by up to 200 ms under load (CAP_SYS_NICE, or LimitRTPRIO= in the unit)",
        wanted.priority
    );
    lack(
        RealTime::NO_FIFO,
        program::take_fifo(wanted.priority),
        &what,
    );
    let what =
        "memory is not locked, expect page faults in the loop (LimitMEMLOCK=infinity in the unit)";
    lack(RealTime::NO_LOCK, lock(), what);
    // After locking, so that the pages stay.
    stack::prepare();
    if bits.is_degraded() {
        tracing::warn!(
            bits = bits.0,
            "DEGRADED, not real time: {}; vpcd --preflight tells what this machine lacks",
            lacks.join("; ")
        );
    }
    bits
}

fn pin(cpu: usize) -> io::Result<()> {
    let missing = || {
        io::Error::new(
            io::ErrorKind::NotFound,
            "there is no such processor for this process",
        )
    };
    if cpu >= CpuSet::MAX_CPU {
        return Err(missing());
    }
    let mut only = CpuSet::new();
    only.set(cpu);
    sched_setaffinity(None, &only).map_err(|error| match error {
        rustix::io::Errno::INVAL => missing(),
        other => other.into(),
    })?;
    let got = sched_getaffinity(None)?;
    if got.count() == 1 && got.is_set(cpu) {
        return Ok(());
    }
    Err(io::Error::other("the kernel says otherwise"))
}

/// All memory, present and future, or none: under a limit, locking the future would make a later
/// mapping (a peer's segment) fail when the limit is reached, in the middle of a run.
fn lock() -> io::Result<()> {
    let limit = getrlimit(Resource::Memlock).current;
    if let Some(limit) = limit.filter(|_| !has_capability(CAP_IPC_LOCK)) {
        let message = format!(
            "the limit is {} KiB, and under a limit none is locked",
            limit >> 10
        );
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, message));
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)?;
    match (status_kib("VmLck"), status_kib("VmRSS")) {
        (Some(locked), Some(resident)) if locked < resident / 2 => Err(io::Error::other(format!(
            "VmLck is {locked} KiB of {resident} KiB resident"
        ))),
        _ => Ok(()),
    }
}

/// A line of `/proc/self/status`.
fn status(name: &str) -> Option<String> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
    Some(line.trim().to_owned())
}

/// A size in `/proc/self/status`, KiB.
pub(crate) fn status_kib(name: &str) -> Option<u64> {
    status(name)?.split_whitespace().next()?.parse().ok()
}

/// The machine's memory, bytes.
pub(crate) fn memory_bytes() -> u64 {
    let info = rustix::system::sysinfo();
    // Both are of the machine's word size: u32 on some.
    #[allow(clippy::useless_conversion)]
    u64::from(info.totalram).saturating_mul(u64::from(info.mem_unit))
}

/// Whether this process has a capability, by its number.
pub(crate) fn has_capability(number: u32) -> bool {
    let set = status("CapEff").and_then(|text| u64::from_str_radix(&text, 16).ok());
    set.is_some_and(|set| set >> number & 1 == 1)
}

/// Lets the kernel wake the calling thread as precisely as it can (1 ns of slack instead of 50 us):
/// for polling in lockstep, without real-time scheduling.
#[allow(unsafe_code)]
pub fn precise_sleep() {
    // SAFETY: PR_SET_TIMERSLACK takes a number and touches no memory of ours.
    let _ = unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1_u64) };
}
