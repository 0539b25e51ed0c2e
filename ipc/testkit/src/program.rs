use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use crate::{is_set, root};

/// The programs and the package of each.
const PACKAGES: [(&str, &str); 5] = [
    ("vpcd", "controller"),
    ("hw-sim", "hw-sim"),
    ("vpcctl", "vpcctl"),
    ("vpc-memory", "memory-builder"),
    ("libvpcclient.so", "vpc-client-c"),
];

/// A program of this workspace, in the profile of the running test.
///
/// Asks cargo to build it, which has nothing to do after `cargo test --workspace`. With `VPC_STRICT=1` cargo is
/// not asked, as CI has built everything before.
///
/// # Panics
/// If the name is unknown, or the program does not build or is not there.
pub fn program(name: &str) -> PathBuf {
    static BUILT: Mutex<BTreeSet<&str>> = Mutex::new(BTreeSet::new());
    let known = PACKAGES.iter().find(|(program, _)| *program == name);
    let (_, package) = known.unwrap_or_else(|| panic!("no program `{name}`"));
    let path = profile_directory().join(name);
    if !is_set("VPC_STRICT")
        && BUILT
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(package)
    {
        build(package);
    }
    assert!(
        path.exists(),
        "{} is not built: cargo build -p {package}",
        path.display()
    );
    path
}

fn build(package: &str) {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .current_dir(root())
        .args(["build", "--quiet", "--package", package]);
    cargo.arg("--target-dir").arg(target_directory());
    if profile_directory().ends_with("release") {
        cargo.arg("--release");
    }
    let status = cargo.status();
    assert!(
        status.is_ok_and(|status| status.success()),
        "{package} does not build"
    );
}

/// Where this build's programs are: `target/debug` or `target/release`.
fn profile_directory() -> PathBuf {
    let test = std::env::current_exe().expect("the path of this test");
    // target/debug/deps/TEST
    test.ancestors().nth(2).unwrap_or(Path::new("/")).to_owned()
}

/// The target directory of this build.
pub fn target_directory() -> PathBuf {
    let mut directory = profile_directory();
    directory.pop();
    directory
}
