//! Another user is refused by the kernel (root only, which becomes that user).

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Stdio;

use crate::fixture::{Manager, Place, ended, files, is_root, scene_file};

/// The user `nobody`.
const NOBODY: u32 = 65534;

/// Opens the file for reading as `nobody`.
fn can_read(path: &Path) -> bool {
    run(path, "exec 3<\"$0\"")
}

/// Opens it for writing, or creates a file in the directory.
fn can_write(path: &Path) -> bool {
    match path.is_dir() {
        true => run(&path.join("intruder"), "exec 3>\"$0\""),
        false => run(path, "exec 3>>\"$0\""),
    }
}

fn run(path: &Path, script: &str) -> bool {
    let mut command = testkit::command("/bin/sh");
    command
        .arg("-c")
        .arg(script)
        .arg(path)
        .uid(NOBODY)
        .gid(NOBODY);
    command.output().unwrap().status.success()
}

#[test]
fn another_user_neither_reads_nor_commands() {
    if !is_root("reading and commanding as another user") {
        return;
    }
    let place = Place::new();
    let manager = Manager::new(&place);
    let daemon = manager.manage(place.vpcd(), None);
    manager.until("READY=1");
    // The probe itself can succeed.
    let open = place.file("open", "");
    std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o666)).unwrap();
    assert!(can_read(&open) && can_write(&open));
    for path in files(&place.domain(), daemon.id()) {
        assert!(!can_read(&path), "{} is read by nobody", path.display());
        assert!(!can_write(&path), "{} is written by nobody", path.display());
    }
    // Nor by the door: a daemon of another user is refused. It runs a copy: a checkout below a home
    // directory of mode 700 is closed to it.
    let program = place.path("vpcd");
    std::fs::copy(env!("CARGO_BIN_EXE_vpcd"), &program).unwrap();
    let scene = place.file("scene.toml", std::fs::read_to_string(scene_file()).unwrap());
    let mut intruder = testkit::command(program);
    intruder.arg("--scene").arg(scene).arg("--domain");
    intruder.arg(place.domain()).uid(NOBODY).gid(NOBODY);
    intruder.stderr(Stdio::piped());
    let (code, message) = ended(intruder);
    assert_eq!(code, 69, "{message}");
    assert!(message.contains("domain"), "{message}");
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
}
