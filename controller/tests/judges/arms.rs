//! Several arms on one machine: an instance of each unit for each, under a real systemd (root only).

use serde_json::{Value, json};

use crate::fixture::{eventually, not_run, root};
use crate::machine::Machine;
use crate::namespace::install;

const ARMS: [&str; 3] = ["left", "middle", "right"];

/// Configures an arm as `controller/systemd/README.md` has it.
pub fn configure(machine: &Machine, arm: &str) {
    let readme = root().join("controller/systemd/README.md");
    let readme = std::fs::read_to_string(readme).unwrap();
    let (_, section) = readme.split_once("## Several arms").unwrap();
    let (_, block) = section.split_once("```sh\n").unwrap();
    let (lines, _) = block.split_once("sudo systemctl start").unwrap();
    assert!(lines.lines().count() == 2, "{lines}");
    machine.must(&lines.replace("sudo ", "").replace("left", arm));
}

fn control(machine: &Machine, arm: &str, command: &str) -> (bool, String) {
    machine.run(&format!(
        "runuser -u vpcd -- vpcctl --domain /run/vpcd-{arm} {command}"
    ))
}

/// Begins a run of each of these arms, and arms it.
fn start(machine: &Machine, arms: &[&str]) {
    let units: Vec<_> = arms.iter().map(|arm| format!("hw-sim@{arm}")).collect();
    machine.must(&format!("systemctl start {}", units.join(" ")));
    for arm in arms {
        eventually("arming", || control(machine, arm, "arm").0.then_some(()));
    }
}

#[test]
fn a_stop_or_crash_of_one_of_three_arms_is_its_own() {
    let Some(machine) = Machine::boot("three arms", install) else {
        return;
    };
    if !machine
        .run("test -x /usr/bin/hw-sim -a -x /usr/bin/vpcctl")
        .0
    {
        return not_run(
            "three arms",
            "hw-sim and vpcctl are not built (cargo build)",
        );
    }
    machine.must("systemd-sysusers vpcd.conf && systemd-tmpfiles --create vpcd.conf");
    // Each begins elsewhere.
    for (arm, start) in ARMS.iter().zip([0, 3, 7]) {
        configure(&machine, arm);
        let file = format!("/etc/vpcd/{arm}/hw-sim.toml");
        machine.must(&format!("sed -i 's/^start = .*/start = {start}/' {file}"));
    }
    let all = |unit: &str| ARMS.map(|arm| format!("{unit}@{arm}")).join(" ");
    machine.must(&format!("systemctl start {}", all("vpcd")));
    for arm in ARMS {
        let found = machine.must(&format!(
            "stat -c '%a %U' /run/vpcd-{arm} /var/log/vpcd/{arm}"
        ));
        assert_eq!(found, "700 vpcd\n700 vpcd");
    }

    // All are armed at the same time; one is stopped, the daemon of another is killed. Whether they
    // arrive, which they may be too late for on a busy machine, does not matter here.
    start(&machine, &ARMS);
    let show = |arm: &str, property: &str| {
        machine.must(&format!(
            "systemctl show vpcd@{arm} --value --property={property}"
        ))
    };
    let before = show("middle", "MainPID");
    let (is_stopped, said) = control(&machine, "left", "stop --timeout 20");
    assert!(is_stopped, "{said}");
    machine.must("systemctl kill --signal=KILL vpcd@right");
    eventually("a restart", || {
        (show("right", "NRestarts") == "1" && show("right", "ActiveState") == "active")
            .then_some(())
    });
    // The middle one is the same as before, and nobody has stopped it.
    assert_eq!(show("middle", "MainPID"), before);
    let vetoed = |arm: &str| -> Value {
        let (_, said) = control(&machine, arm, "status --json --watch 0.5");
        let status: Value = serde_json::from_str(&said).unwrap();
        status["veto"]["action"].clone()
    };
    assert_eq!(
        ["left", "middle", "right"].map(vetoed),
        [json!("stop"), json!(null), json!(null)]
    );
    assert_eq!(show("left", "NRestarts"), "0");
    assert_eq!(show("middle", "NRestarts"), "0");
    let (_, said) = control(&machine, "left", "status --watch 0.1");
    assert!(said.contains("disarmed"), "{said}");

    machine.must(&format!("systemctl stop {} {}", all("hw-sim"), all("vpcd")));
    assert_eq!(machine.run("ls /dev/shm").1, "", "shared memory is left");
}
