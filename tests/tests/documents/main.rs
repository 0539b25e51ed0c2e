//! The documents are true: links lead somewhere, what commands name exists, commands that need no
//! real time run, and the configuration reference matches the code. What needs other programs or
//! real time is in `tests/judges/documents.rs`.

mod call;
mod commands;
mod markdown;
mod reference;
mod results;
mod session;

use std::path::{Path, PathBuf};

use call::{BUILT, is_a_test, is_measured};
use commands::check_commands;
use markdown::documents;
use session::{SCENE, SMALL, Session};
use testkit::root;

#[test]
fn every_link_leads_to_a_file_and_to_a_heading_of_it() {
    let documents = documents();
    let mut faults = Vec::new();
    let mut count = 0;
    for document in &documents {
        let directory = Path::new(&document.name).parent().unwrap();
        let links = document.links().into_iter();
        for link in links.filter(|link| !link.text.contains(':')) {
            count += 1;
            let (path, anchor) = link.text.split_once('#').unwrap_or((&link.text, ""));
            let target = match path {
                "" => PathBuf::from(&document.name),
                path => directory.join(path),
            };
            let Ok(found) = root().join(&target).canonicalize() else {
                faults.push(format!("{}: {}: no such file", link.place, link.text));
                continue;
            };
            let is_it = |name: &str| root().join(name).canonicalize().ok().as_ref() == Some(&found);
            let other = documents.iter().find(|other| is_it(&other.name));
            if let (false, Some(other)) = (anchor.is_empty(), other)
                && !other.anchors().iter().any(|a| a == anchor)
            {
                faults.push(format!("{}: {}: no such heading", link.place, link.text));
            }
        }
    }
    assert!(count > 30, "{count}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn commands_name_what_exists() {
    check_commands(&BUILT, |_| true, 60);
}

#[test]
fn files_in_the_text_exist() {
    let mut faults = Vec::new();
    let mut count = 0;
    // The changelog names users' files, and files that were.
    for document in documents()
        .into_iter()
        .filter(|document| document.name != "CHANGELOG.md")
    {
        let directory = Path::new(&document.name).parent().unwrap().to_owned();
        for code in document.inline_code() {
            let path = code.text.split(['#', ':']).next().unwrap();
            let is_file = path.contains('/') && !path.contains([' ', '*', '{', '<', '$', '=', ',']);
            let ends = [".rs", ".md", ".toml", ".py", ".c", ".h", ".sh", ".csv"];
            let is_pattern = path.starts_with('/') || path.contains("NAME");
            if !is_file || is_pattern || !ends.iter().any(|end| path.ends_with(end)) {
                continue;
            }
            count += 1;
            // Seen from a directory above the document, or from the sources or tests there.
            let mut above = directory.ancestors().flat_map(|directory| {
                ["", "src", "tests"].map(|place| root().join(directory).join(place).join(path))
            });
            if !above.any(|path| path.exists()) && !path.starts_with("own/") {
                faults.push(format!("{}: {path} does not exist", code.place));
            }
        }
    }
    assert!(count > 30, "{count}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_promise_names_its_test() {
    let text = std::fs::read_to_string(root().join("tests/PROMISES.md")).unwrap();
    let (_, table) = text.split_once("| promise | NAME | seen |").unwrap();
    let (table, _) = table.split_once("\n\n").unwrap();
    let mut count = 0;
    for row in table.lines().filter(|row| row.starts_with("| ")) {
        let column = row.split(" | ").nth(1).unwrap();
        let names = column.split('`').skip(1).step_by(2);
        for name in names.filter(|name| !name.starts_with("cargo")) {
            match name.strip_prefix("measure ") {
                Some(name) => is_measured(name).unwrap(),
                None => is_a_test("system-tests", name).unwrap(),
            }
            count += 1;
        }
    }
    assert!(count > 15, "{count}");
}

#[test]
fn every_bound_holds_at_run_time() {
    reference::cases();
}

#[test]
fn the_files_that_ship_show_every_key_with_its_default() {
    reference::check_shipped_files();
}

#[test]
fn the_commands_of_the_readme_run() {
    let readme = Session::of("README.md");
    let small = "--memory memory-blob/default/paper-sim.vpcmem --strategies gpr:3 --repeats 1";
    readme.run("table --scene", &[("", small)]);
    let file = ("FILE", "small.vpcmem");
    readme.run("vpc-memory build SCENE.toml", &[SCENE, file, ("", SMALL)]);
    readme.run("vpc-memory inspect FILE", &[file]);
    readme.run("vpc-memory verify FILE", &[SCENE, file]);
}

#[test]
fn the_commands_of_the_emulators_readme_run() {
    let readme = Session::of("hw-sim/README.md");
    // One start of one strategy instead of 200 runs.
    let few = [("previous:3,gpr:3,foresight:3", "gpr:3"), ("", "--only 0")];
    readme.run("table --robot panda", &few);
}

#[test]
fn the_guide_to_a_task_of_ones_own_runs() {
    let guide = Session::of("memory-blob/GUIDE.md");
    guide.makes_a_task();
    guide.run("vpc-memory starts own/painted.toml", &[("50", "5")]);
    guide.run("table --scene own/painted.toml", &[("", "--repeats 1")]);
    for (path, text) in guide.document.files() {
        std::fs::write(guide.place.path(path), text).unwrap();
    }
    guide.run("vpcd --config own/vpcd.toml", &[("", "--print-config")]);
}
