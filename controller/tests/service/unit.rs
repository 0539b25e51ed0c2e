//! The files that are installed: units, user, directories, configuration.

use program::Exit;

use crate::fixture::{Place, installed, root, units, vpcd};

/// Values of a directive.
fn values<'a>(unit: &'a str, directive: &str) -> Vec<&'a str> {
    let lines = unit.lines().filter_map(|line| line.split_once('='));
    lines
        .filter(|(key, _)| *key == directive)
        .map(|(_, value)| value)
        .collect()
}

#[test]
fn what_a_restart_does_not_mend_is_not_restarted() {
    let unit = installed("vpcd.service");
    let listed: Vec<u8> = values(&unit, "RestartPreventExitStatus")
        .iter()
        .flat_map(|codes| codes.split_whitespace())
        .map(|code| code.parse().unwrap())
        .collect();
    let lasting = [Exit::Usage, Exit::Data, Exit::NoInput, Exit::Config];
    assert_eq!(listed, lasting.map(|exit| exit as u8));
    assert_eq!(values(&unit, "Restart"), ["on-failure"]);
}

#[test]
fn all_units_share_user_and_directory() {
    let units = ["vpcd", "hw-sim", "vpc-panda", "vpc-camera", "vpc-ros2"]
        .map(|name| installed(&format!("{name}.service")));
    for (directive, value) in [
        ("User", "vpcd"),
        ("RuntimeDirectory", "vpcd"),
        ("RuntimeDirectoryMode", "0700"),
        ("RuntimeDirectoryPreserve", "yes"),
        ("RemoveIPC", "no"),
        ("UMask", "0077"),
    ] {
        for unit in &units {
            assert_eq!(values(unit, directive), [value], "{directive}: {unit}");
        }
    }
    assert!(installed("vpcd.tmpfile").contains("d /run/vpcd 0700 vpcd vpcd"));
    assert!(installed("vpcd.sysusers").contains("u vpcd "));
}

#[test]
fn what_reads_a_network_is_bounded_in_memory_and_time() {
    let names = units();
    let texts = names.iter().map(|name| (name, installed(name)));
    let reading = texts.filter(|(_, unit)| {
        let families = values(unit, "RestrictAddressFamilies").concat();
        families.contains("AF_INET")
    });
    let mut count = 0;
    for (name, unit) in reading {
        count += 1;
        assert_eq!(values(&unit, "MemoryMax").len(), 1, "{name}");
        let scores = values(&unit, "OOMScoreAdjust");
        assert!(!scores.concat().contains('-'), "{name}: {scores:?}");
        assert_eq!(values(&unit, "TimeoutStopSec"), ["5s"], "{name}");
        if name.starts_with("vpc-ros2") {
            assert_eq!(values(&unit, "WatchdogSec"), ["2s"], "{name}");
            assert_eq!(values(&unit, "Type"), ["notify"], "{name}");
        }
    }
    assert_eq!(count, 4);
}

#[test]
fn the_default_configuration_runs_as_installed() {
    let place = Place::new();
    let root = root();
    let text = installed("vpcd.toml");
    let scenes = root.join("ipc/scene/scenes/");
    let memory = root.join("memory-blob/default/");
    let here = text
        .replace("/usr/share/vpcd/scenes/", &format!("{}/", scenes.display()))
        .replace("/usr/share/vpcd/", &format!("{}/", memory.display()));
    let config = place.file("vpcd.toml", here);
    let mut command = vpcd();
    command.arg("--check-only").arg("--config").arg(config);
    command.stdout(std::process::Stdio::piped());
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        said.contains("strategy foresight") && said.contains("domain /run/vpcd"),
        "{said}"
    );
    // The priority is permitted.
    let priority: u32 = values(&text, "priority ").concat().trim().parse().unwrap();
    let limit: u32 = values(&installed("vpcd.service"), "LimitRTPRIO")
        .concat()
        .parse()
        .unwrap();
    assert!(priority <= limit);
}
