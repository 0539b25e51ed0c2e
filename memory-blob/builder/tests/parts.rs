//! Parts of a build, made and merged by the program: which belong together, and that neither their
//! order nor a kill makes a difference.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use memory_builder::build::{self, Progress};
use memory_builder::merge::Parts;
use memory_builder::settings::BuildSettings;
use memory_builder::state::BuildState;
use scene::SceneFiles;
use tempfile::TempDir;
use toml_schema::Document;

const PARTS: usize = 3;

fn vpc_memory(directory: &Path, line: &str) -> Command {
    let mut command = testkit::command(env!("CARGO_BIN_EXE_vpc-memory"));
    command.args(line.split_whitespace()).current_dir(directory);
    command
}

fn run(directory: &Path, line: &str) -> Output {
    vpc_memory(directory, line).output().unwrap()
}

/// Runs a command that has to work.
fn done(directory: &Path, line: &str) -> String {
    let output = run(directory, line);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{line}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that has to be refused, and returns why.
fn refused(directory: &Path, line: &str) -> String {
    let output = run(directory, line);
    assert!(!output.status.success(), "{line}: accepted");
    String::from_utf8(output.stderr).unwrap()
}

/// The flags of a small build, whose parts take several batches.
const FLAGS: &str = "--settings settings.toml --threads 1";
const SETTINGS: &str =
    "trajectories = 16\niterations = 30\nbatch = 2\nplanner = false\nregression.samples = 100\n";

fn part(index: usize) -> String {
    format!("build scene.toml --part {index}/{PARTS} -o part-{index} {FLAGS}")
}

/// A directory with a scene and settings.
fn place() -> TempDir {
    let directory = TempDir::new().unwrap();
    fs::write(directory.path().join("scene.toml"), scene::PAPER_SIM).unwrap();
    fs::write(directory.path().join("settings.toml"), SETTINGS).unwrap();
    directory
}

/// Leaves part 1 as a worker does that is killed after its first batch.
fn interrupt(directory: &Path) {
    let settings = Document::read(Some(&directory.join("settings.toml")));
    let settings: BuildSettings = settings.unwrap().check().unwrap();
    let scene = SceneFiles::parse(
        scene::PAPER_SIM.to_owned(),
        "scene.toml",
        &|_| unreachable!(),
    );
    let (path, part) = (directory.join("part-1"), "1/3".parse().unwrap());
    let mut state = BuildState::resume(&path, scene.unwrap(), &settings, part).unwrap();
    let stop = AtomicBool::new(false);
    let scene = state.scene.scene.clone();
    let mut once = |_: &Progress| stop.store(true, Ordering::Relaxed);
    let begun = Progress::default();
    let progress = build::collect(&scene, &settings, part, begun, &stop, &mut once).unwrap();
    state.save(&path, &progress).unwrap();
    assert_eq!(progress.trajectories.len(), 2);
}

/// A directory with a scene, settings and all parts.
fn made() -> TempDir {
    let directory = place();
    for index in 0..PARTS {
        done(directory.path(), &part(index));
    }
    directory
}

/// A way to forge a trajectory.
type Forgery = fn(&mut memory_builder::store::Trajectory);

#[test]
fn a_forged_part_is_refused_though_its_digest_is_right() {
    let place = place();
    let here = place.path();
    done(
        here,
        &format!("build scene.toml --part 0/1 -o whole {FLAGS}"),
    );
    let whole = BuildState::read(&here.join("whole")).unwrap();
    let forgeries: [(Forgery, &str); 10] = [
        (|t| t.features.truncate(2), "one command fewer"),
        (|t| t.features.clear(), "one command fewer"),
        (|t| t.twists.clear(), "one command fewer"),
        (
            |t| t.features.iter_mut().for_each(|s| s.truncate(3)),
            "3 points; expected: 4",
        ),
        (
            |t| t.features.iter_mut().for_each(|s| s.resize(9, [5.0; 2])),
            "9 points; expected: 4",
        ),
        (
            |t| t.features.iter_mut().for_each(Vec::clear),
            "0 points; expected: 4",
        ),
        (|t| t.features[1][2] = [f64::NAN; 2], "inside the image"),
        (|t| t.features[1][2] = [1e300; 2], "inside the image"),
        (|t| t.twists[0] = [f64::NAN; 6], "the limits of the scene"),
        (|t| t.twists[0] = [50.0; 6], "the limits of the scene"),
    ];
    for (forge, words) in forgeries {
        let (mut state, mut progress) = (whole.clone(), whole.progress.clone());
        forge(&mut progress.trajectories[1]);
        let _ = fs::remove_file(here.join("forged"));
        state.save(&here.join("forged"), &progress).unwrap();
        let said = refused(here, "merge forged -o forged.vpcmem");
        assert!(
            said.contains("trajectory 1: ") && said.contains(words),
            "{said}"
        );
    }
    done(here, "merge whole -o whole.vpcmem");
}

fn bytes(path: PathBuf) -> Vec<u8> {
    fs::read(path).unwrap()
}

#[test]
fn parts_make_one_memory_whatever_their_order_and_wherever_a_kill_took_one() {
    let place = made();
    let here = place.path();
    let said = done(here, "merge part-0 part-1 part-2 -o one.vpcmem");
    assert!(said.contains("16 trajectories of"), "{said}");
    assert!(said.contains("provenance       parts = 3"), "{said}");
    done(here, "verify one.vpcmem --scene scene.toml");
    done(here, "merge part-2 part-0 part-1 -o other.vpcmem");
    let one = bytes(here.join("one.vpcmem"));
    assert_eq!(one, bytes(here.join("other.vpcmem")));

    // Again, where one was interrupted, and then killed.
    let before = bytes(here.join("part-1"));
    fs::remove_file(here.join("part-1")).unwrap();
    interrupt(here);
    assert_ne!(before, bytes(here.join("part-1")));
    let line = part(1) + " --checkpoint-s 0";
    let mut worker = vpc_memory(here, &line)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(100));
    worker.kill().unwrap();
    worker.wait().unwrap();
    done(here, &line);
    assert_eq!(before, bytes(here.join("part-1")));
    // A complete part is not made again: its file stays.
    let written = |path: PathBuf| fs::metadata(path).unwrap().modified().unwrap();
    let then = written(here.join("part-1"));
    done(here, &line);
    assert_eq!(then, written(here.join("part-1")));

    // Nothing is in two parts: every trajectory has a start of its own.
    let file = memory_blob::MemoryFile::open(&here.join("one.vpcmem"), None).unwrap();
    let contents = file.contents();
    let begins = contents.x.iter().zip(&contents.step);
    let begins: Vec<_> = begins.filter(|(_, step)| **step == 0).collect();
    assert_eq!(begins.len(), 16);
    let distinct =
        |(k, (x, _)): (usize, &(&Vec<f64>, &u32))| begins[..k].iter().all(|(other, _)| other != x);
    assert!(begins.iter().enumerate().all(distinct));
}

