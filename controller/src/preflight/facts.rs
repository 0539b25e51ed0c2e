//! Facts about this machine: from the kernel, and from a second of measured wake-ups.

use std::fs;
use std::path::Path;
use std::thread;

use ipc::now_ns;
use messages::RealTime;
use program::kernel::Kernel;
use rustix::process::{Resource, getrlimit};

use crate::clock::sleep_until;
use crate::histogram::Histogram;
use crate::preflight::foresight::Cost;
use crate::realtime::{self, CAP_IPC_LOCK, CAP_SYS_NICE, RealtimeRequest, has_capability};
use crate::report::Percentiles;

/// Wake-ups measured.
pub const WAKE_UPS: u64 = 1000;
/// Time between two, ns.
const PERIOD_NS: u64 = 1_000_000;

/// The facts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// RLIMIT_RTPRIO; `None`: unlimited.
    pub priority_limit: Option<u64>,
    /// CAP_SYS_NICE.
    pub may_schedule: bool,
    /// Whether SCHED_FIFO was given.
    pub has_fifo: bool,
    /// Whether the processor was given, or none was asked for.
    pub has_cpu: bool,
    /// Processors of this process.
    pub processors: usize,
    /// RLIMIT_MEMLOCK, bytes; `None`: unlimited.
    pub lock_limit: Option<u64>,
    /// CAP_IPC_LOCK.
    pub may_lock: bool,
    /// Memory was locked.
    pub has_lock: bool,
    /// `kernel.sched_rt_runtime_us`; -1: no bound.
    pub rt_runtime_us: Option<i64>,
    /// `kernel.sched_rt_period_us`.
    pub rt_period_us: i64,
    /// The kernel.
    pub kernel: Kernel,
    /// The kernel's clock source.
    pub clock_source: String,
    /// The different frequency governors; empty if there are none.
    pub governors: Vec<String>,
    /// `/dev/cpu_dma_latency` can be opened for writing.
    pub may_hold_idle: bool,
    /// Hyper-threads are in use.
    pub has_smt: bool,
    /// The kernel's list of isolated processors.
    pub isolated: String,
    /// Free bytes in `/dev/shm`.
    pub shm_bytes: u64,
    /// Latencies of `WAKE_UPS` wake-ups, ns; all zero where they could not be measured.
    pub wake_ns: Percentiles,
    /// What foresight costs; `None` where the strategy is another one.
    pub foresight: Option<Cost>,
}

impl Facts {
    /// Reads and measures; takes a second. Locks the memory of this process where that is
    /// permitted.
    pub fn gather(wanted: RealtimeRequest) -> Self {
        let (given, wake_ns) = thread::spawn(move || measure(wanted)).join().unwrap_or((
            RealTime::ASKED
                .with(RealTime::NO_FIFO)
                .with(RealTime::NO_LOCK),
            Percentiles::default(),
        ));
        Self {
            priority_limit: getrlimit(Resource::Rtprio).current,
            may_schedule: has_capability(CAP_SYS_NICE),
            has_fifo: !given.has(RealTime::NO_FIFO),
            has_cpu: !given.has(RealTime::NO_CPU),
            processors: thread::available_parallelism().map_or(1, usize::from),
            lock_limit: getrlimit(Resource::Memlock).current,
            may_lock: has_capability(CAP_IPC_LOCK),
            has_lock: !given.has(RealTime::NO_LOCK),
            rt_runtime_us: line("/proc/sys/kernel/sched_rt_runtime_us").parse().ok(),
            rt_period_us: line("/proc/sys/kernel/sched_rt_period_us")
                .parse()
                .unwrap_or(1_000_000),
            kernel: Kernel::read(),
            clock_source: line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
            governors: governors(),
            // Opening asks for nothing yet; writing would.
            may_hold_idle: fs::OpenOptions::new()
                .write(true)
                .open("/dev/cpu_dma_latency")
                .is_ok(),
            has_smt: line("/sys/devices/system/cpu/smt/active") == "1",
            isolated: line("/sys/devices/system/cpu/isolated"),
            shm_bytes: rustix::fs::statvfs("/dev/shm").map_or(0, |shm| shm.f_bavail * shm.f_frsize),
            wake_ns,
            foresight: None,
        }
    }
}

/// The text of a small file; empty if there is none.
fn line(path: impl AsRef<Path>) -> String {
    fs::read_to_string(path).map_or(String::new(), |text| text.trim().to_owned())
}

fn governors() -> Vec<String> {
    let mut found: Vec<_> = fs::read_dir("/sys/devices/system/cpu")
        .into_iter()
        .flatten()
        .flatten()
        .map(|cpu| line(cpu.path().join("cpufreq/scaling_governor")))
        .filter(|name| !name.is_empty())
        .collect();
    found.sort();
    found.dedup();
    found
}

/// Wakes up on a grid, as the loop does, in a thread that gets what the loop would get.
fn measure(wanted: RealtimeRequest) -> (RealTime, Percentiles) {
    let given = realtime::enter(wanted);
    let mut latencies = Histogram::default();
    let mut release_ns = now_ns() + PERIOD_NS;
    for _ in 0..WAKE_UPS {
        sleep_until(release_ns);
        latencies.add(now_ns().saturating_sub(release_ns));
        release_ns += PERIOD_NS;
    }
    (given, latencies.percentiles())
}
