//! What the tests share: a place, a service manager's socket, the daemon's process, and a way to
//! freeze one thread.

use std::io::ErrorKind;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

pub use testkit::{Running, are_installed, eventually, is_root, not_run, root, scene_file};

/// A directory for one test that every user may enter; the domain in it is the daemon's own affair.
pub struct Place(testkit::Place);

impl std::ops::Deref for Place {
    type Target = testkit::Place;

    fn deref(&self) -> &testkit::Place {
        &self.0
    }
}

impl Place {
    pub fn new() -> Self {
        Self(testkit::Place::for_all_users())
    }

    /// The daemon in this place's domain, with the paper's scene, armed, and nothing of our own
    /// service manager.
    pub fn vpcd(&self) -> Command {
        let mut command = vpcd();
        command.arg("--scene").arg(scene_file());
        command.arg("--domain").arg(self.domain()).arg("--arm");
        command
    }
}

/// The daemon's command, without the environment of a service.
pub fn vpcd() -> Command {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_vpcd"));
    for name in [
        "NOTIFY_SOCKET",
        "WATCHDOG_USEC",
        "WATCHDOG_PID",
        "JOURNAL_STREAM",
    ] {
        command.env_remove(name);
    }
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// Runs a command to its end: exit code and standard error.
pub fn ended(command: Command) -> (i32, String) {
    testkit::ended(command).log()
}

/// Times that a thread went to sleep: grows with each of its turns.
pub fn sleeps(process: u32, thread: i32) -> u64 {
    let path = format!("/proc/{}/task/{thread}/status", process);
    let text = std::fs::read_to_string(path).unwrap();
    let line = text
        .lines()
        .find(|line| line.starts_with("voluntary_ctxt_switches"));
    line.unwrap()
        .split_whitespace()
        .last()
        .unwrap()
        .parse()
        .unwrap()
}

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

/// Puts a thread into an endless loop, without a hook in the daemon: the system call that it sleeps
/// in becomes a jump to itself. False where that is not known for the machine's processor.
#[cfg(not(target_arch = "x86_64"))]
pub fn spin(_thread: i32) -> bool {
    false
}

#[cfg(target_arch = "x86_64")]
pub fn spin(thread: i32) -> bool {
    // On a busy machine it may be found at work.
    eventually("a thread that sleeps", || {
        spins_where_it_sleeps(thread).then_some(())
    });
    true
}

/// Whether the thread was found in a system call, and goes on in an endless loop.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
fn spins_where_it_sleeps(thread: i32) -> bool {
    const SYSCALL: i64 = 0x050f;
    const JUMP_TO_ITSELF: i64 = 0xfeeb;
    let _frozen = Frozen::freeze(thread);
    // SAFETY: numbers alone, all of which may be zero.
    let mut registers: libc::user_regs_struct = unsafe { std::mem::zeroed() };
    // SAFETY: the pointer is to live registers; the address is not looked at.
    let answer = unsafe { libc::ptrace(libc::PTRACE_GETREGS, thread, 0, &mut registers) };
    assert_eq!(answer, 0, "ptrace: {}", std::io::Error::last_os_error());
    // When it goes on, an interrupted sleep is called again.
    let call = registers.rip - 2;
    // SAFETY: an address of the other process, which the kernel checks.
    let word = unsafe { libc::ptrace(libc::PTRACE_PEEKTEXT, thread, call, 0) };
    if word & 0xffff != SYSCALL {
        return false;
    }
    let word = (word & !0xffff) | JUMP_TO_ITSELF;
    // SAFETY: as above; the change is to that process's copy of the page.
    let answer = unsafe { libc::ptrace(libc::PTRACE_POKETEXT, thread, call, word) };
    assert_eq!(answer, 0, "ptrace: {}", std::io::Error::last_os_error());
    true
}

/// A service manager's end of the talk.
pub struct Manager {
    pub socket: UnixDatagram,
    path: PathBuf,
}

impl Manager {
    pub fn new(place: &Place) -> Self {
        let path = place.path("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        Self { socket, path }
    }

    /// Has the command started by us, with this watchdog.
    pub fn manage(&self, mut command: Command, watchdog: Option<Duration>) -> Running {
        command.env("NOTIFY_SOCKET", &self.path);
        if let Some(interval) = watchdog {
            command.env("WATCHDOG_USEC", interval.as_micros().to_string());
        }
        Running::start(command)
    }

    /// The next message that comes within this time.
    pub fn within(&self, patience: Duration) -> Option<String> {
        self.socket.set_read_timeout(Some(patience)).unwrap();
        let end = Instant::now() + patience;
        let mut buffer = [0; 4096];
        loop {
            match self.socket.recv(&mut buffer) {
                Ok(length) => return Some(String::from_utf8(buffer[..length].to_vec()).unwrap()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return None,
                // A receive with a timeout is not begun anew by the kernel, and we trace another
                // process's threads.
                Err(error) if error.kind() == ErrorKind::Interrupted => {
                    let rest = end.checked_duration_since(Instant::now())?;
                    let rest = rest.max(Duration::from_micros(1));
                    self.socket.set_read_timeout(Some(rest)).unwrap();
                }
                Err(error) => panic!("{error}"),
            }
        }
    }

    pub fn next(&self) -> String {
        self.within(Duration::from_secs(10)).expect("a message")
    }

    /// What was sent already.
    pub fn drain(&self) -> Vec<String> {
        std::iter::from_fn(|| self.within(Duration::from_millis(1))).collect()
    }

    /// Messages up to and with the one that holds these words.
    pub fn until(&self, words: &str) -> Vec<String> {
        let mut messages = Vec::new();
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(10) {
            messages.extend(self.within(Duration::from_secs(1)));
            if messages
                .last()
                .is_some_and(|message| message.contains(words))
            {
                return messages;
            }
        }
        panic!("{words}: not said in {messages:?}");
    }
}

/// How many messages hold a line.
pub fn count(messages: &[String], line: &str) -> usize {
    let lines = messages.iter().flat_map(|message| message.lines());
    lines.filter(|found| *found == line).count()
}
