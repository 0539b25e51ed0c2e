//! A task of one's own by the command: new, mask, preview, build, verify.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tempfile::TempDir;

fn vpc_memory(directory: &Path, arguments: &str) -> Output {
    testkit::command(env!("CARGO_BIN_EXE_vpc-memory"))
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
    assert!(words.contains("1 part, 1 mask of 1 area;"), "{words}");
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
fn a_scene_with_tags_is_drawn_with_clear_starts() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let shapes = "--ellipse 560,400,40,30";
    said(here, &format!("{NEW} --marker-size 0.03 {shapes}"));
    let words = said(here, "preview own.toml -o own.png");
    // 0.03 m times 600 px over the root of 2 times 0.4 m; the square of 0.12 m is 150 px from the
    // upper side of the image.
    let told = "markers     30 mm: at the goal the law keeps each point 32 px clear";
    assert!(words.contains(told), "{words}");
    assert!(
        words.contains("goal 118 px from the image border"),
        "{words}"
    );
    let words = complaint(here, &format!("{NEW} --marker-size 0.2 {shapes} --force"));
    assert!(words.contains("goal: the marker of point 0"), "{words}");
}

#[test]
fn a_scene_with_its_goal_too_near_its_mask_is_refused() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    said(
        here,
        &format!("{NEW} --marker-size 0.03 --ellipse 60,60,40,30"),
    );
    said(here, "mask own.toml -o areas.png --scene-out painted.toml");
    let words = said(here, "preview painted.toml -o free.png");
    assert!(words.contains("wrote free.svg"), "{words}");
    // Point 2 is at (410, 330) px, and its marker reaches 31.8 px.
    let beside = |i: u32, j: u32| (420..460).contains(&i) && (300..360).contains(&j);
    scene::write_mask(&here.join("areas.png"), 640, 480, beside).unwrap();
    let output = vpc_memory(here, "preview painted.toml -o refused.png");
    assert_eq!(output.status.code(), Some(1));
    let words = String::from_utf8(output.stderr).unwrap();
    let told = "painted.toml: goal: the marker of point 2 reaches 31.8 px from its point";
    assert!(words.contains(told), "{words}");
    assert!(words.contains("; look at refused.png"), "{words}");
    let drawn = |name: &str| std::fs::read_to_string(here.join(name)).unwrap();
    let (refused, free) = (drawn("refused.svg"), drawn("free.svg"));
    // 31.8 px of an image of 640, drawn 360 wide.
    let dashed = "r=\"17.89";
    assert!(
        refused.contains(dashed) && !free.contains(dashed),
        "{refused}"
    );
    assert!(refused.contains("red: refused") && free.contains("red: goal"));
    assert!(here.join("refused.png").exists());
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
    let words = said(here, "starts masked.toml -o starts.csv --count 3");
    assert!(
        words.starts_with("wrote starts.csv: 3 valid starts of masked.toml"),
        "{words}"
    );
    let words = said(here, "preview masked.toml -o masked");
    assert!(words.contains("0 parts, 1 mask of 2 areas;"), "{words}");
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
    let words = said(here, &format!("{NEW} --turn 0.5,0.1 --force"));
    assert!(!words.contains("note"), "{words}");
    let words = complaint(here, "mask own.toml -o own.toml");
    assert!(words.contains("exists"), "{words}");
}

/// Types answers on a terminal, then the end of the input; what was asked and said, and whether it
/// went well.
fn typed(directory: &Path, arguments: &str, answers: &str) -> (String, bool) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    let path = Path::new(std::ffi::OsStr::from_bytes(name.as_bytes()));
    let terminal = OpenOptions::new()
        .read(true)
        .write(true)
        .open(path)
        .unwrap();
    let mut keyboard = File::from(master);
    // Ctrl-D at the beginning of a line ends the input.
    write!(keyboard, "{answers}\n\u{4}").unwrap();
    let output = testkit::command(env!("CARGO_BIN_EXE_vpc-memory"))
        .args(arguments.split_whitespace())
        .current_dir(directory)
        .stdin(terminal)
        .output()
        .unwrap();
    let words = String::from_utf8(output.stderr).unwrap();
    (words, output.status.success())
}

#[test]
fn on_a_terminal_new_asks_for_all_that_no_flag_tells() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let answers = "640x480\n600\n\n\n0.12\n\n0.4\n0.3,0.8\n\n\n";
    let (words, good) = typed(here, "new asked.toml", answers);
    assert!(good, "{words}");
    assert_eq!(words.matches(": ").count(), 11, "{words}");
    assert!(
        words.contains("Principal point, px (CX,CY) [320,240]: "),
        "{words}"
    );
    // The same as by flags.
    said(here, NEW);
    let read = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert_eq!(read("asked.toml"), read("own.toml"));
    // What a flag tells is not asked.
    let flags =
        "new less.toml --image 640x480 --focal 600 --pattern 0.12 --goal 0.4 --box 100,100,60,20";
    let (words, good) = typed(here, flags, "\n\n\n\n\n");
    assert!(
        good && !words.contains("Image") && !words.contains("Mask"),
        "{words}"
    );
}

#[test]
fn a_wrong_answer_is_told_and_asked_again() {
    let directory = TempDir::new().unwrap();
    let here = directory.path();
    let answers =
        "640\n640x480\nabc\n600\n\n\n0.1x0.1x0.1\n0.12\n3cm\n\n0.4\n0.3\n0.3,0.8\n\n\nnone.png\n";
    let (words, good) = typed(here, "new asked.toml", answers);
    assert!(good, "{words}");
    for told in [
        "--image = 640; allowed: 2 numbers",
        "--focal = abc; allowed: numbers",
        "--pattern = 0.1x0.1x0.1; allowed: SIDE",
        "--marker-size = 3cm; allowed: numbers",
        "--limits = 0.3; allowed: 2 numbers",
        "--mask = none.png; allowed: a file that is there",
    ] {
        assert!(words.contains(told), "{words}\nlacks {told}");
    }
    said(here, NEW);
    let read = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert_eq!(read("asked.toml"), read("own.toml"));
    // The input ends before all is answered: nothing is written.
    let (words, good) = typed(here, "new half.toml", "640x480\n600\n");
    assert!(!good && words.contains("no answer to: "), "{words}");
    assert!(!here.join("half.toml").exists());
}
