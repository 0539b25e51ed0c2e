//! What a section of the loop's thread cost besides time: page faults, blocking calls, heap calls.

use messages::CycleRecord;

/// Counters of the calling thread at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    minor_faults: u64,
    major_faults: u64,
    blocked: u64,
    allocations: u64,
}

impl Usage {
    /// Reads the counters; one call of the kernel, which neither blocks nor allocates.
    #[allow(unsafe_code)]
    pub fn now() -> Self {
        let mut usage = std::mem::MaybeUninit::<libc::rusage>::zeroed();
        // SAFETY: the pointer is to a live value of the right type. It stays zero where the call
        // fails, and all zeros are a valid value.
        let usage = unsafe {
            libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr());
            usage.assume_init()
        };
        Self {
            minor_faults: usage.ru_minflt as u64,
            major_faults: usage.ru_majflt as u64,
            blocked: usage.ru_nvcsw as u64,
            allocations: heap_meter::calls(),
        }
    }

    /// Writes what came since `before` into a record.
    pub fn record_since(&self, before: &Self, record: &mut CycleRecord) {
        let since =
            |now: u64, then: u64| u32::try_from(now.saturating_sub(then)).unwrap_or(u32::MAX);
        record.minor_faults = since(self.minor_faults, before.minor_faults);
        record.major_faults = since(self.major_faults, before.major_faults);
        record.blocked = since(self.blocked, before.blocked);
        record.allocations = since(self.allocations, before.allocations);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn cost(work: impl FnOnce()) -> CycleRecord {
        let mut record = CycleRecord::default();
        let before = Usage::now();
        work();
        Usage::now().record_since(&before, &mut record);
        record
    }

    #[test]
    fn a_sleep_is_seen_to_block() {
        assert!(cost(|| std::thread::sleep(Duration::from_millis(1))).blocked >= 1);
    }

    #[test]
    fn fresh_pages_are_seen_to_fault() {
        let fresh = cost(|| {
            // More than the C library ever serves from what was freed before (32 MB).
            let pages = vec![1_u8; 64 << 20];
            drop(std::hint::black_box(pages));
        });
        assert!(fresh.minor_faults >= 2, "{}", fresh.minor_faults);
    }
}
