//! The documents are true: links lead somewhere, what commands name exists, the commands of the
//! READMEs run, the configuration reference matches the code, and the book has every page.

mod book;
mod call;
mod markdown;
mod reference;
mod session;

use std::path::{Path, PathBuf};

use call::{BUILT, Call, LEFT_OUT, is_a_test};
use markdown::documents;
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

/// Checks the commands of all documents that pass `is_checked`, with the flags of these programs;
/// at least `least` are there.
fn check_commands(programs: &[&str], is_checked: impl Fn(&Call) -> bool, least: usize) {
    let mut faults = Vec::new();
    let mut count = 0;
    let own = [&BUILT[..], &LEFT_OUT, &["cargo"]].concat();
    for document in documents() {
        let mut pieces = document.commands();
        let code = document.inline_code().into_iter();
        // With an ellipsis it is a sketch.
        pieces.extend(code.filter(|code| {
            let first = code.text.split_once(' ').map(|(first, _)| first);
            first.is_some_and(|first| own.contains(&first)) && !code.text.contains("...")
        }));
        for piece in pieces {
            let calls = piece.text.split(" && ").map(Call::read);
            for call in calls.filter(&is_checked) {
                count += 1;
                if let Err(fault) = call.check(programs) {
                    faults.push(format!("{}: {}: {fault}", piece.place, piece.text));
                }
            }
        }
    }
    assert!(count > least, "{count}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn commands_name_what_exists() {
    check_commands(&BUILT, |_| true, 60);
}

/// `.ci/run` builds these programs.
#[test]
#[ignore = "needs vpc-camera, vpc-calib and vpc-ros2"]
fn commands_of_camera_calibration_and_gateway_name_what_exists() {
    check_commands(&LEFT_OUT, |call| call.is_one_of(&LEFT_OUT), 10);
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
            is_a_test("system-tests", name).unwrap();
            count += 1;
        }
    }
    assert!(count > 15, "{count}");
}
