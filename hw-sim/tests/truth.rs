//! The emulator's truth and the bridges' model of the arm share nothing: one mistake must not hide
//! on both sides.

use std::fs::{read_dir, read_to_string};
use std::path::{Path, PathBuf};

fn sources(directory: &Path) -> Vec<PathBuf> {
    let entries = read_dir(directory)
        .expect("a directory")
        .map(|entry| entry.expect("one").path());
    let (directories, mut files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    files.extend(directories.iter().flat_map(|directory| sources(directory)));
    files
}

#[test]
fn the_emulated_bridge_alone_uses_the_crate_arm() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let names_it = |path: &PathBuf| {
        let text = read_to_string(path).expect("text");
        let mut words = text.split(|c: char| !(c.is_alphanumeric() || "_:".contains(c)));
        words.any(|word| word.trim_start_matches(':').starts_with("arm::"))
    };
    let mut users = sources(&here.join("src"));
    users.retain(names_it);
    assert_eq!(users, [here.join("src/robot/bridge.rs")]);
}

#[test]
fn robot_interface_and_renderer_do_not_depend_on_arm() {
    for member in ["panda", "fci", "vision"] {
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join(member)
            .join("Cargo.toml");
        let manifest: toml::Table = read_to_string(manifest)
            .expect("text")
            .parse()
            .expect("TOML");
        let names_it = |part: &str| {
            let part = manifest.get(part).and_then(toml::Value::as_table);
            part.is_some_and(|dependencies| dependencies.contains_key("arm"))
        };
        assert!(
            !names_it("dependencies") && !names_it("build-dependencies"),
            "{member}"
        );
    }
}
