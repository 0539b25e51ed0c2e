//! The Debian package: built, looked at, and installed, started, reinstalled, removed and purged on
//! a Debian of its own (root only; the machine's files are not touched).
//!
//! The programs in it are those that lie beside the daemon that is tested, so nothing is built for
//! release.

use std::fs;
use std::path::PathBuf;

use crate::arms::configure;
use crate::fixture::{Place, are_installed, eventually, not_run, root};
use crate::machine::{Machine, may_raise_limits};
use crate::namespace::{is_nobody_elses, serves_the_emulator, starts_ready_and_confined};

/// What the package installs into `/usr/bin`.
const PROGRAMS: [&str; 7] = [
    "hw-sim",
    "vpc-camera",
    "vpc-memory",
    "vpc-panda",
    "vpc-ros2",
    "vpcctl",
    "vpcd",
];
/// The package in the machine.
const PACKAGE: &str = "/var/cache/vpcd.deb";
const AS_USER: &str = "runuser -u vpcd --";
const AS_NOBODY: &str = "setpriv --reuid=65534 --regid=65534 --clear-groups";

/// A package in a place of its own.
struct Package {
    file: PathBuf,
    /// The files that `vpcctl man` wrote, one a line.
    pages: String,
    _place: Place,
}

impl Package {
    /// Builds it; `None` if that cannot be.
    fn build(what: &str) -> Option<Self> {
        let Some(cargo_deb) = cargo_deb() else {
            not_run(
                what,
                "no cargo-deb in PATH or CARGO_HOME/bin (cargo install cargo-deb --version '^3' --locked)",
            );
            return None;
        };
        let tools = [
            "dpkg",
            "gzip",
            "dpkg-shlibdeps=dpkg-dev",
            "deb-systemd-helper=init-system-helpers",
            "strip=binutils",
        ];
        if !are_installed(what, &tools) {
            return None;
        }
        // cargo-deb packs what is below `release` of the target directory, and refuses the profile
        // `dev`.
        let place = Place::new();
        let release = place.path("target/release");
        fs::create_dir_all(&release).unwrap();
        for program in PROGRAMS {
            std::os::unix::fs::symlink(testkit::program(program), release.join(program)).unwrap();
        }
        let share = testkit::command(release.join("vpcctl"))
            .arg("man")
            .arg(release.join("share"))
            .output()
            .unwrap();
        assert!(share.status.success(), "{share:?}");
        // cargo-deb compresses no file below `release` itself.
        let entries = fs::read_dir(release.join("share")).unwrap();
        let pages = entries.map(|entry| entry.unwrap().path());
        let pages = pages.filter(|path| path.extension().is_some_and(|end| end == "1"));
        let gzip = testkit::command("gzip").arg("-9n").args(pages).status();
        assert!(gzip.unwrap().success());
        let file = place.path("vpcd.deb");
        let output = testkit::command(cargo_deb)
            .args(["--package=controller", "--no-build", "--locked"])
            .args(["--offline", "--strip", "--no-dbgsym", "--fast"])
            .args(["--compress-system", "--compress-type=gz", "--output"])
            .arg(&file)
            .current_dir(root())
            .env("CARGO_TARGET_DIR", place.path("target"))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "cargo-deb: {said}");
        assert!(!said.contains("warning"), "cargo-deb: {said}");
        Some(Self {
            file,
            pages: String::from_utf8(share.stdout).unwrap(),
            _place: place,
        })
    }
}

/// Where cargo-deb is.
fn cargo_deb() -> Option<PathBuf> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(std::env::home_dir()?.join(".cargo")));
    in_path("cargo-deb").or_else(|| Some(home?.join("bin/cargo-deb")).filter(|path| path.exists()))
}

fn in_path(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .map(|directory| directory.join(program))
        .find(|path| path.exists())
}

