//! SCHED_FIFO for a thread.

use std::io;

use libc::{SCHED_FIFO, SCHED_RESET_ON_FORK, sched_param};

/// Gives the calling thread SCHED_FIFO at this priority, 1 to 99, and reads it back. Threads that
/// it starts later are ordinary ones.
///
/// # Errors
/// It is not permitted, or the kernel says otherwise.
#[allow(unsafe_code)]
pub fn take_fifo(priority: i32) -> io::Result<()> {
    let wanted = sched_param {
        sched_priority: priority,
    };
    let policy = SCHED_FIFO | SCHED_RESET_ON_FORK;
    // SAFETY: the pointer is to a live value of the right type; 0 names the calling thread.
    if unsafe { libc::sched_setscheduler(0, policy, &raw const wanted) } != 0 {
        return Err(io::Error::last_os_error());
    }
    let mut got = sched_param { sched_priority: 0 };
    // SAFETY: 0 names the calling thread.
    let policy = unsafe { libc::sched_getscheduler(0) } & !SCHED_RESET_ON_FORK;
    // SAFETY: the pointer is to a live value of the right type, which the call fills.
    let outcome = unsafe { libc::sched_getparam(0, &raw mut got) };
    if outcome == 0 && policy == SCHED_FIFO && got.sched_priority == priority {
        return Ok(());
    }
    Err(io::Error::other("the kernel says otherwise"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_priority_beyond_99_is_refused() {
        let error = take_fifo(100).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    }
}
