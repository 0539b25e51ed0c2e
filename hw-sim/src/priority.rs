//! SCHED_FIFO for the robot's millisecond, where it is permitted.

/// Above ordinary processes, below the controller's default of 80.
const PRIORITY: i32 = 70;

/// Asks for SCHED_FIFO for the calling thread; threads that it starts later are ordinary ones.
/// Where it is not permitted, milliseconds begin later, which the lateness in the outcome shows.
pub fn raise() {
    let parameters = libc::sched_param {
        sched_priority: PRIORITY,
    };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: 0 names the calling thread, and the parameters outlive the call.
    #[allow(unsafe_code)]
    let _ = unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) };
}
