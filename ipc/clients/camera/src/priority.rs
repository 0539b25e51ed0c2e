//! SCHED_FIFO for the loop, where it is asked for and permitted.

/// Asks for SCHED_FIFO for the calling thread; threads that it starts later are ordinary ones.
///
/// # Errors
/// It is not permitted.
pub fn raise(priority: i32) -> std::io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: 0 names the calling thread, and the parameters outlive the call.
    #[allow(unsafe_code)]
    let outcome = unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) };
    if outcome == 0 {
        Ok(())
    } else {
        Err(std::io::Error::last_os_error())
    }
}
