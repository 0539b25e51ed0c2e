//! What the tests share: a place, a service manager's socket, the daemon's process, and a way to
//! freeze one thread.

use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

/// A directory for one test that every user may enter; the domain in it is the daemon's own affair.
pub struct Place(tempfile::TempDir);

impl Place {
    pub fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let open = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(directory.path(), open).unwrap();
        Self(directory)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn file(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    pub fn domain(&self) -> PathBuf {
        self.path("domain")
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

impl Drop for Place {
    fn drop(&mut self) {
        // Who is alone in a domain clears away what the killed left in /dev/shm.
        if self.domain().exists() {
            let _ = self.vpcd().args(["--cycles", "1"]).output();
        }
    }
}

/// The daemon's command, without the environment of a service.
pub fn vpcd() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vpcd"));
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

/// The repository's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .canonicalize()
        .unwrap()
}

/// The scene file of the paper's simulation.
pub fn scene_file() -> PathBuf {
    root().join("ipc/scene/scenes/paper-sim.toml")
}

/// Runs a command to its end: exit code and standard error.
pub fn ended(mut command: Command) -> (i32, String) {
    let Output { status, stderr, .. } = command.output().unwrap();
    (
        status.code().unwrap_or(-1),
        String::from_utf8(stderr).unwrap(),
    )
}

/// Whether we may do what only root may; tells plainly where not.
pub fn is_root(what: &str) -> bool {
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        eprintln!("NOT RUN: {what}: needs root");
    }
    is_root
}

/// Calls `attempt` until it gives something; panics after ten seconds.
pub fn eventually<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(10) {
        if let Some(value) = attempt() {
            return value;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    panic!("{what}: did not happen");
}

/// The daemon at work; killed when the test ends first.
pub struct Running(Option<Child>);

impl Running {
    pub fn start(mut command: Command) -> Self {
        Self(Some(command.spawn().unwrap()))
    }

    pub fn pid(&self) -> u32 {
        self.0.as_ref().unwrap().id()
    }

    pub fn signal(&self, signal: Signal) {
        let pid = Pid::from_raw(self.pid() as i32).unwrap();
        kill_process(pid, signal).unwrap();
    }

    /// Waits for its end: exit code (-1 where a signal ended it) and standard error.
    pub fn ended(mut self) -> (i32, String) {
        let mut child = self.0.take().unwrap();
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > Duration::from_secs(10) {
                child.kill().unwrap();
                let output = child.wait_with_output().unwrap();
                panic!("did not end: {}", String::from_utf8_lossy(&output.stderr));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let Output { status, stderr, .. } = child.wait_with_output().unwrap();
        (
            status.code().unwrap_or(-1),
            String::from_utf8(stderr).unwrap(),
        )
    }

    pub fn terminated(self) -> (i32, String) {
        self.signal(Signal::TERM);
        self.ended()
    }

    /// The thread of this name; the loop's is called as the program.
    pub fn thread(&self, name: &str) -> i32 {
        thread(self.pid(), name)
    }

    /// Times that a thread went to sleep: grows with each of its turns.
    pub fn sleeps(&self, thread: i32) -> u64 {
        let path = format!("/proc/{}/task/{thread}/status", self.pid());
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
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
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