#[test]
#[ignore = "long: builds and installs the Debian package"]
fn a_debian_installs_starts_upgrades_removes_and_purges_it() {
    let Some(package) = Package::build("the package") else {
        return;
    };
    lintian_finds_neither_error_nor_warning(&package);
    let what = "the package in a Debian";
    let booted = Machine::boot(what, |stage| stage.put(&package.file, &PACKAGE[1..]));
    let Some(machine) = booted else {
        return;
    };
    if !machine.run("dpkg --status systemd").0 {
        return not_run(what, "this machine's systemd is not dpkg's");
    }
    // Where the machine has it already.
    machine.run("dpkg --purge vpcd; userdel vpcd");

    install(&machine);
    neither_enables_nor_starts_it(&machine);
    makes_user_and_directory(&machine);
    has_all_files_in_their_places(&machine, &package.pages);
    starts_ready_and_confined(&machine);
    finds_real_time_in_the_service(&machine);
    is_nobody_elses(&machine);
    answers_its_user_alone(&machine);
    serves_the_emulator(&machine);
    an_arm_of_several_has_its_own_service(&machine);
    an_upgrade_keeps_configuration_and_motion(&machine);
    a_removal_stops_all_and_keeps_the_configuration(&machine);
    a_later_installation_finds_things_as_they_were(&machine);
    a_purge_leaves_only_the_user_and_flight_records(&machine);
}

/// What is not for us is in `systemd/lintian-overrides`, with reasons.
fn lintian_finds_neither_error_nor_warning(package: &Package) {
    if !are_installed("lintian", &["lintian"]) {
        return;
    }
    let mut command = testkit::command("lintian");
    command.args(["--fail-on", "error,warning"]);
    if rustix::process::geteuid().is_root() {
        command.arg("--allow-root");
    }
    let output = command.arg(&package.file).output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    assert!(
        output.status.success() && said.is_empty(),
        "lintian: {said}"
    );
}

/// As an administrator would, whatever files an image for containers leaves out.
fn install(machine: &Machine) {
    machine.must(&format!(
        "DEBIAN_FRONTEND=noninteractive dpkg --path-include='*' --install {PACKAGE}"
    ));
    assert_eq!(state(machine), "install ok installed");
}

fn state(machine: &Machine) -> String {
    machine.must("dpkg-query --show --showformat='${Status}' vpcd")
}

fn neither_enables_nor_starts_it(machine: &Machine) {
    let units = [
        ("vpcd", "disabled"),
        ("hw-sim", "static"),
        ("vpc-panda", "static"),
        ("vpc-camera", "static"),
        ("vpc-ros2", "static"),
    ];
    for (unit, enabled) in units {
        let said = machine.run(&format!("systemctl is-enabled {unit}")).1;
        assert_eq!(said, enabled, "{unit}");
        let said = machine.run(&format!("systemctl is-active {unit}")).1;
        assert_eq!(said, "inactive", "{unit}");
    }
}

fn makes_user_and_directory(machine: &Machine) {
    let (is_there, user) = machine.run("getent passwd vpcd");
    assert!(is_there, "there is no user vpcd");
    let fields: Vec<_> = user.split(':').collect();
    assert!(fields[2].parse::<u32>().unwrap() < 1000, "{user}");
    assert!(fields[6].ends_with("/nologin"), "{user}");
    let groups = machine.must("id --groups --name vpcd");
    assert_eq!(groups, "vpcd");
    let found = machine.must("stat -c '%a %U %G' /run/vpcd");
    assert_eq!(found, "700 vpcd vpcd");
}

