//! The machine: limits, clock, logind, the unit.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Resource, getrlimit};

use super::Finding;

/// Patience with systemctl.
const PATIENCE: Duration = Duration::from_secs(2);
/// The first number of an ordinary user, as systemd draws the line.
const ORDINARY: u32 = 1000;

pub(super) fn examine() -> Vec<Finding> {
    let us = rustix::process::geteuid().as_raw();
    let mut findings = vec![limits(
        us == 0,
        getrlimit(Resource::Rtprio).current,
        getrlimit(Resource::Memlock).current,
    )];
    let source = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    findings.extend(
        std::fs::read_to_string(source)
            .ok()
            .map(|name| clock(name.trim())),
    );
    if Path::new("/run/systemd/system").is_dir() {
        findings.push(logind(us, Path::new("/")));
        findings.extend(unit().map(|properties| judge(&properties)));
    }
    findings
}

/// Limits of this session, which a daemon started by hand would have; `None` is unlimited.
fn limits(is_root: bool, priority: Option<u64>, memory: Option<u64>) -> Finding {
    let what = "limits";
    let remedy = "`vpcd --preflight` tells all; raise rtprio and memlock in /etc/security/limits.d, \
         or run the service, which has them";
    match (is_root, priority, memory) {
        (true, ..) => Finding::ok(
            what,
            "root: real-time priority and locked memory may be had",
        ),
        (_, Some(0), _) => Finding::warn(
            what,
            "no real-time priority for this user (RLIMIT_RTPRIO 0)",
            remedy,
        ),
        (_, _, Some(bytes)) => {
            let words = format!("only {} KiB may be locked (RLIMIT_MEMLOCK)", bytes >> 10);
            Finding::warn(what, words, remedy)
        }
        (_, priority, None) => {
            let most = priority.map_or("any".to_owned(), |most| format!("up to {most}"));
            Finding::ok(
                what,
                format!("real-time priority {most}, memory may be locked"),
            )
        }
    }
}

fn clock(source: &str) -> Finding {
    match source {
        "hpet" | "acpi_pm" | "pit" | "jiffies" | "refined-jiffies" => {
            let remedy = "the kernel gave up on tsc: see dmesg | grep -i tsc; reading it is slow";
            Finding::warn("clock", format!("clock source {source}"), remedy)
        }
        _ => Finding::ok("clock", format!("clock source {source}")),
    }
}

/// Whether logind would remove our shared memory at the end of the session.
fn logind(us: u32, root: &Path) -> Finding {
    let what = "logind";
    if us < ORDINARY {
        return Finding::ok(what, "system user: its shared memory outlives sessions");
    }
    if !removes(root) {
        return Finding::ok(what, "RemoveIPC=no: shared memory outlives sessions");
    }
    let name = user(us, &root.join("etc/passwd")).unwrap_or_else(|| us.to_string());
    if root.join("var/lib/systemd/linger").join(&name).exists() {
        return Finding::ok(
            what,
            format!("{name} lingers: shared memory outlives sessions"),
        );
    }
    let words = format!("shared memory of {name} is removed at the end of the last session");
    let remedy =
        format!("loginctl enable-linger {name}, or RemoveIPC=no in /etc/systemd/logind.conf");
    Finding::warn(what, words, remedy)
}

/// RemoveIPC of logind's configuration: the last word wins, drop-ins after the file; yes by default.
fn removes(root: &Path) -> bool {
    let mut files = vec![root.join("etc/systemd/logind.conf")];
    for place in [
        "usr/lib/systemd/logind.conf.d",
        "run/systemd/logind.conf.d",
        "etc/systemd/logind.conf.d",
    ] {
        let mut parts: Vec<_> = std::fs::read_dir(root.join(place))
            .into_iter()
            .flatten()
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect();
        parts.sort();
        files.extend(parts);
    }
    let texts: Vec<String> = files
        .iter()
        .filter_map(|file| std::fs::read_to_string(file).ok())
        .collect();
    let last = texts
        .iter()
        .flat_map(|text| text.lines())
        .filter_map(|line| line.trim().strip_prefix("RemoveIPC="))
        .next_back();
    !matches!(last.map(str::trim), Some("no" | "false" | "off" | "0"))
}

