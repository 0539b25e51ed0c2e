//! The units, judged by systemd-analyze, and the log beside a journal.

use std::path::{Path, PathBuf};

use crate::fixture::{Place, are_installed, installed, not_run, units};

/// The unit with a program that exists.
fn placed(place: &Place, name: &str, text: &str) -> PathBuf {
    let line = text
        .lines()
        .find(|line| line.starts_with("ExecStart="))
        .unwrap();
    let start = format!("ExecStart={}", env!("CARGO_BIN_EXE_vpcd"));
    place.file(name, text.replace(line, &start))
}

/// Runs systemd-analyze; `None` if there is none.
fn analyze(arguments: &[&str], unit: &Path) -> Option<(bool, String)> {
    if !are_installed("units", &["systemd-analyze=systemd"]) {
        return None;
    }
    let mut analyze = testkit::command("systemd-analyze");
    let said = testkit::ended(analyze.args(arguments).arg(unit));
    Some((said.code == Some(0), said.stdout + &said.stderr))
}

#[test]
fn systemd_finds_nothing_wrong_with_the_units() {
    let place = Place::new();
    for name in units() {
        // The others name these.
        for daemon in ["vpcd.service", "vpcd@.service"] {
            placed(&place, daemon, &installed(daemon));
        }
        let instance = name.replace('@', "@left");
        let unit = placed(&place, &instance, &installed(&name));
        let Some((is_right, text)) = analyze(&["verify", "--man=no"], &unit) else {
            return;
        };
        // An unknown directive is but a warning to systemd, and is not obeyed.
        assert!(is_right && text.is_empty(), "{name}: {text}");
    }
    let misspelt = installed("vpcd.service").replace("WatchdogSec=", "WatchdogSeconds=");
    let unit = placed(&place, "misspelt.service", &misspelt);
    let (_, text) = analyze(&["verify", "--man=no"], &unit).unwrap();
    assert!(text.contains("WatchdogSeconds"), "{text}");
}

#[test]
fn the_units_are_as_exposed_as_they_must_be_and_no_more() {
    let place = Place::new();
    // In tenths; 0.6 and 0.5 were seen, 1.4 with a network, and 0.8 with cameras (systemd 257).
    for (name, most) in [
        ("vpcd", 7),
        ("hw-sim", 7),
        ("vpc-panda", 15),
        ("vpc-camera", 10),
        ("vpc-ros2", 15),
    ] {
        let name = &format!("{name}.service");
        let unit = placed(&place, name, &installed(name));
        let most = format!("--threshold={most}");
        let arguments = ["security", "--offline=true", &most, "--no-pager"];
        let Some((is_within, text)) = analyze(&arguments, &unit) else {
            return;
        };
        assert!(is_within, "{text}");
    }
}

#[test]
fn without_journald_the_log_goes_to_standard_error() {
    use std::os::unix::fs::MetadataExt;
    if Path::new("/run/systemd/journal/socket").exists() {
        return not_run("the log without a journald", "this machine has a journald");
    }
    let place = Place::new();
    let path = place.file("log", "");
    let file = std::fs::File::options().append(true).open(&path).unwrap();
    let found = file.metadata().unwrap();
    let mut command = place.vpcd();
    command.args(["--cycles", "2"]).stderr(file);
    command.env("JOURNAL_STREAM", format!("{}:{}", found.dev(), found.ino()));
    assert!(command.status().unwrap().success());
    let log = std::fs::read_to_string(&path).unwrap();
    assert!(log.contains("cycles=2"), "{log}");
}
