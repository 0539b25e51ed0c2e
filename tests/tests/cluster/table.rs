//! Parts of a table are the whole.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use serde_json::Value;
use tempfile::TempDir;
use testkit::{Ended, ended, program, root};

fn run(directory: &Path, line: &str) -> Ended {
    let mut command = testkit::command(program("table"));
    ended(command.args(line.split_whitespace()).current_dir(directory))
}

fn done(directory: &Path, line: &str) -> String {
    let ended = run(directory, line);
    assert_eq!(ended.code, Some(0), "{line}: {}", ended.stderr);
    ended.stdout
}

fn refused(directory: &Path, line: &str) -> String {
    let ended = run(directory, line);
    assert_eq!(ended.code, Some(1), "{line}: {}", ended.stderr);
    ended.stderr
}

/// A directory with 7 starts and the flags that take them, with noise, so that a start that ran with
/// another seed would show.
fn place() -> (TempDir, String) {
    let place = TempDir::new().unwrap();
    let starts = scene_file("paper-sim-starts.csv");
    let few: Vec<_> = starts.lines().take(8).collect();
    fs::write(place.path().join("starts.csv"), few.join("\n")).unwrap();
    fs::write(
        place.path().join("scene.toml"),
        scene_file("paper-sim.toml"),
    )
    .unwrap();
    let memory = root().join("memory-blob/default/paper-sim.vpcmem");
    let flags = format!(
        "--scene scene.toml --starts starts.csv --memory {} --strategies knn:3,previous:3 --noise 0.3 --drop 0.05 --repeats 1",
        memory.display()
    );
    (place, flags)
}

fn scene_file(name: &str) -> String {
    fs::read_to_string(root().join("ipc/scene/scenes").join(name)).unwrap()
}

/// A document less what differs from one run to the next: times, and the command line, of which the
/// flags are checked.
fn without_times(path: &Path, flags: &str) -> Value {
    let mut document: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    let command = document["command"].take();
    assert!(
        command.as_str().unwrap().trim_end().ends_with(flags),
        "{command}"
    );
    let lists = ["rows", "runs"].map(|list| document[list].take());
    let lists = lists.map(|mut list| {
        for entry in list.as_array_mut().unwrap() {
            for time in ["cycles_us", "cycle_us", "slack_us", "simulated_us"] {
                entry.as_object_mut().unwrap().remove(time);
            }
        }
        list
    });
    document["lists"] = lists.to_vec().into();
    document
}

/// A printed table less its times, and what follows it. Cells are not padded: times are of any width.
fn figures(text: &str) -> Vec<String> {
    let cells = |line: &str| -> Vec<String> {
        line.split('|').map(|cell| cell.trim().to_owned()).collect()
    };
    let lines = text.lines().filter(|line| !line.starts_with("wrote"));
    let lines: Vec<Vec<String>> = lines.map(cells).collect();
    let titles = lines.iter().find(|line| line.len() > 1).unwrap().clone();
    let is_kept = |column: usize| {
        let title = titles.get(column);
        title.is_none_or(|title| !title.ends_with("(us)"))
    };
    let kept = lines.iter().filter(|line| !line.concat().starts_with('-'));
    let kept = kept.map(|line| {
        let kept = line.iter().enumerate().filter(|(k, _)| is_kept(*k));
        kept.map(|(_, cell)| cell.as_str())
            .collect::<Vec<_>>()
            .join("|")
    });
    kept.collect()
}

#[test]
fn merged_parts_print_and_write_what_one_run_does() {
    let (place, flags) = place();
    let here = place.path();
    let whole = done(here, &format!("{flags} --wide --json whole.json"));
    assert!(whole.contains("| 95 % interval |"), "{whole}");
    for part in 0..3 {
        let said = done(
            here,
            &format!("{flags} --part {part}/3 --json part-{part}.json"),
        );
        assert!(said.contains(&format!("; part {part}/3")), "{said}");
    }
    let merge = "--merge part-2.json part-0.json part-1.json --wide --json merged.json";
    let merged = done(here, merge);
    assert_eq!(figures(&whole), figures(&merged));
    let both = [
        without_times(
            &here.join("whole.json"),
            &format!("{flags} --wide --json whole.json"),
        ),
        without_times(&here.join("merged.json"), merge),
    ];
    assert_eq!(both[0], both[1]);
    assert_eq!(both[0]["lists"][1].as_array().unwrap().len(), 14);

    // Their times, too, are those that were measured: a table that is merged from itself is itself.
    let lines = |text: &str| -> Vec<String> {
        let lines = text.lines().filter(|line| !line.starts_with("wrote"));
        lines.map(str::to_owned).collect()
    };
    assert_eq!(
        lines(&whole),
        lines(&done(here, "--merge whole.json --wide"))
    );
    let narrow = done(here, "--merge whole.json");
    let longest = narrow.lines().filter(|line| !line.starts_with("wrote"));
    assert!(longest.map(str::len).max() <= Some(100), "{narrow}");
    let times = serde_json::from_slice::<Value>(&fs::read(here.join("merged.json")).unwrap());
    let times = times.unwrap()["rows"][0]["cycle_us"]["p99"].as_f64();
    assert!(times.is_some_and(|us| us > 0.0));
}

