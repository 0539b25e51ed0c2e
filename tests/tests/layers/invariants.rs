//! Each invariant of ARCHITECTURE.md names commands, and each command runs a test.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use testkit::{ended, root};

use crate::crates::Crates;

/// The invariants: number and text of each.
fn invariants() -> Vec<(usize, String)> {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let (_, section) = page.split_once("\n## Invariants\n").unwrap();
    let section = section.split("\n## ").next().unwrap();
    let mut found: Vec<(usize, String)> = Vec::new();
    for line in section.lines() {
        let number = line
            .split_once(". ")
            .and_then(|(number, _)| number.parse().ok());
        match (number, found.last_mut()) {
            (Some(number), _) => found.push((number, line.to_owned())),
            (None, Some((_, text))) => *text += &format!(" {}", line.trim()),
            (None, None) => assert_eq!(line, "", "before the first invariant"),
        }
    }
    found
}

/// The words of the commands of cargo in a text.
fn commands(text: &str) -> Vec<Vec<&str>> {
    let code = text.split('`').skip(1).step_by(2);
    let words = code.map(|code| code.split(' ').collect::<Vec<_>>());
    words.filter(|words| words[0] == "cargo").collect()
}

/// Test executables of the root, by the names of their targets; cargo has nothing to do after `cargo
/// test`.
fn executables(targets: &[&str]) -> BTreeMap<String, Vec<PathBuf>> {
    let mut cargo = testkit::command(env!("CARGO"));
    cargo.args(["test", "--no-run", "--message-format=json", "--locked"]);
    cargo.args(targets.iter().flat_map(|target| ["--test", target]));
    let said = ended(cargo.current_dir(root()));
    assert_eq!(said.code, Some(0), "{}", said.stderr);
    let mut found: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for line in said.stdout.lines() {
        let message: Value = serde_json::from_str(line).unwrap();
        if let (Some(name), Some(path)) = (
            message["target"]["name"].as_str(),
            message["executable"].as_str(),
        ) {
            found.entry(name.to_owned()).or_default().push(path.into());
        }
    }
    found
}

/// How many tests an executable has for a filter: all, and those that are ignored.
fn fitting(executable: &PathBuf, filter: Option<&str>) -> [usize; 2] {
    [None, Some("--ignored")].map(|ignored| {
        let mut list = testkit::command(executable);
        let said = ended(list.args(filter).arg("--list").args(ignored));
        assert_eq!(said.code, Some(0), "{executable:?}: {}", said.stderr);
        let tests = said.stdout.lines().filter(|line| line.ends_with(": test"));
        tests.count()
    })
}

/// How many tests in these sources have a name that contains `filter`.
fn of_units(source: &Path, filter: &str) -> usize {
    let files = std::fs::read_dir(source).unwrap().map(Result::unwrap);
    let tests = files.map(|file| {
        let text = std::fs::read_to_string(file.path()).unwrap();
        let names = text.split("    #[test]\n    fn ").skip(1);
        let names = names.filter_map(|rest| rest.split('(').next());
        names.filter(|name| name.contains(filter)).count()
    });
    tests.sum()
}

/// Whether a measurement has a name that begins so.
fn is_measured(name: &str) -> bool {
    let files = std::fs::read_dir(root().join("tests/tests/measure")).unwrap();
    let mut texts = files.map(|file| std::fs::read_to_string(file.unwrap().path()).unwrap());
    texts.any(|text| text.contains(&format!("\"{name}")))
}

#[test]
fn every_invariant_is_tested_by_the_command_that_it_names() {
    let invariants = invariants();
    assert!(invariants.len() > 10, "{invariants:?}");
    let all: Vec<_> = invariants
        .iter()
        .flat_map(|(_, text)| commands(text))
        .collect();
    let of_targets = |words: &&Vec<&str>| words[1..3] == ["test", "--test"];
    let targets = all.iter().filter(of_targets).map(|words| words[3]);
    let executables = executables(&targets.collect::<Vec<_>>());
    let crates = Crates::read();
    let mut faults = Vec::new();
    for (number, text) in &invariants {
        if commands(text).is_empty() {
            faults.push(format!("{number}: no command"));
        }
    }
    for words in &all {
        let command = words.join(" ");
        let filters: Vec<Option<&str>> = match &words[1..] {
            ["test", "--test", _] => vec![None],
            ["test", "--test", _, "--", filters @ ..] => {
                filters.iter().copied().map(Some).collect()
            }
            ["test", "--test", _, filter] => vec![Some(filter)],
            ["clippy", "-p", package] => {
                assert!(crates.get(package).is_some(), "{command}: no {package}");
                continue;
            }
            // What cargo would build for one package alone differs from what is there.
            ["test", "--lib", "-p", package, filter] => {
                let package = crates.get(package).unwrap_or_else(|| panic!("{command}"));
                if of_units(&root().join(package.folder()).join("src"), filter) == 0 {
                    faults.push(format!("`{command}`: {filter} fits no test"));
                }
                continue;
            }
            ["xtask", "measure", names @ ..] => {
                let unknown = names.iter().filter(|name| !is_measured(name));
                faults.extend(unknown.map(|name| format!("`{command}`: no measurement {name}")));
                continue;
            }
            ["xtask", "codegen", "--check"] => continue,
            _ => panic!("{command}: say what it is to name"),
        };
        let executables = &executables[words[3]];
        for filter in filters {
            let [all, ignored] = executables
                .iter()
                .map(|one| fitting(one, filter))
                .fold([0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
            if all == ignored {
                let filter = filter.unwrap_or("all");
                faults.push(format!(
                    "`{command}`: {filter} fits {all} tests, of which {ignored} are ignored"
                ));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
