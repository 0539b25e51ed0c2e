//! The installed files under a real systemd, in namespaces of its own (root only).
//!
//! One test, since booting costs a second: each step finds what the step before left.

use std::fs;
use std::path::Path;

use rustix::process::Signal;

use crate::fixture::{Frozen, eventually, not_run, root, spin, thread, units};
use crate::machine::{Machine, Stage, may_raise_limits, status};

/// What `sed` makes of a configuration for lockstep, in which nobody is late on a busy machine.
const LOCKSTEP: &str = r#"s/^clock = "fixed"/clock = "lockstep"/"#;

/// The files of the package where it would install them.
pub fn install(stage: &Stage) {
    let files = root().join("controller/systemd");
    let vpcd = Path::new(env!("CARGO_BIN_EXE_vpcd"));
    stage.put(vpcd, "usr/bin/vpcd");
    for name in ["hw-sim", "vpcctl"] {
        let built = vpcd.with_file_name(name);
        if built.exists() {
            stage.put(&built, &format!("usr/bin/{name}"));
        }
    }
    for name in ["vpcd.toml", "hw-sim.toml"] {
        stage.put(&files.join(name), &format!("etc/vpcd/{name}"));
    }
    for name in units() {
        stage.put(&files.join(&name), &format!("units/{name}"));
    }
    stage.put(&files.join("vpcd.sysusers"), "usr/lib/sysusers.d/vpcd.conf");
    stage.put(&files.join("vpcd.tmpfile"), "usr/lib/tmpfiles.d/vpcd.conf");
    for name in ["paper-sim.toml", "paper-sim-starts.csv"] {
        stage.put(
            &root().join("ipc/scene/scenes").join(name),
            &format!("usr/share/vpcd/scenes/{name}"),
        );
    }
    stage.put(
        &root().join("memory-blob/default/paper-sim.vpcmem"),
        "usr/share/vpcd/paper-sim.vpcmem",
    );
}

#[test]
fn a_real_systemd_starts_restarts_and_stops_it() {
    let Some(machine) = Machine::boot("a real systemd", install) else {
        return;
    };
    // As the package's scripts do.
    machine.must("systemd-sysusers vpcd.conf && systemd-tmpfiles --create vpcd.conf");
    starts_ready_and_confined(&machine);
    is_nobody_elses(&machine);
    writes_to_the_journal(&machine);
    writes_to_standard_error_where_that_is_not_the_journal(&machine);
    is_reloaded(&machine);
    lives_longer_than_the_watchdog(&machine);
    is_restarted_after_a_kill_and_after_hangs(&machine);
    serves_the_emulator(&machine);
    is_restarted_after_an_endless_loop(&machine);
    stops_cleanly(&machine);
    a_wrong_configuration_is_not_restarted(&machine);
}

pub fn starts_ready_and_confined(machine: &Machine) {
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
        not_run(
            "LimitRTPRIO=, LimitMEMLOCK=, no capabilities",
            "root lacks CAP_SYS_RESOURCE",
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

pub fn is_nobody_elses(machine: &Machine) {
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
        (&"6".into(), &"1".into()),
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

fn is_reloaded(machine: &Machine) {
    let before = machine.show("MainPID");
    machine.must("systemctl reload vpcd");
    eventually("a new beginning", || {
        let log = machine.must("journalctl --no-pager --unit=vpcd");
        let (_, since) = log.split_once("begins again with the files")?;
        since.contains("disarmed: not armed").then_some(())
    });
    eventually("the service is active", || {
        (machine.show("ActiveState") == "active").then_some(())
    });
    assert_eq!(machine.show("MainPID"), before);
    assert_eq!(machine.show("NRestarts"), "0");
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

/// Under SCHED_FIFO an endless loop would keep a core to itself; the kernel ends it, or on a
/// machine that gives the loop less than half of a core, the watchdog.
fn is_restarted_after_an_endless_loop(machine: &Machine) {
    if !spin(thread(machine.daemon(), "vpcd")) {
        return not_run("an endless loop", "unknown processor");
    }
    eventually("a restart", || {
        (machine.show("NRestarts") == "4").then_some(())
    });
    machine.restarted("4");
    let log = machine.must("journalctl --no-pager --unit=vpcd");
    let is_ended_by_watchdog = log.matches("Watchdog timeout").count() == 3;
    assert!(
        log.contains("status=24/XCPU") || is_ended_by_watchdog,
        "{log}"
    );
}

pub fn serves_the_emulator(machine: &Machine) {
    if !machine
        .run("test -x /usr/bin/hw-sim -a -x /usr/bin/vpcctl")
        .0
    {
        return not_run(
            "the pair of services",
            "hw-sim and vpcctl are not built (cargo build)",
        );
    }
    let restarts = machine.show("NRestarts");
    let begin_again = |change: &str| {
        machine.must(&format!(
            "sed -i '{change}' /etc/vpcd/vpcd.toml /etc/vpcd/hw-sim.toml"
        ));
        machine.must("systemctl reload vpcd");
        eventually("the service is active", || {
            (machine.show("ActiveState") == "active").then_some(())
        });
    };
    begin_again(LOCKSTEP);
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
        ("active".into(), restarts)
    );
    assert_eq!(machine.must("stat -c '%a %U' /run/vpcd"), "700 vpcd");
    begin_again(r#"s/^clock = "lockstep"/clock = "fixed"/"#);
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
