//! The machine: logind, the unit. What it lacks for real time, `vpcd --preflight` tells.

use std::path::Path;
use std::process::Command;

use super::Finding;

/// The first number of an ordinary user, as systemd draws the line.
const ORDINARY: u32 = 1000;

pub(super) fn examine() -> Vec<Finding> {
    let mut findings = Vec::new();
    if Path::new("/run/systemd/system").is_dir() {
        let us = rustix::process::geteuid().as_raw();
        findings.push(logind(us, Path::new("/")));
        findings.extend(unit().map(|properties| judge(&properties)));
    }
    let hint = "`vpcd --preflight` tells what this machine lacks";
    findings.push(Finding::ok("real time", hint));
    findings
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
        let words = format!("{name} lingers: shared memory outlives sessions");
        return Finding::ok(what, words);
    }
    let words = format!("shared memory of {name} is removed at the end of the last session");
    let remedy =
        format!("loginctl enable-linger {name}, or RemoveIPC=no in /etc/systemd/logind.conf");
    Finding::warn(what, words, remedy)
}

/// RemoveIPC of logind's configuration: the last word wins, drop-ins after the file; yes by default.
fn removes(root: &Path) -> bool {
    let mut files = vec![root.join("etc/systemd/logind.conf")];
    for place in ["usr/lib", "run", "etc"] {
        let place = root.join(place).join("systemd/logind.conf.d");
        let entries = std::fs::read_dir(place).into_iter().flatten().flatten();
        let mut parts: Vec<_> = entries.map(|entry| entry.path()).collect();
        parts.sort();
        files.extend(parts);
    }
    let texts = files
        .iter()
        .filter_map(|file| std::fs::read_to_string(file).ok());
    let text = texts.collect::<Vec<_>>().join("\n");
    let mut words = text
        .lines()
        .filter_map(|line| line.trim().strip_prefix("RemoveIPC="));
    let last = words.next_back().map(str::trim);
    !matches!(last, Some("no" | "false" | "off" | "0"))
}

fn user(number: u32, passwd: &Path) -> Option<String> {
    let (text, number) = (std::fs::read_to_string(passwd).ok()?, number.to_string());
    let mut lines = text.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let line = lines.find(|words| words.get(2) == Some(&number.as_str()))?;
    Some(line[0].to_owned())
}

/// What systemd says of the unit; `None` where it says nothing in time.
fn unit() -> Option<String> {
    let properties = "LoadState,ActiveState,SubState,Result,NRestarts";
    let mut command = Command::new("timeout");
    command.args(["2", "systemctl", "show", "vpcd.service", "-p", properties]);
    let output = command
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn judge(properties: &str) -> Finding {
    let what = "unit";
    let value = |name: &str| {
        let mut lines = properties.lines().filter_map(|line| line.split_once('='));
        let found = lines.find(|(key, _)| *key == name);
        found.map_or("", |(_, value)| value)
    };
    let (active, sub) = (value("ActiveState"), value("SubState"));
    let words = format!("vpcd.service is {active} ({sub})");
    match (value("LoadState"), active, value("NRestarts")) {
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