fn user(number: u32, passwd: &Path) -> Option<String> {
    let text = std::fs::read_to_string(passwd).ok()?;
    let mut lines = text.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let line = lines.find(|words| words.get(2) == Some(&number.to_string().as_str()))?;
    line.first().map(|name| (*name).to_owned())
}

/// What systemd says of the unit; `None` where it does not say anything in time.
fn unit() -> Option<String> {
    let mut child = Command::new("systemctl")
        .args([
            "show",
            "vpcd.service",
            "-p",
            "LoadState,ActiveState,SubState,Result,NRestarts",
        ])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let end = Instant::now() + PATIENCE;
    while child.try_wait().ok()?.is_none() {
        if Instant::now() >= end {
            // It hangs: nothing to be learnt from it.
            let _ = child.kill();
            let _ = child.wait();
            return None;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output().ok()?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn judge(properties: &str) -> Finding {
    let what = "unit";
    let value = |name: &str| {
        let mut lines = properties.lines().filter_map(|line| line.split_once('='));
        lines
            .find(|(key, _)| *key == name)
            .map_or("", |(_, value)| value)
    };
    let words = format!(
        "vpcd.service is {} ({})",
        value("ActiveState"),
        value("SubState")
    );
    match (value("LoadState"), value("ActiveState"), value("NRestarts")) {
        ("not-found" | "", ..) => Finding::ok(what, "vpcd.service is not installed"),
        ("masked", ..) => Finding::warn(what, "vpcd.service is masked", "systemctl unmask vpcd"),
        (_, "failed", _) => {
            let words = format!("{words}: {}", value("Result"));
            let remedy = "journalctl -u vpcd -n 50; then systemctl reset-failed vpcd, and start it";
            Finding::fail(what, words, remedy)
        }
        (_, _, "0" | "") => Finding::ok(what, words),
        (_, _, restarts) => {
            let words = format!("{words}, restarted {restarts} times");
            Finding::warn(what, words, "journalctl -u vpcd -p warning")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Verdict;
    use super::*;

    #[test]
    fn limits_that_are_too_low_are_named() {
        assert_eq!(limits(true, Some(0), Some(0)).verdict, Verdict::Ok);
        assert!(limits(false, Some(0), None).found.contains("RTPRIO"));
        assert!(
            limits(false, Some(90), Some(8 << 20))
                .found
                .contains("8192 KiB")
        );
        assert_eq!(limits(false, Some(90), None).verdict, Verdict::Ok);
    }

    #[test]
    fn slow_clocks_are_warned_of() {
        assert_eq!(clock("tsc").verdict, Verdict::Ok);
        assert_eq!(clock("hpet").verdict, Verdict::Warn);
    }

    #[test]
    fn an_ordinary_user_must_linger_unless_logind_spares_shared_memory() {
        let root = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        write(
            "etc/passwd",
            "root:x:0:0::/:/bin/sh\nann:x:1000:1000::/home/ann:/bin/sh\n",
        );
        write("etc/systemd/logind.conf", "[Login]\n#RemoveIPC=no\n");
        let judged = |us| logind(us, root.path()).verdict;
        assert_eq!(judged(998), Verdict::Ok);
        assert_eq!(judged(1000), Verdict::Warn);
        assert!(
            logind(1000, root.path())
                .remedy
                .starts_with("loginctl enable-linger ann,")
        );
        write("var/lib/systemd/linger/ann", "");
        assert_eq!(judged(1000), Verdict::Ok);
        assert_eq!(judged(1001), Verdict::Warn);
        write(
            "etc/systemd/logind.conf.d/50-ipc.conf",
            "[Login]\nRemoveIPC=no\n",
        );
        assert_eq!(judged(1001), Verdict::Ok);
    }

    #[test]
    fn a_failed_unit_is_a_failure_and_a_missing_one_is_not() {
        let failed = "LoadState=loaded\nActiveState=failed\nSubState=failed\nResult=watchdog\n";
        assert_eq!(judge(failed).verdict, Verdict::Fail);
        assert!(judge(failed).found.contains("watchdog"));
        assert_eq!(
            judge("LoadState=not-found\nActiveState=inactive\n").verdict,
            Verdict::Ok
        );
        let again = "LoadState=loaded\nActiveState=active\nSubState=running\nNRestarts=3\n";
        assert_eq!(judge(again).verdict, Verdict::Warn);
        assert_eq!(judge(&again.replace('3', "0")).verdict, Verdict::Ok);
    }
}
