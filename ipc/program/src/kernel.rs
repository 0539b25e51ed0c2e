//! How far the kernel can keep a real-time thread waiting: one rule for every `--preflight`.

use std::fmt::{self, Display, Formatter};

/// What is needed, in words.
pub const NEEDED: &str = "PREEMPT_RT for bounds in the tens of us; PREEMPT does at 30 Hz";
/// How to provide it.
pub const REMEDY: &str = "apt-get install linux-image-rt-amd64; with PREEMPT_DYNAMIC preempt=full on the kernel's command line";

/// The kernel of this machine. Without PREEMPT_RT it works, with longer latencies: a note, not a
/// lack. What they come to is measured.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kernel {
    /// `/sys/kernel/realtime` says so.
    pub is_realtime: bool,
    /// `uname -v`.
    pub version: String,
    /// The mode of PREEMPT_DYNAMIC; empty if it cannot be read.
    pub mode: String,
}

impl Kernel {
    /// Asks the kernel.
    pub fn read() -> Self {
        let line = |path: &str| {
            let text = std::fs::read_to_string(path).unwrap_or_default();
            text.trim().to_owned()
        };
        let modes = line("/sys/kernel/debug/sched/preempt");
        let chosen = modes.split_once('(').and_then(|(_, at)| at.split_once(')'));
        Self {
            is_realtime: line("/sys/kernel/realtime") == "1",
            version: line("/proc/sys/kernel/version"),
            mode: chosen.map_or(String::new(), |(mode, _)| mode.to_owned()),
        }
    }

    /// Whether nothing is to be wished for.
    pub fn is_enough(&self) -> bool {
        self.model() == "PREEMPT_RT"
    }

    fn model(&self) -> &'static str {
        if self.is_realtime {
            return "PREEMPT_RT";
        }
        ["PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT"]
            .into_iter()
            .find(|model| self.version.contains(model))
            .unwrap_or("no preemption")
    }
}

impl Display for Kernel {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(self.model())?;
        if !self.mode.is_empty() {
            write!(f, ", preempt={}", self.mode)?;
        }
        write!(f, " ({})", self.version)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_real_time_kernel_is_enough() {
        let kernel = |version: &str, is_realtime| Kernel {
            is_realtime,
            version: version.to_owned(),
            mode: String::new(),
        };
        let dynamic = "#1 SMP PREEMPT_DYNAMIC Debian";
        assert!(kernel("#1 SMP PREEMPT_RT Debian", false).is_enough());
        assert!(kernel(dynamic, true).is_enough());
        assert!(!kernel(dynamic, false).is_enough());
        let mut lazy = kernel(dynamic, false);
        lazy.mode = "lazy".to_owned();
        let words = "PREEMPT_DYNAMIC, preempt=lazy (#1 SMP PREEMPT_DYNAMIC Debian)";
        assert_eq!(lazy.to_string(), words);
        assert!(
            kernel("#1 SMP", false)
                .to_string()
                .starts_with("no preemption")
        );
    }
}
