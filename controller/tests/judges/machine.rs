//! A machine for tests: a real systemd in namespaces of its own (root only), over the machine's own
//! files.
//!
//! The whole ends within five minutes, whatever happens: `timeout` kills process 1 of the namespace
//! then, and everything in it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::fixture::{Place, eventually, is_root, not_run, root};

/// What a minimal boot takes from the machine.
const STOCK: [&str; 3] = [
    "systemd-journald.service",
    "systemd-journald.socket",
    "systemd-journald-dev-log.socket",
];
/// Targets that stock units and ours order themselves by.
const TARGETS: [&str; 5] = [
    "basic.target",
    "multi-user.target",
    "shutdown.target",
    "sysinit.target",
    "test.target",
];
/// Two machines at once would take each other's processors: the loops in them run before all else.
static TURN: Mutex<()> = Mutex::new(());

/// Files laid over the machine's: those below `usr`, `etc` and `var` where they say, those below
/// `units` as the only ones in `/usr/lib/systemd/system`.
pub struct Stage(PathBuf);

impl Stage {
    fn new(directory: PathBuf) -> Self {
        for tree in ["usr", "etc", "var", "units"] {
            fs::create_dir_all(directory.join(tree)).unwrap();
        }
        let stage = Self(directory);
        for name in STOCK {
            let unit = Path::new("/lib/systemd/system").join(name);
            stage.put(&unit, &format!("units/{name}"));
        }
        for name in TARGETS {
            let more = match name {
                "test.target" => "Wants=systemd-journald.service\n",
                _ => "",
            };
            let text = format!("[Unit]\nDescription={name}\nDefaultDependencies=no\n{more}");
            fs::write(stage.0.join("units").join(name), text).unwrap();
        }
        if !may_raise_limits() {
            // In place of the limit that cannot be given.
            let text =
                "[Service]\nAmbientCapabilities=CAP_SYS_NICE\nCapabilityBoundingSet=CAP_SYS_NICE\n";
            let directory = stage.0.join("units/vpcd.service.d");
            fs::create_dir(&directory).unwrap();
            fs::write(directory.join("nice.conf"), text).unwrap();
        }
        stage
    }

    /// Copies a file to this place in there.
    pub fn put(&self, from: &Path, to: &str) {
        let to = self.0.join(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(from, to).unwrap();
    }
}

/// A systemd at work.
pub struct Machine {
    boot: Child,
    /// Its process 1, as we see it.
    init: u32,
    // In this order: the stage must outlive the mounts, and whoever comes next finds the cgroup
    // removed.
    _cgroup: Cgroup,
    _place: Place,
    _turn: MutexGuard<'static, ()>,
}

impl Machine {
    /// Boots with these files; None, said plainly, where that cannot be.
    pub fn boot(what: &str, install: impl FnOnce(&Stage)) -> Option<Self> {
        if !is_root(what) {
            return None;
        }
        for tool in [
            "/lib/systemd/systemd",
            "/usr/bin/unshare",
            "/usr/bin/nsenter",
            "/usr/bin/timeout",
        ] {
            if !Path::new(tool).exists() {
                not_run(what, format_args!("{tool} is missing"));
                return None;
            }
        }
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(cgroup) = Cgroup::new() else {
            not_run(what, "no cgroup v2 that we may write to");
            return None;
        };
        let place = Place::new();
        let stage = Stage::new(place.path("stage"));
        install(&stage);
        // The shell enters the cgroup before the namespace is made, so that it becomes its root.
        let script = r#"echo $$ > "$2/cgroup.procs" && exec timeout --foreground --signal=KILL 300 \
            unshare --fork --kill-child --pid --mount --uts --ipc --cgroup sh "$3" "$1" "$2""#;
        let mut boot = testkit::command("/bin/sh")
            .args(["-c", script, "boot"])
            .args([&stage.0, &cgroup.0])
            .arg(root().join("controller/tests/judges/boot.sh"))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(fs::File::create(place.path("console")).unwrap())
            .spawn()
            .unwrap();
        // timeout -> unshare -> process 1
        let init = eventually("process 1", || {
            if let Some(status) = boot.try_wait().unwrap() {
                let console = fs::read_to_string(place.path("console")).unwrap();
                panic!("the boot ended: {status}: {console}");
            }
            let init = child(child(boot.id())?)?;
            let name = fs::read_to_string(format!("/proc/{init}/comm")).ok()?;
            (name.trim() == "systemd").then_some(init)
        });
        let machine = Self {
            boot,
            init,
            _cgroup: cgroup,
            _place: place,
            _turn: turn,
        };
        eventually("systemd", || {
            machine
                .run("systemctl is-active test.target")
                .0
                .then_some(())
        });
        Some(machine)
    }

