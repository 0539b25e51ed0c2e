//! A thread of another process that stands still.

use testkit::eventually;

/// The thread of this name in a process.
pub fn thread(pid: u32, name: &str) -> i32 {
    eventually(name, || {
        std::fs::read_dir(format!("/proc/{pid}/task"))
            .ok()?
            .find_map(|entry| {
                let path = entry.ok()?.path();
                let found = std::fs::read_to_string(path.join("comm")).ok()?;
                let id = path.file_name()?.to_str()?.parse().ok()?;
                (found.trim() == name).then_some(id)
            })
    })
}

/// One thread of another process that stands still while the others run: a hang without a hook in
/// the daemon.
pub struct Frozen(i32);

impl Frozen {
    /// Stops the thread by ptrace(2), which parents and root may; returns when it stands.
    #[allow(unsafe_code)]
    pub fn freeze(thread: i32) -> Self {
        let ask = |request| {
            // SAFETY: neither request looks at address or data.
            let answer = unsafe { libc::ptrace(request, thread, 0, 0) };
            assert_eq!(answer, 0, "ptrace: {}", std::io::Error::last_os_error());
        };
        ask(libc::PTRACE_SEIZE);
        ask(libc::PTRACE_INTERRUPT);
        let mut status = 0;
        // SAFETY: the pointer is to a live integer.
        let found = unsafe { libc::waitpid(thread, &mut status, libc::__WALL) };
        assert!(found == thread && libc::WIFSTOPPED(status));
        Self(thread)
    }

    /// Takes note of its end, without waiting: a process is not dead to its parent before its
    /// tracer knows.
    #[allow(unsafe_code)]
    pub fn reap(&self) {
        let mut status = 0;
        // SAFETY: the pointer is to a live integer.
        unsafe { libc::waitpid(self.0, &mut status, libc::__WALL | libc::WNOHANG) };
    }
}

impl Drop for Frozen {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        // SAFETY: the request does not look at the address, and data is the signal 0: none.
        if unsafe { libc::ptrace(libc::PTRACE_DETACH, self.0, 0, 0) } != 0 {
            self.reap();
        }
    }
}
