//! Real-time scheduling of the loop's thread, where it is asked for and permitted.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};

/// Gives the calling thread SCHED_FIFO with this priority and locks the process's memory. Where that is not
/// permitted the daemon runs all the same, and says so loudly: late cycles are counted, and stale commands stop the
/// camera.
pub fn enter(priority: i32) {
    if let Err(error) = fifo(priority) {
        tracing::warn!(
            priority,
            %error,
            "DEGRADED: no real-time scheduling; expect wake-ups to be late by up to 200 ms under load \
             (grant CAP_SYS_NICE, or LimitRTPRIO= in the unit)"
        );
    }
    if let Err(error) = lock() {
        tracing::warn!(
            %error,
            "DEGRADED: memory is not locked; expect page faults in the loop (LimitMEMLOCK=infinity in the unit)"
        );
    }
}

#[allow(unsafe_code)]
fn fifo(priority: i32) -> std::io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    // SAFETY: the pointer is to a live value of the right type; 0 names the calling thread.
    match unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameters) } {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error()),
    }
}

/// With a limit on locked memory, locking the future too would make later mappings fail: refuse instead.
fn lock() -> std::io::Result<()> {
    let limited = getrlimit(Resource::Memlock).current.is_some();
    if limited && !rustix::process::geteuid().is_root() {
        return Err(std::io::Error::from(std::io::ErrorKind::PermissionDenied));
    }
    Ok(mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)?)
}

/// Lets the kernel wake the calling thread as precisely as it can (1 ns of slack instead of 50 us): for polling in
/// lockstep, without real-time scheduling.
#[allow(unsafe_code)]
pub fn precise_sleep() {
    // SAFETY: PR_SET_TIMERSLACK takes a number and touches no memory of ours.
    let _ = unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1_u64) };
}