#[test]
fn a_part_that_is_there_stays() {
    let (place, flags) = place();
    let here = place.path();
    let line = format!("{flags} --part 0/2 --json a");
    done(here, &line);
    let bytes = |name: &str| fs::read(here.join(name)).unwrap();
    let before = bytes("a");
    let said = done(here, &line);
    assert!(
        said.contains("a: part 0/2 is there; nothing to run"),
        "{said}"
    );
    let expect = |line: &str, words: &str| {
        let message = refused(here, line);
        assert!(
            message.contains(words),
            "{line}: {message}; expected: {words}"
        );
        assert_eq!(before, bytes("a"), "{line}");
    };
    expect(
        &line.replace("0/2", "1/2"),
        "a: part is 0/2; expected: 1/2, or no file",
    );
    expect(
        &line.replace("--noise 0.3", "--noise 0.4"),
        "a: --noise is 0.3; expected: 0.4, or no file",
    );

    // Nor does the table that is merged from it replace it.
    done(here, &line.replace("0/2 --json a", "1/2 --json b"));
    std::os::unix::fs::symlink("a", here.join("link")).unwrap();
    for (part, json) in [("a", "a"), ("a", "./a"), ("link", "a")] {
        expect(
            &format!("--merge {part} b --json {json}"),
            &format!("--json {json}: allowed: a file that is no part"),
        );
    }

    // Nor do workers that began before it was there.
    let workers = ["0/2 --json c", "1/2 --json c"].map(|part| {
        let mut command = testkit::command(program("table"));
        let line = line.replace("0/2 --json a", part);
        let command = command.args(line.split_whitespace()).current_dir(here);
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command.spawn().unwrap()
    });
    let ended = workers.map(|worker| worker.wait_with_output().unwrap());
    let [first, second] = ended.each_ref().map(|one| one.status.success());
    assert_ne!(first, second, "{ended:?}");
    let error = String::from_utf8_lossy(&ended[usize::from(first)].stderr);
    assert!(error.contains("c: part is "), "{error}");
}

#[test]
fn parts_that_do_not_belong_are_refused_by_name() {
    let (place, flags) = place();
    let here = place.path();
    let part = |flags: &str, part: &str, name: &str| {
        done(here, &format!("{flags} --part {part} --json {name}"));
    };
    part(&flags, "0/2", "a");
    part(&flags, "1/2", "b");
    let expect = |files: &str, words: &str| {
        let message = refused(here, &format!("--merge {files}"));
        assert!(
            message.contains(words),
            "{files}: {message}; expected: {words}"
        );
    };
    expect("a", "1 of 2 parts; expected: all; missing: 1");
    expect(
        "b a b",
        "b: part 1/2 is there twice, also as b; expected: each part once",
    );
    part(&flags.replace("--noise 0.3", "--noise 0.4"), "1/2", "noisy");
    expect("a noisy", "noisy: --noise is 0.4; expected: 0.3");
    part(&flags, "1/3", "third");
    expect("a third", "third: number of parts is 3; expected: 2");
    part(&flags.replace("knn:3,", ""), "1/2", "fewer");
    expect(
        "a fewer",
        "fewer: --strategies is previous:3; expected: knn:3,previous:3",
    );

    let edit = |name: &str, from: &str, to: &str| {
        let text = fs::read_to_string(here.join("b")).unwrap();
        assert!(text.contains(from));
        fs::write(here.join(name), text.replacen(from, to, 1)).unwrap();
    };
    edit("newer", "\"version\":\"table ", "\"version\":\"table 9");
    expect("a newer", "newer: version is table 9");
    edit("run", "\"start\":4,", "\"start\":5,");
    expect("a run", "run: a run is knn:3 5; expected: knn:3 4");
    let text = fs::read(here.join("b")).unwrap();
    fs::write(here.join("cut"), &text[..text.len() / 2]).unwrap();
    expect("a cut", "cut: damaged");

    let scene = scene_file("paper-sim.toml").replace("time_s = 15.0", "time_s = 14.0");
    fs::write(here.join("scene.toml"), scene).unwrap();
    part(&flags, "1/2", "scene");
    expect("a scene", "scene: checksum of the scene is");
    fs::write(here.join("scene.toml"), scene_file("paper-sim.toml")).unwrap();
    let starts = scene_file("paper-sim-starts.csv");
    let few: Vec<_> = starts.lines().take(7).collect();
    fs::write(here.join("starts.csv"), few.join("\n")).unwrap();
    part(&flags, "1/2", "starts");
    expect("a starts", "starts: starts is 6 with checksum");
}