#[test]
fn two_workers_of_one_part_leave_what_one_leaves() {
    let place = made();
    let here = place.path();
    let one = bytes(here.join("part-2"));
    fs::remove_file(here.join("part-2")).unwrap();
    let line = part(2) + " --checkpoint-s 0";
    let both: Vec<_> = (0..2)
        .map(|_| {
            vpc_memory(here, &line)
                .stdout(Stdio::null())
                .spawn()
                .unwrap()
        })
        .collect();
    for mut worker in both {
        assert!(worker.wait().unwrap().success());
    }
    assert_eq!(one, bytes(here.join("part-2")));
    let names = fs::read_dir(here).unwrap();
    assert_eq!(names.count(), 2 + PARTS);
}

#[test]
fn of_workers_of_other_parts_on_one_file_the_first_stands_and_the_others_fail() {
    let place = place();
    let here = place.path();
    let lines = [
        ("build scene.toml --part 0/3 -o part", ""),
        ("build scene.toml --part 1/3 -o part", ""),
        ("build scene.toml --part 0/3 -o part", "--seed 2"),
    ]
    .map(|(line, seed)| format!("{line} {FLAGS} {seed}"));
    let start = |line: &String| {
        let mut worker = vpc_memory(here, line);
        let worker = worker.stdout(Stdio::null()).stderr(Stdio::piped());
        worker.spawn().unwrap()
    };
    let workers: Vec<_> = lines.iter().map(start).collect();
    let ended = workers.into_iter().map(|worker| worker.wait_with_output());
    let ended: Vec<_> = ended.map(Result::unwrap).collect();
    let first = ended.iter().position(|one| one.status.success()).unwrap();
    for other in (0..3).filter(|index| *index != first) {
        let error = String::from_utf8_lossy(&ended[other].stderr);
        assert!(!ended[other].status.success(), "{}", lines[other]);
        let words = ["part: part is ", "part: seed is "];
        assert!(words.iter().any(|words| error.contains(words)), "{error}");
    }
    let left = bytes(here.join("part"));
    done(here, &lines[first]);
    assert_eq!(left, bytes(here.join("part")));
    fs::remove_file(here.join("part")).unwrap();
    done(here, &lines[first]);
    assert_eq!(left, bytes(here.join("part")));
}

#[test]
fn a_merge_does_not_replace_a_part() {
    let place = place();
    let here = place.path();
    done(
        here,
        &format!("build scene.toml --part 0/1 -o part {FLAGS}"),
    );
    std::os::unix::fs::symlink("part", here.join("link")).unwrap();
    let before = bytes(here.join("part"));
    for (part, output) in [("part", "part"), ("part", "./part"), ("link", "part")] {
        let error = refused(here, &format!("merge {part} -o {output}"));
        let words = format!("--output {output}: allowed: a file that is no part");
        assert!(error.contains(&words), "{error}");
        assert_eq!(before, bytes(here.join("part")));
    }
}