fn has_all_files_in_their_places(machine: &Machine, pages: &str) {
    let listed = machine.must("dpkg --listfiles vpcd");
    let listed: Vec<_> = listed.lines().collect();
    for path in &listed {
        machine.must(&format!("test -e '{path}'"));
    }
    let mut wanted: Vec<_> = PROGRAMS.map(|name| format!("/usr/bin/{name}")).into();
    for name in [
        "copyright",
        "changelog.Debian.gz",
        "README.md",
        "vpcd.toml",
        "vpcd.schema.json",
    ] {
        wanted.push(format!("/usr/share/doc/vpcd/{name}"));
    }
    for name in ["alerts.yml", "grafana.json", "prometheus.yml"] {
        wanted.push(format!("/usr/share/vpcd/monitoring/{name}"));
    }
    for name in pages.lines().filter(|name| name.ends_with(".1")) {
        wanted.push(format!("/usr/share/man/man1/{name}.gz"));
    }
    for path in &wanted {
        assert!(listed.contains(&path.as_str()), "{path} is not packaged");
    }
    // The units name their documentation; the page is one; programs run and memories fit their
    // scenes.
    for unit in ["vpcd", "hw-sim", "vpc-panda", "vpc-camera", "vpc-ros2"] {
        let named = machine.must(&format!(
            "systemctl show {unit} --value --property=Documentation"
        ));
        let path = named.strip_prefix("file://").unwrap();
        assert!(listed.contains(&path), "{unit}: {path} is not packaged");
    }
    let page = machine.must("gzip -dc /usr/share/man/man1/vpcctl.1.gz");
    assert!(page.contains(".TH vpcctl 1"), "{page}");
    for program in PROGRAMS {
        let said = machine.must(&format!("{AS_USER} /usr/bin/{program} --version"));
        assert!(said.starts_with(program), "{said}");
    }
    for task in ["paper-sim", "paper-robot"] {
        machine.must(&format!(
            "{AS_USER} vpc-memory verify /usr/share/vpcd/{task}.vpcmem --scene /usr/share/vpcd/scenes/{task}.toml"
        ));
    }
    machine.must(&format!(
        "{AS_USER} vpcd --check-only --config /etc/vpcd/vpcd.toml"
    ));
}

/// The daemon's own look at the machine, with the limits and the confinement of its unit.
fn finds_real_time_in_the_service(machine: &Machine) {
    let units = "/usr/lib/systemd/system";
    let start = "ExecStart=/usr/bin/vpcd --config /etc/vpcd/vpcd.toml --preflight";
    machine.must(&format!(
        "sed -e 's/^Type=.*/Type=oneshot/' -e 's|^ExecStart=.*|{start}|' -e '/^Watchdog/d' -e '/^Restart/d' \
         {units}/vpcd.service >/etc/systemd/system/preflight.service && \
         if test -e {units}/vpcd.service.d; then cp -r {units}/vpcd.service.d \
         /etc/systemd/system/preflight.service.d; fi && systemctl daemon-reload"
    ));
    // Whether the machine wakes in time is its own affair.
    machine.run("systemctl start preflight");
    let log = eventually("a verdict", || {
        let log = machine.must("journalctl --no-pager --output=cat --unit=preflight");
        log.contains("for real time").then_some(log)
    });
    let is_found = |what: &str| {
        log.lines()
            .any(|line| line.starts_with("ok") && line.contains(what))
    };
    assert!(is_found("real-time priority"), "{log}");
    if may_raise_limits() {
        assert!(is_found("locked memory"), "{log}");
    } else {
        not_run(
            "locked memory by --preflight",
            "root lacks CAP_SYS_RESOURCE",
        );
    }
}

fn answers_its_user_alone(machine: &Machine) {
    let control = "vpcctl --domain /run/vpcd";
    // 5: disarmed.
    let status = format!("{AS_USER} {control} status --watch 0.2; test $? = 5");
    let said = machine.must(&status);
    assert!(said.contains("disarmed"), "{said}");
    for command in ["status --watch 0.2", "arm"] {
        let (is_answered, said) = machine.run(&format!("{AS_NOBODY} {control} {command}"));
        assert!(!is_answered, "{command} by nobody: {said}");
    }
}

