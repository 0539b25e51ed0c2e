//! The installed files under a real systemd, in namespaces of its own (root only).
//!
//! One test, since booting costs a second: each step finds what the step before left. The whole ends within a minute,
//! whatever happens: `timeout` kills process 1 of the namespace then, and everything in it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::fixture::{Frozen, Place, eventually, is_root, root, spin, thread};

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

/// A systemd at work.
struct Machine {
    boot: Child,
    /// Its process 1, as we see it.
    init: u32,
    cgroup: PathBuf,
    // Last: the stage must outlive the mounts.
    _place: Place,
}

impl Machine {
    fn boot() -> Option<Self> {
        if !is_root("a real systemd") {
            return None;
        }
        for tool in [
            "/lib/systemd/systemd",
            "/usr/bin/unshare",
            "/usr/bin/nsenter",
            "/usr/bin/timeout",
        ] {
            if !Path::new(tool).exists() {
                eprintln!("NOT RUN: a real systemd: {tool} is missing");
                return None;
            }
        }
        let Some(cgroup) = cgroup() else {
            eprintln!("NOT RUN: a real systemd: no cgroup v2 that we may write to");
            return None;
        };
        let place = Place::new();
        let stage = stage(&place);
        // The shell enters the cgroup before the namespace is made, so that it becomes its root.
        let script = r#"echo $$ > "$2/cgroup.procs" && exec timeout --signal=KILL 60 \
            unshare --fork --kill-child --pid --mount --uts --ipc --cgroup sh "$3" "$1" "$2""#;
        let mut boot = Command::new("/bin/sh")
            .args(["-c", script, "boot"])
            .args([&stage, &cgroup])
            .arg(root().join("controller/tests/service/boot.sh"))
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
            cgroup,
            _place: place,
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
    fn run(&self, line: &str) -> (bool, String) {
        let output = Command::new("/usr/bin/nsenter")
            .args([
                "--all",
                "--target",
                &self.init.to_string(),
                "/bin/sh",
                "-c",
                line,
            ])
            .env("SYSTEMD_PAGER", "")
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

    fn must(&self, line: &str) -> String {
        let (is_done, text) = self.run(line);
        assert!(
            is_done,
            "{line}: {text}\n{}",
            self.run("journalctl --no-pager -n 60").1
        );
        text
    }

    fn show(&self, property: &str) -> String {
        self.must(&format!(
            "systemctl show vpcd --value --property={property}"
        ))
    }

    /// The daemon's process, as we see it.
    fn daemon(&self) -> u32 {
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

    fn signal(&self, process: u32, signal: Signal) {
        kill_process(Pid::from_raw(process as i32).unwrap(), signal).unwrap();
    }

    /// Waits until the daemon was restarted so many times and is ready again.
    fn restarted(&self, times: &str) {
        eventually("a restart", || {
            (self.show("NRestarts") == times && self.show("ActiveState") == "active").then_some(())
        });
    }

    fn journal(&self) -> Vec<Value> {
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
        // A kill takes its time.
        let is_empty = (0..500).any(|_| {
            let is_removed = remove(&self.cgroup).is_ok();
            if !is_removed {
                std::thread::sleep(Duration::from_millis(10));
            }
            is_removed
        });
        assert!(is_empty || std::thread::panicking(), "processes are left");
    }
}

/// A cgroup of our own below the one that is mounted.
fn cgroup() -> Option<PathBuf> {
    let mounts = fs::read_to_string("/proc/self/mounts").ok()?;
    let mount = mounts.lines().find_map(|line| {
        let fields: Vec<_> = line.split(' ').collect();
        (fields.get(2) == Some(&"cgroup2")).then(|| fields[1].to_owned())
    })?;
    let path = Path::new(&mount).join(format!("vpcd-test-{}", std::process::id()));
    fs::create_dir(&path).ok()?;
    Some(path)
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

/// The files of the package where it would install them, and the units of a minimal boot.
fn stage(place: &Place) -> PathBuf {
    let (stage, root) = (place.path("stage"), root());
    let put = |from: &Path, to: &str| {
        let to = stage.join(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(from, to).unwrap();
    };
    let files = root.join("controller/systemd");
    let vpcd = Path::new(env!("CARGO_BIN_EXE_vpcd"));
    put(vpcd, "usr/bin/vpcd");
    for name in ["hw-sim", "vpcctl"] {
        let built = vpcd.with_file_name(name);
        if built.exists() {
            put(&built, &format!("usr/bin/{name}"));
        }
    }
    for name in ["vpcd.toml", "hw-sim.toml"] {
        put(&files.join(name), &format!("etc/vpcd/{name}"));
    }
    for name in ["vpcd.service", "hw-sim.service"] {
        put(&files.join(name), &format!("etc/test-units/{name}"));
    }
    put(&files.join("vpcd.sysusers"), "usr/lib/sysusers.d/vpcd.conf");
    put(&files.join("vpcd.tmpfile"), "usr/lib/tmpfiles.d/vpcd.conf");
    for name in ["paper-sim.toml", "paper-sim-starts.csv"] {
        put(
            &root.join("ipc/scene/scenes").join(name),
            &format!("usr/share/vpcd/scenes/{name}"),
        );
    }
    put(
        &root.join("memory-blob/default/paper-sim.vpcmem"),
        "usr/share/vpcd/paper-sim.vpcmem",
    );
    for name in STOCK {
        put(
            &Path::new("/lib/systemd/system").join(name),
            &format!("etc/test-units/{name}"),
        );
    }
    if !may_raise_limits() {
        // In place of the limit that cannot be given.
        let text =
            "[Service]\nAmbientCapabilities=CAP_SYS_NICE\nCapabilityBoundingSet=CAP_SYS_NICE\n";
        let directory = stage.join("etc/test-units/vpcd.service.d");
        fs::create_dir(&directory).unwrap();
        fs::write(directory.join("nice.conf"), text).unwrap();
    }
    for name in TARGETS {
        let more = match name {
            "test.target" => "Wants=systemd-journald.service\n",
            _ => "",
        };
        let text = format!("[Unit]\nDescription={name}\nDefaultDependencies=no\n{more}");
        fs::write(stage.join("etc/test-units").join(name), text).unwrap();
    }
    stage
}

/// Whether root is root in this: containers often keep CAP_SYS_RESOURCE back, and then units cannot raise limits.
fn may_raise_limits() -> bool {
    let capabilities = status(std::process::id(), "CapEff");
    u64::from_str_radix(&capabilities, 16).unwrap() & (1 << 24) != 0
}

/// A field of `/proc/PID/status`.
fn status(process: u32, field: &str) -> String {
    let text = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix(field)?.strip_prefix(':'));
    line.unwrap().trim().to_owned()
}

#[test]
fn a_real_systemd_starts_restarts_and_stops_it() {
    let Some(machine) = Machine::boot() else {
        return;
    };
    starts_ready_and_confined(&machine);
    is_nobody_elses(&machine);
    writes_to_the_journal(&machine);
    writes_to_standard_error_where_that_is_not_the_journal(&machine);
    outlives_a_hang_up(&machine);
    lives_longer_than_the_watchdog(&machine);
    is_restarted_after_a_kill_and_after_hangs(&machine);
    serves_the_emulator(&machine);
    is_restarted_after_an_endless_loop(&machine);
    stops_cleanly(&machine);
    a_wrong_configuration_is_not_restarted(&machine);
}

fn starts_ready_and_confined(machine: &Machine) {
    // Returns when READY=1 was said.
    machine.must("systemctl start vpcd");
    assert_eq!(machine.show("ActiveState"), "active");
    assert_eq!(machine.show("NRestarts"), "0");
    eventually("a status", || {
        machine
            .show("StatusText")
            .contains("disarmed: not armed")
            .then_some(())
    });
    let daemon = machine.daemon();
    let uid = machine.must("id -u vpcd");
    assert_eq!(status(daemon, "Uid"), [&*uid; 4].join("\t"));
    assert_eq!(
        (status(daemon, "NoNewPrivs"), status(daemon, "Seccomp")),
        ("1".into(), "2".into())
    );
    let is_limited = !may_raise_limits();
    if is_limited {
        eprintln!(
            "NOT CHECKED: LimitRTPRIO=, LimitMEMLOCK=, no capabilities: root lacks CAP_SYS_RESOURCE here"
        );
    } else {
        assert_eq!(status(daemon, "CapEff"), "0000000000000000");
        assert_ne!(status(daemon, "VmLck"), "0 kB");
    }
    // Real time, in spite of all that is forbidden: SCHED_FIFO, priority 80.
    let stat = fs::read_to_string(format!("/proc/{daemon}/task/{daemon}/stat")).unwrap();
    let fields: Vec<_> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
    assert_eq!(
        (fields[37], fields[38]),
        ("80", "1"),
        "priority and policy: {stat}"
    );
    let log = machine.must("journalctl --no-pager --unit=vpcd");
    let degraded = if is_limited { 1 } else { 0 };
    assert_eq!(log.matches("DEGRADED").count(), degraded, "{log}");
}

fn is_nobody_elses(machine: &Machine) {
    assert_eq!(
        machine.must("stat -c '%a %U %G' /run/vpcd"),
        "700 vpcd vpcd"
    );
    let modes = machine.must("stat -c '%a %U' /dev/shm/vpc_*");
    assert!(modes.lines().count() >= 4, "{modes}");
    for line in modes.lines() {
        let (mode, user) = line.split_once(' ').unwrap();
        assert!(mode.ends_with("00") && user == "vpcd", "{modes}");
    }
    let as_nobody = "setpriv --reuid=65534 --regid=65534 --clear-groups";
    let (is_open, text) = machine.run(&format!("{as_nobody} ls /run/vpcd"));
    assert!(!is_open && text.contains("Permission denied"), "{text}");
    let (is_open, text) = machine.run(&format!(
        "for f in /dev/shm/vpc_*; do {as_nobody} cat $f && exit 0; done; exit 1"
    ));
    assert!(!is_open && text.contains("Permission denied"), "{text}");
}

fn writes_to_the_journal(machine: &Machine) {
    let entry = eventually("a line of the log", || {
        machine
            .journal()
            .into_iter()
            .find(|entry| entry["MESSAGE"] == "disarmed: not armed")
    });
    // As an entry of its own with fields, not as a line of standard error.
    assert_eq!(entry["_TRANSPORT"], "journal", "{entry}");
    assert_eq!(entry["SYSLOG_IDENTIFIER"], "vpcd", "{entry}");
    assert_eq!(
        (&entry["PRIORITY"], &entry["VPCD_CYCLE"]),
        (&"4".into(), &"1".into()),
        "{entry}"
    );
}

/// `JOURNAL_STREAM` may be inherited from a service that redirected its standard error.
fn writes_to_standard_error_where_that_is_not_the_journal(machine: &Machine) {
    let line = "vpcd --scene /usr/share/vpcd/scenes/paper-sim.toml --domain /tmp/other --cycles 2";
    let log = machine.must(&format!("JOURNAL_STREAM=1:1 {line} 2>&1"));
    assert!(log.contains("cycles=2"), "{log}");
}

/// Who works is not taken for hung: it lives for longer than the watchdog's two seconds.
fn lives_longer_than_the_watchdog(machine: &Machine) {
    eventually("75 cycles", || {
        let text = machine.show("StatusText");
        let (before, _) = text.split_once(" cycles")?;
        let cycles: u64 = before.rsplit(' ').next()?.parse().ok()?;
        (cycles >= 75).then_some(())
    });
    assert_eq!(machine.show("NRestarts"), "0");
}

fn outlives_a_hang_up(machine: &Machine) {
    let before = machine.show("MainPID");
    machine.must("systemctl kill --signal=HUP vpcd");
    eventually("a note", || {
        machine
            .must("journalctl --no-pager --unit=vpcd")
            .contains("SIGHUP: nothing to do")
            .then_some(())
    });
    assert_eq!(machine.show("MainPID"), before);
}

fn is_restarted_after_a_kill_and_after_hangs(machine: &Machine) {
    machine.signal(machine.daemon(), Signal::KILL);
    machine.restarted("1");
    // The whole process hangs; then the loop alone, while the ordinary thread goes on.
    machine.signal(machine.daemon(), Signal::STOP);
    machine.restarted("2");
    let daemon = machine.daemon();
    let frozen = Frozen::freeze(thread(daemon, "vpcd"));
    eventually("the end of the daemon", || {
        frozen.reap();
        (machine.show("NRestarts") == "3").then_some(())
    });
    machine.restarted("3");
    let log = machine.must("journalctl --no-pager --unit=vpcd");
    assert_eq!(log.matches("Watchdog timeout").count(), 2, "{log}");
    assert!(log.contains("the loop stands still"), "{log}");
}

/// Under SCHED_FIFO an endless loop would keep a core to itself; the kernel ends it before the watchdog has to.
fn is_restarted_after_an_endless_loop(machine: &Machine) {
    if !spin(thread(machine.daemon(), "vpcd")) {
        eprintln!("NOT RUN: an endless loop: unknown processor");
        return;
    }
    eventually("a restart", || {
        (machine.show("NRestarts") == "4").then_some(())
    });
    machine.restarted("4");
    let log = machine.must("journalctl --no-pager --unit=vpcd");
    assert!(log.contains("status=24/XCPU"), "{log}");
}

fn serves_the_emulator(machine: &Machine) {
    if !machine
        .run("test -x /usr/bin/hw-sim -a -x /usr/bin/vpcctl")
        .0
    {
        eprintln!(
            "NOT RUN: the pair of services: hw-sim and vpcctl are not built beside vpcd (cargo build -p hw-sim -p \
             vpcctl)"
        );
        return;
    }
    machine.must("systemctl start hw-sim");
    // As installed it waits for an operator, who must be the service's own user.
    let arm = "vpcctl --domain /run/vpcd arm";
    eventually("arming", || {
        let as_user = format!("runuser -u vpcd -- {arm}");
        machine.run(&as_user).0.then_some(())
    });
    eventually("a verdict", || {
        let (_, state) = machine.run("systemctl is-active hw-sim");
        (state == "inactive" || state == "failed").then_some(())
    });
    let log = machine.must("journalctl --no-pager --unit=hw-sim");
    assert!(log.contains(r#""verdict":"arrived""#), "{log}");
    // It left; the domain is still there, and the daemon goes on.
    assert_eq!(
        (machine.show("ActiveState"), machine.show("NRestarts")),
        ("active".into(), "3".into())
    );
    assert_eq!(machine.must("stat -c '%a %U' /run/vpcd"), "700 vpcd");
}

fn stops_cleanly(machine: &Machine) {
    machine.must("systemctl stop vpcd");
    assert_eq!(machine.show("ActiveState"), "inactive");
    assert_eq!(
        (machine.show("Result"), machine.show("ExecMainStatus")),
        ("success".into(), "0".into())
    );
    let (_, left) = machine.run("ls /dev/shm");
    assert_eq!(left, "", "shared memory is left");
}

fn a_wrong_configuration_is_not_restarted(machine: &Machine) {
    machine.must("systemctl reset-failed vpcd 2>/dev/null; echo 'speed = 3' > /etc/vpcd/vpcd.toml");
    let (is_started, _) = machine.run("systemctl start vpcd");
    assert!(!is_started);
    assert_eq!(
        (machine.show("ActiveState"), machine.show("ExecMainStatus")),
        ("failed".into(), "78".into())
    );
    assert_eq!(machine.show("NRestarts"), "0");
    let text = machine.show("StatusText");
    assert!(text.contains("unknown field `speed`"), "{text}");
    let errors = machine.must("journalctl --no-pager --unit=vpcd --priority=err --output=cat");
    assert!(errors.contains("unknown field `speed`"), "{errors}");
}