#[test]
fn one_part_is_the_whole() {
    let place = place();
    let here = place.path();
    done(here, &format!("build scene.toml -o whole.vpcmem {FLAGS}"));
    done(
        here,
        &format!("build scene.toml --part 0/1 -o part {FLAGS}"),
    );
    done(here, "merge part -o merged.vpcmem");
    assert_eq!(
        bytes(here.join("whole.vpcmem")),
        bytes(here.join("merged.vpcmem"))
    );
}

#[test]
fn what_does_not_belong_is_missing_twice_or_damaged_is_refused_by_name() {
    let place = made();
    let here = place.path();
    let merge = |parts: &str| refused(here, &format!("merge {parts} -o m.vpcmem"));
    let expect = |message: &str, words: &[&str]| {
        let all = words.iter().all(|word| message.contains(word));
        assert!(all, "{message}; expected: {words:?}");
    };

    let none = Parts::of(&[]).unwrap_err();
    assert_eq!(none.to_string(), "no parts; expected: at least one");
    expect(&merge("part-0 part-2"), &["2 of 3 parts", "missing: 1"]);
    let twice = merge("part-0 part-1 part-2 part-1");
    expect(&twice, &["part-1: part 1/3 is there twice, also as part-1"]);
    expect(
        &merge("part-0 scene.toml part-2"),
        &["scene.toml: not the state"],
    );

    let other = |flags: &str, name: &str| {
        let line = part(1).replace("-o part-1", &format!("-o {name}"));
        done(here, &format!("{line} {flags}"));
        merge(&format!("part-0 {name} part-2"))
    };
    expect(
        &other("--seed 2", "seeded"),
        &["seeded: seed is 2; expected: 1"],
    );
    expect(&other("--np 9", "np"), &["np: np is 9; expected: 10"]);
    done(here, &part(1).replace("1/3 -o part-1", "1/4 -o fourth"));
    let fourth = merge("part-0 fourth part-2");
    expect(&fourth, &["fourth: number of parts is 4; expected: 3"]);

    // One comment more is another scene, though the task is the same.
    let commented = format!("# mine\n{}", scene::PAPER_SIM);
    fs::write(here.join("scene.toml"), commented).unwrap();
    expect(
        &other("", "foreign"),
        &["foreign: checksum of the scene is"],
    );
    // So it is to a worker that would go on.
    expect(
        &refused(here, &part(1)),
        &["part-1: checksum of the scene is"],
    );
    fs::write(here.join("scene.toml"), scene::PAPER_SIM).unwrap();
    let as_another = part(1).replace("-o part-1", "-o part-0");
    expect(
        &refused(here, &as_another),
        &["part-0: part is 0/3; expected: 1/3"],
    );
    let flag = part(1).replace("--part 1/3", "--part 3/3");
    expect(
        &refused(here, &flag),
        &["`3/3`; allowed: I/N with I from 0"],
    );
    let flag = part(1).replace("--part 1/3", "--part 1/17");
    expect(
        &refused(here, &flag),
        &["allowed: at most one a trajectory, 16"],
    );

    let whole = bytes(here.join("part-1"));
    let text = String::from_utf8_lossy(&whole);
    let digest = text.split_whitespace().nth(2).unwrap().to_owned();
    let damage = |bytes: &[u8]| {
        fs::write(here.join("hurt"), bytes).unwrap();
        merge("part-0 hurt part-2")
    };
    for at in [30, 120, whole.len() / 2, whole.len() - 1] {
        let mut hurt = whole.clone();
        hurt[at] ^= 1;
        expect(&damage(&hurt), &["hurt: "]);
    }
    let cut = damage(&whole[..whole.len() - 1]);
    expect(
        &cut,
        &[
            "hurt: damaged: its SHA-256 is",
            &format!("expected: {digest}"),
        ],
    );
    expect(&damage(b""), &["hurt: not the state of a build"]);
    let other = replaced(&whole, b"vpc-memory 0.1.0", b"vpc-memory 9.1.0");
    expect(
        &damage(&other),
        &["version is \"vpc-memory 9.1.0\"; expected: vpc-memory 0.1.0"],
    );

    fs::remove_file(here.join("part-1")).unwrap();
    interrupt(here);
    let unfinished = merge("part-0 part-1 part-2");
    expect(
        &unfinished,
        &["part-1: part 1/3 has 2 trajectories; expected: 5"],
    );
    assert!(!here.join("m.vpcmem").exists());
}

fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|window| window == from);
    let mut bytes = bytes.to_vec();
    bytes[at.unwrap()..][..to.len()].copy_from_slice(to);
    bytes
}