    /// Runs a command in there: whether it succeeded, and what it said.
    pub fn run(&self, line: &str) -> (bool, String) {
        let output = testkit::command("/usr/bin/nsenter")
            .args([
                "--all",
                "--target",
                &self.init.to_string(),
                "/bin/sh",
                "-c",
                line,
            ])
            .env("SYSTEMD_PAGER", "")
            .env("PATH", "/usr/sbin:/usr/bin:/sbin:/bin")
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let Output {
            status,
            stdout,
            stderr,
        } = output;
        let text = String::from_utf8([stdout, stderr].concat()).unwrap();
        (status.success(), text.trim().to_owned())
    }

    pub fn must(&self, line: &str) -> String {
        let (is_done, text) = self.run(line);
        assert!(
            is_done,
            "{line}: {text}\n{}",
            self.run("journalctl --no-pager -n 60").1
        );
        text
    }

    pub fn show(&self, property: &str) -> String {
        self.must(&format!(
            "systemctl show vpcd --value --property={property}"
        ))
    }

    /// The daemon's process, as we see it.
    pub fn daemon(&self) -> u32 {
        let inside = self.show("MainPID");
        eventually("the daemon's process", || {
            let processes = fs::read_dir("/proc").ok()?;
            processes.filter_map(Result::ok).find_map(|entry| {
                let status = fs::read_to_string(entry.path().join("status")).ok()?;
                let pids = status.lines().find(|line| line.starts_with("NSpid:"))?;
                let pids: Vec<_> = pids.split_whitespace().skip(1).collect();
                let is_it =
                    pids.len() == 2 && pids[1] == inside && status.contains("Name:\tvpcd\n");
                is_it.then(|| pids[0].parse().unwrap())
            })
        })
    }

    pub fn signal(&self, process: u32, signal: Signal) {
        kill_process(Pid::from_raw(process as i32).unwrap(), signal).unwrap();
    }

    /// Waits until the daemon was restarted so many times and is ready again.
    pub fn restarted(&self, times: &str) {
        // The watchdog's two seconds, the end of the daemon and its start, each on a busy machine.
        let restarted = testkit::within(Duration::from_secs(60), || {
            (self.show("NRestarts") == times && self.show("ActiveState") == "active").then_some(())
        });
        assert!(
            restarted.is_some(),
            "{times} restarts: {:?}",
            self.run("systemctl status vpcd")
        );
    }

    pub fn journal(&self) -> Vec<Value> {
        let text = self.must("journalctl --no-pager --output=json --unit=vpcd");
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = kill_process(Pid::from_raw(self.init as i32).unwrap(), Signal::KILL);
        let _ = self.boot.wait();
    }
}

/// A cgroup of our own below the one that is mounted.
struct Cgroup(PathBuf);

impl Cgroup {
    fn new() -> Option<Self> {
        let mounts = fs::read_to_string("/proc/self/mounts").ok()?;
        let mount = mounts.lines().find_map(|line| {
            let fields: Vec<_> = line.split(' ').collect();
            (fields.get(2) == Some(&"cgroup2")).then(|| fields[1].to_owned())
        })?;
        let path = Path::new(&mount).join(format!("vpcd-test-{}", std::process::id()));
        fs::create_dir(&path).ok()?;
        Some(Self(path))
    }
}

impl Drop for Cgroup {
    fn drop(&mut self) {
        // A kill takes its time.
        let is_empty = (0..500).any(|_| {
            let is_removed = remove(&self.0).is_ok();
            if !is_removed {
                std::thread::sleep(Duration::from_millis(10));
            }
            is_removed
        });
        assert!(is_empty || std::thread::panicking(), "processes are left");
    }
}

/// Removes a cgroup and its children; refused while a process is in one.
fn remove(cgroup: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(cgroup)?.filter_map(Result::ok) {
        if entry.path().is_dir() {
            remove(&entry.path())?;
        }
    }
    fs::remove_dir(cgroup)
}

fn child(process: u32) -> Option<u32> {
    let path = format!("/proc/{process}/task/{process}/children");
    let children = fs::read_to_string(path).ok()?;
    children.split_whitespace().next()?.parse().ok()
}

/// Whether root is root in this: containers often keep CAP_SYS_RESOURCE back, and then units cannot
/// raise limits.
pub fn may_raise_limits() -> bool {
    let capabilities = status(std::process::id(), "CapEff");
    u64::from_str_radix(&capabilities, 16).unwrap() & (1 << 24) != 0
}

/// A field of `/proc/PID/status`.
pub fn status(process: u32, field: &str) -> String {
    let text = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix(field)?.strip_prefix(':'));
    line.unwrap().trim().to_owned()
}
