//! A full `/dev/shm`: whoever would write to it says so instead of dying by SIGBUS, and the stop
//! works.

use testkit::python::run;
use testkit::{Place, program, root};

const SCRIPT: &str = r#"
mount -t tmpfs -o size=24m none /dev/shm || exit 1
"$1" --scene ipc/scene/scenes/paper-sim.toml --domain "$3" & daemon=$!
for _ in $(seq 100); do [ -e "$3/stop" ] && break; sleep 0.05; done
sleep 0.5
dd if=/dev/zero of=/dev/shm/fill bs=4k 2>/dev/null
for words in status arm disarm stop; do
    said=$(timeout 10 "$2" --domain "$3" $words 2>&1)
    echo "$words: $? $said"
done
kill $daemon
wait $daemon
echo "daemon: $?"
"#;

#[test]
fn a_full_shared_memory_is_told_and_the_stop_works() {
    const TEST: &str = "a_full_shared_memory_is_told_and_the_stop_works";
    // A mount of its own needs it.
    if !testkit::is_root(TEST) || !testkit::are_installed(TEST, &["unshare"]) {
        return;
    }
    let place = Place::new();
    let mut shell = testkit::command("unshare");
    shell.args([
        "--mount",
        "--propagation",
        "private",
        "sh",
        "-c",
        SCRIPT,
        "sh",
    ]);
    shell.arg(program("vpcd")).arg(env!("CARGO_BIN_EXE_vpcctl"));
    shell.arg(place.domain()).current_dir(root());
    let said = run(&mut shell).unwrap();
    for words in ["status", "arm", "disarm"] {
        let line = said.lines().find(|line| line.starts_with(words)).unwrap();
        let begin = format!("{words}: 69 vpcctl: domain ");
        assert!(line.starts_with(&begin), "{said}");
        assert!(
            line.contains("/dev/shm has 0 bytes free; needed: 1048576"),
            "{said}"
        );
    }
    assert!(said.contains("stop: 0 stop: done"), "{said}");
    assert!(said.contains("daemon: 0"), "{said}");
}
