//! The result of a run as a JSON file: `vpcd --report`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// Percentiles of one duration over a run, ns; of a histogram: right to 13 %, the longest exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: u64,
    /// 99 % are not longer.
    pub p99: u64,
    /// 99.9 % are not longer.
    pub p999: u64,
    /// The longest.
    pub max: u64,
}

/// A run in numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// Cycles.
    pub cycles: u64,
    /// Cycles that sent the law's twist.
    pub armed: u64,
    /// Cycles that asked the memory.
    pub recalled: u64,
    /// Releases missed.
    pub overruns: u64,
    /// Records that were lost: everything below lacks them.
    pub lost_records: u64,
    /// Lines of the log that were lost.
    pub lost_lines: u64,
    /// Wake-up after the release, ns; 0 in lockstep.
    pub wake_ns: Percentiles,
    /// Time taken by receiving, ns.
    pub receive_ns: Percentiles,
    /// The law, ns.
    pub step_ns: Percentiles,
    /// Sending, ns.
    pub send_ns: Percentiles,
    /// From wake to sent, ns.
    pub busy_ns: Percentiles,
    /// Page faults from wake to send without a disk, all cycles but the first [`Report::WARM_UP`].
    pub minor_faults: u64,
    /// Page faults with a disk, likewise.
    pub major_faults: u64,
    /// Blocking calls from wake to send, likewise.
    pub blocked: u64,
    /// Calls of the heap from wake to send, likewise.
    pub allocations: u64,
    /// `RealTime` bits: 1 asked, and lacks 2 SCHED_FIFO, 4 its processor, 8 locked memory.
    pub realtime: u32,
    /// Stack that the loop used, bytes, in whole pages; 0 if real time was not asked for.
    pub stack_used_bytes: usize,
    /// Locked memory at the end, KiB.
    pub locked_kib: u64,
}

impl Report {
    /// Cycles at the start in which peers are met, which allocates and maps memory.
    pub const WARM_UP: u64 = 100;

    /// Writes the file.
    ///
    /// # Errors
    /// [`ReportError`] names the file.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let text = serde_json::to_string_pretty(self).map_err(std::io::Error::from);
        text.and_then(|text| std::fs::write(path, text + "\n"))
            .map_err(|source| ReportError {
                path: path.to_owned(),
                source,
            })
    }
}

/// A report that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("--report {}: cannot write: {source}", path.display())]
pub struct ReportError {
    /// Path of the file, as given.
    pub path: PathBuf,
    /// The operating system's reason.
    pub source: std::io::Error,
}
