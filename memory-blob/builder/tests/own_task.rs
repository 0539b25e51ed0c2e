//! A task of one's own by the command: new, mask, preview, build, verify.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

fn vpc_memory(directory: &Path, arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vpc-memory"))
        .args(arguments.split_whitespace())
        .current_dir(directory)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn said(directory: &Path, arguments: &str) -> String {
    let output = vpc_memory(directory, arguments);
    let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments}: {complaint}");
    String::from_utf8(output.stdout).unwrap()
}

fn complaint(directory: &Path, arguments: &str) -> String {
    let output = vpc_memory(directory, arguments);
    assert!(!output.status.success(), "{arguments}");
    String::from_utf8(output.stderr).unwrap()
}

const NEW: &str =
    "new own.toml --image 640x480 --focal 600 --pattern 0.12 --goal 0.4 --limits 0.3,0.8";

fn painted(directory: &Path, name: &str, extra: Option<(u32, u32)>) -> PathBuf {
    let path = directory.join(name);
    let is_white = |i: u32, j: u32| {
        let bar = (80..200).contains(&i) && (60..110).contains(&j);
        bar || Some((i, j)) == extra
    };
    scene::write_mask(&path, 640, 480, is_white).unwrap();
    path
}

#[test]
fn from_a_painted_mask_to_a_verified_memory() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    painted(here, "areas.png", None);
    said(
        here,
        &format!("{NEW} --mask areas.png --ellipse 560,400,40,30"),
    );
    let words = said(here, "preview own.toml -o own.png");
    assert!(words.contains("1 parts, 1 masks of 1 areas"), "{words}");
    assert!(here.join("own.svg").exists() && here.join("own.png").exists());

    said(
        here,
        "build own.toml -o own.vpcmem --trajectories 4 --iterations 20 --gpr-samples 40",
    );
    let words = said(here, "verify own.vpcmem --scene own.toml");
    assert!(words.contains("built for this scene"), "{words}");
    // One pixel more is another task.
    painted(here, "areas.png", Some((300, 20)));
    let words = complaint(here, "verify own.vpcmem --scene own.toml");
    assert!(words.contains("another"), "{words}");
}

#[test]
fn shapes_become_a_mask_that_forbids_the_same_pixels() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    said(
        here,
        &format!("{NEW} --ellipse 560,400,40,30 --box 100,100,60,20"),
    );
    said(here, "mask own.toml -o areas.png --scene-out masked.toml");
    let words = said(here, "preview masked.toml -o masked");
    assert!(words.contains("0 parts, 1 masks of 2 areas"), "{words}");
    said(here, "mask masked.toml -o again.png");
    let read = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert_eq!(read("areas.png"), read("again.png"));
}

#[test]
fn nothing_is_overwritten_and_nothing_invalid_is_written() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let words = complaint(here, "new own.toml --image 640x480");
    assert!(words.contains("--focal is missing"), "{words}");
    let words = complaint(here, &format!("{NEW} --box 320,240,300,200"));
    assert!(
        words.contains("goal: point 0") && !here.join("own.toml").exists(),
        "{words}"
    );
    let words = complaint(here, &format!("{NEW} --mask none.png"));
    assert!(
        words.contains("none.png\": cannot read it") && !here.join("own.toml").exists(),
        "{words}"
    );

    said(here, NEW);
    let words = complaint(here, NEW);
    assert!(
        words.contains("own.toml: exists; allowed: a new file, or --force"),
        "{words}"
    );
    said(here, &format!("{NEW} --force"));
    let words = complaint(here, "mask own.toml -o own.toml");
    assert!(words.contains("exists"), "{words}");
}
