//! A full `/dev/shm`, or a full disk of the domain: whoever would write to it says so instead of
//! dying by SIGBUS, and the stop works.

use std::path::PathBuf;

use testkit::python::run;
use testkit::{Place, program, root};

const SCRIPT: &str = r#"
mkdir "$3"
mount -t tmpfs -o "size=$5,mode=700" none "$4" || exit 1
"$1" --scene ipc/scene/scenes/paper-sim.toml --domain "$3" & daemon=$!
for _ in $(seq 100); do [ -e "$3/stop" ] && break; sleep 0.05; done
sleep 0.5
dd if=/dev/zero of="$4/fill" bs=4k 2>/dev/null
for words in status arm disarm stop; do
    said=$(timeout 10 "$2" --domain "$3" $words 2>&1)
    echo "$words: $? $said"
done
kill $daemon
wait $daemon
echo "daemon: $?"
"#;

/// What the programs say while what is mounted here, of this size, is full; nothing where that
/// cannot be tried.
fn said(test: &str, mounted: impl Fn(&Place) -> PathBuf, size: &str) -> Option<String> {
    // A mount of its own needs it.
    if !testkit::is_root(test) || !testkit::are_installed(test, &["unshare"]) {
        return None;
    }
    let place = Place::new();
    let mut shell = testkit::command("unshare");
    shell.args(["--mount", "--propagation", "private", "sh", "-c", SCRIPT]);
    shell
        .arg("sh")
        .arg(program("vpcd"))
        .arg(env!("CARGO_BIN_EXE_vpcctl"));
    shell.arg(place.domain()).arg(mounted(&place)).arg(size);
    let said = run(shell.current_dir(root())).unwrap();
    assert!(said.contains("stop: 0 stop: done"), "{said}");
    assert!(said.contains("daemon: 0"), "{said}");
    Some(said)
}

/// That these requests are refused in these words.
fn assert_told(said: &str, requests: &[&str], told: &str) {
    for words in requests {
        let line = said.lines().find(|line| line.starts_with(words)).unwrap();
        let begin = format!("{words}: 69 vpcctl: domain ");
        assert!(line.starts_with(&begin) && line.contains(told), "{said}");
    }
}

#[test]
fn a_full_shared_memory_is_told_and_the_stop_works() {
    let test = "a_full_shared_memory_is_told_and_the_stop_works";
    if let Some(said) = said(test, |_| "/dev/shm".into(), "24m") {
        let told = "/dev/shm has 0 bytes free; needed: 1048576";
        assert_told(&said, &["status", "arm", "disarm"], told);
    }
}

#[test]
fn a_full_disk_is_told_and_the_stop_works() {
    let test = "a_full_disk_is_told_and_the_stop_works";
    if let Some(said) = said(test, Place::domain, "2m") {
        assert_told(
            &said,
            &["arm", "disarm"],
            "its disk is full; remove what fills it",
        );
    }
}
