//! What the tests share: a place, a service manager's socket, the daemon's process, and the files
//! that are installed.

use std::io::ErrorKind;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

pub use testkit::{Running, eventually, root, scene_file};

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

/// A service manager's end of the talk.
pub struct Manager {
    socket: UnixDatagram,
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
        self.within(testkit::PATIENCE).expect("a message")
    }

    /// What was sent already.
    pub fn drain(&self) -> Vec<String> {
        std::iter::from_fn(|| self.within(Duration::from_millis(1))).collect()
    }

    /// Messages up to and with the one that holds these words.
    pub fn until(&self, words: &str) -> Vec<String> {
        let mut messages = Vec::new();
        let start = Instant::now();
        while start.elapsed() < testkit::PATIENCE {
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

/// A file of the package.
pub fn installed(name: &str) -> String {
    let path = root().join("controller/systemd").join(name);
    std::fs::read_to_string(path).unwrap()
}

/// The names of all units, templates too.
pub fn units() -> Vec<String> {
    let entries = std::fs::read_dir(root().join("controller/systemd")).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let units: Vec<_> = names.filter(|name| name.ends_with(".service")).collect();
    assert!(units.len() >= 8, "{units:?}");
    units
}

/// The daemon's directory with all that is in it, and the shared memory that it maps.
pub fn files(domain: &Path, pid: u32) -> Vec<PathBuf> {
    let mut found = vec![domain.to_owned()];
    let mut looked = 0;
    while let Some(path) = found.get(looked).cloned() {
        looked += 1;
        if path.is_dir() {
            let entries = std::fs::read_dir(path).unwrap();
            found.extend(entries.map(|entry| entry.unwrap().path()));
        }
    }
    let maps = std::fs::read_to_string(format!("/proc/{pid}/maps")).unwrap();
    let mut shared: Vec<_> = maps
        .lines()
        .filter_map(|line| Some(PathBuf::from(&line[line.find("/dev/shm/vpc_")?..])))
        .collect();
    shared.dedup();
    assert!(shared.len() >= 4, "four services at least: {maps}");
    found.extend(shared);
    found
}
