//! A child by a descriptor of the kernel's.

use std::os::fd::OwnedFd;
use std::process::Child;
use std::time::Instant;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{
    Pid, PidfdFlags, Signal, getpgid, kill_process_group, pidfd_open, pidfd_send_signal,
};

/// A child that cannot be confused with a later process of the same number.
#[derive(Debug)]
pub struct Handle {
    pid: Pid,
    process: OwnedFd,
    leads_group: bool,
}

impl Handle {
    /// Of a child that has not been waited for.
    ///
    /// # Errors
    /// The kernel gives no handle.
    pub fn of(child: &Child) -> rustix::io::Result<Self> {
        let pid = Pid::from_child(child);
        Ok(Self {
            pid,
            process: pidfd_open(pid, PidfdFlags::empty())?,
            leads_group: getpgid(Some(pid))? == pid,
        })
    }

    /// The number of the process, for messages.
    pub fn pid(&self) -> Pid {
        self.pid
    }

    /// Sends a signal; to all of the group where the child leads one.
    pub fn send(&self, signal: Signal) {
        // Errors mean that it is gone.
        let _ = if self.leads_group && !self.ends_by(Instant::now()) {
            kill_process_group(self.pid, signal)
        } else {
            pidfd_send_signal(&self.process, signal)
        };
    }

    /// Waits until it has ended; `false` where it has not by then.
    pub fn ends_by(&self, end: Instant) -> bool {
        loop {
            let left = end.saturating_duration_since(Instant::now());
            let left = Timespec {
                tv_sec: left.as_secs() as i64,
                tv_nsec: i64::from(left.subsec_nanos()),
            };
            let mut ended = [PollFd::new(&self.process, PollFlags::IN)];
            match poll(&mut ended, Some(&left)) {
                Err(rustix::io::Errno::INTR) => (),
                events => return events.is_ok_and(|events| events > 0),
            }
        }
    }
}