/// The package leaves a daemon at work alone, and the administrator's file.
fn an_upgrade_keeps_configuration_and_motion(machine: &Machine) {
    machine.must("echo '# changed here' >>/etc/vpcd/vpcd.toml && systemctl enable vpcd");
    let processes = || {
        machine.must("systemctl is-active vpcd vpcd@left");
        machine.must("systemctl show vpcd vpcd@left --value --property=MainPID")
    };
    let before = processes();
    starts_to_move(machine);
    install(machine);
    assert_eq!(processes(), before);
    eventually("the second arrival", || {
        let log = machine.must("journalctl --no-pager --unit=hw-sim");
        (log.matches(r#""verdict":"arrived""#).count() == 2).then_some(())
    });
    machine.must("tail -n 1 /etc/vpcd/vpcd.toml | grep -x '# changed here'");
    assert_eq!(machine.run("systemctl is-enabled vpcd").1, "enabled");
}

fn starts_to_move(machine: &Machine) {
    machine.must("systemctl start hw-sim");
    eventually("motion", || {
        machine.run(&format!("{AS_USER} vpcctl --domain /run/vpcd arm"));
        machine
            .run(&format!(
                "{AS_USER} vpcctl --domain /run/vpcd status --watch 0.1"
            ))
            .0
            .then_some(())
    });
}

fn an_arm_of_several_has_its_own_service(machine: &Machine) {
    configure(machine, "left");
    machine.must("systemctl enable --now vpcd@left");
    machine.must(&format!(
        "{AS_USER} vpcctl --domain /run/vpcd-left status --watch 0.2; test $? = 5"
    ));
}

fn a_removal_stops_all_and_keeps_the_configuration(machine: &Machine) {
    starts_to_move(machine);
    machine.must("dpkg --remove vpcd");
    assert_eq!(state(machine), "deinstall ok config-files");
    let (_, active) = machine.run("systemctl is-active vpcd hw-sim vpcd@left");
    assert_eq!(active, "inactive\ninactive\ninactive");
    let log = machine.must("journalctl --no-pager --output=cat --unit=vpcd");
    let last = log.lines().rfind(|line| line.starts_with("vpcd.service: "));
    let last = last.unwrap();
    assert!(
        last.contains("Deactivated successfully") || last.contains("Consumed"),
        "{last}"
    );
    let left = machine.must("ls /dev/shm");
    assert_eq!(left, "", "shared memory is left");
    for path in ["/usr/bin/vpcd", "/usr/lib/systemd/system/vpcd.service"] {
        machine.must(&format!("! test -e {path}"));
    }
    machine.must("tail -n 1 /etc/vpcd/vpcd.toml | grep -x '# changed here'");
}

fn a_later_installation_finds_things_as_they_were(machine: &Machine) {
    install(machine);
    machine.must("tail -n 1 /etc/vpcd/vpcd.toml | grep -x '# changed here'");
    for unit in ["vpcd", "vpcd@left"] {
        let said = machine.run(&format!("systemctl is-enabled {unit}")).1;
        assert_eq!(said, "enabled", "{unit}");
    }
    assert_eq!(machine.show("ActiveState"), "inactive");
    machine.must("systemctl start vpcd");
    assert_eq!(machine.show("ActiveState"), "active");
}

fn a_purge_leaves_only_the_user_and_flight_records(machine: &Machine) {
    // A flight record, and shared memory: of a daemon that was killed, and somebody else's.
    machine.must("systemctl kill --signal=USR1 vpcd");
    eventually("a flight record", || {
        machine.run("ls /var/log/vpcd/*").0.then_some(())
    });
    machine.must("systemctl stop vpcd");
    machine.must("install -o vpcd -m 600 /dev/null /dev/shm/vpc_left");
    machine.must("install -o nobody -m 600 /dev/null /dev/shm/vpc_other");
    let files =
        machine.must("dpkg --listfiles vpcd | while read f; do test -d $f || echo $f; done");
    machine.must("dpkg --purge vpcd");
    let (is_known, _) = machine.run("dpkg-query --show vpcd");
    assert!(!is_known, "dpkg still knows it");
    let more = "/etc/vpcd /usr/share/vpcd /usr/share/doc/vpcd /run/vpcd* /dev/shm/vpc_left \
                /etc/systemd/system/*/vpcd.* /etc/systemd/system/*/vpcd@* /etc/systemd/system/vpcd.* \
                /var/lib/systemd/deb-systemd-helper-*/*vpcd*";
    for path in files.lines().chain(more.split_whitespace()) {
        let (is_left, what) = machine.run(&format!("ls -d {path}"));
        assert!(!is_left, "left: {what}");
    }
    machine.must("test -e /dev/shm/vpc_other");
    // They tell what an arm did.
    machine.must("ls /var/log/vpcd/* && rm -r /var/log/vpcd");
    // Its number must not come to mean somebody else while files of it are about: Debian's custom.
    machine.must("getent passwd vpcd");
}
