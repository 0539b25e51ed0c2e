//! Every command of the documents runs, in a copy of the repository, or is looked up for a stated reason; every link
//! leads somewhere.

use std::collections::BTreeSet;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::call::{Call, after, is_a_test, package, program};
use crate::markdown::{Act, documents};
use crate::root;
use crate::verdicts::{Change, MEANWHILE, VERDICTS, Verdict};

/// Longest time that a command may take.
const PATIENCE: Duration = Duration::from_secs(120);
/// Exit code of `vpcctl` where no daemon is at work.
const NO_DAEMON: i32 = 3;

fn verdict(document: &str, command: &str) -> Option<Verdict> {
    let mut rows = VERDICTS.iter();
    let found = rows.find(|(name, text, _)| *name == document && *text == command);
    found.map(|(_, _, verdict)| *verdict)
}

#[test]
fn every_command_has_a_verdict_and_names_what_exists() {
    let mut faults = Vec::new();
    let mut seen = BTreeSet::new();
    for document in documents() {
        for command in document.commands() {
            let place = format!("{}:{}: {}", document.name, command.line, command.text);
            seen.insert((document.name.clone(), command.text.clone()));
            if verdict(&document.name, &command.text).is_none() {
                faults.push(format!(
                    "{place}: no verdict in tests/tests/documents/verdicts.rs"
                ));
            }
            for part in command.text.split(" && ") {
                if let Err(fault) = Call::read(part).check() {
                    faults.push(format!("{place}: {fault}"));
                }
            }
        }
    }
    for (document, command, verdict) in VERDICTS {
        if matches!(verdict, Verdict::Checked("")) {
            faults.push(format!("{document}: {command}: no reason is given"));
        }
        if !seen.contains(&(document.to_string(), command.to_string())) {
            faults.push(format!(
                "{document}: {command}: a verdict without a command"
            ));
        }
    }
    assert!(seen.len() > 60, "{}", seen.len());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn commands_in_the_text_name_what_exists() {
    let mut faults = Vec::new();
    let mut count = 0;
    for document in documents() {
        for code in document.inline_code() {
            let own = ["cargo ", "vpcd ", "vpcctl ", "vpc-memory ", "hw-sim "];
            let is_command = own.iter().any(|start| code.text.starts_with(start));
            // With an ellipsis it is a sketch.
            if !is_command || code.text.contains("...") {
                continue;
            }
            count += 1;
            if let Err(fault) = Call::read(&code.text).check() {
                faults.push(format!(
                    "{}:{}: {}: {fault}",
                    document.name, code.line, code.text
                ));
            }
        }
    }
    assert!(count > 30, "{count}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_promise_of_the_readme_names_its_test() {
    let text = std::fs::read_to_string(root().join("README.md")).unwrap();
    let (_, table) = text.split_once("| promise | NAME | seen |").unwrap();
    let (table, _) = table.split_once("\n\n").unwrap();
    let promises = package("system-tests").unwrap();
    let mut count = 0;
    for row in table.lines().filter(|row| row.starts_with("| ")) {
        let column = row.split(" | ").nth(1).unwrap();
        for name in column.split('`').skip(1).step_by(2) {
            if name.starts_with("cargo") {
                continue;
            }
            is_a_test(&promises, name).unwrap();
            count += 1;
        }
    }
    assert!(count > 15, "{count}");
}

#[test]
fn every_link_leads_to_a_file_and_to_a_heading_of_it() {
    let documents = documents();
    let mut faults = Vec::new();
    let mut count = 0;
    for document in &documents {
        let directory = Path::new(&document.name).parent().unwrap();
        for link in document.links() {
            if link.text.contains("://") || link.text.starts_with("mailto:") {
                continue;
            }
            count += 1;
            let (path, anchor) = link.text.split_once('#').unwrap_or((&link.text, ""));
            let target = match path {
                "" => PathBuf::from(&document.name),
                path => directory.join(path),
            };
            let place = format!("{}:{}: {}", document.name, link.line, link.text);
            let Ok(found) = root().join(&target).canonicalize() else {
                faults.push(format!("{place}: no such file"));
                continue;
            };
            let other = documents.iter().find(|other| {
                root().join(&other.name).canonicalize().ok().as_ref() == Some(&found)
            });
            if let (false, Some(other)) = (anchor.is_empty(), other)
                && !other.anchors().iter().any(|a| a == anchor)
            {
                faults.push(format!("{place}: no such heading"));
            }
        }
    }
    assert!(count > 30, "{count}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// A copy of the repository to write into: links, but for the directories that commands write to.
struct Tree(tempfile::TempDir);

impl Tree {
    fn new() -> Self {
        let copy = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(root()).unwrap().map(Result::unwrap) {
            let name = entry.file_name();
            let made = ["out", "own", "target", ".git"]
                .iter()
                .any(|made| name == *made);
            if !made {
                symlink(
                    entry.path().canonicalize().unwrap(),
                    copy.path().join(&name),
                )
                .unwrap();
            }
        }
        Self(copy)
    }

    fn domain(&self) -> PathBuf {
        self.0.path().join("domain")
    }

    fn command(&self, call: &Call) -> Command {
        let path = match call.is_ours() {
            true => program(&call.program),
            false => PathBuf::from(&call.program),
        };
        let mut command = Command::new(path);
        if ["vpcd", "hw-sim", "vpcctl"].contains(&&*call.program) {
            command.arg("--domain").arg(self.domain());
        }
        command.args(&call.arguments).current_dir(self.0.path());
        command.stdin(Stdio::null());
        command
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        if self.domain().exists() {
            // Who is alone clears away what the stopped processes left.
            let _ = ipc::Domain::join(&self.domain());
        }
    }
}

/// A process that is stopped with the document.
struct Running(Child, String);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn changed(mut call: Call, changes: &[Change]) -> Call {
    for change in changes {
        match change {
            Change::Add(words) => call.arguments.extend(words.split(' ').map(str::to_owned)),
            Change::Put(old, new) => {
                let place = call.arguments.iter().position(|word| word == old);
                let place = place.unwrap_or_else(|| panic!("{call:?} has no {old}"));
                call.arguments[place] = (*new).to_owned();
            }
        }
    }
    call
}

/// Runs a command to its end: exit code, and all that it said.
fn ended(copy: &Tree, call: &Call) -> (Option<i32>, String) {
    let said = tempfile::tempfile().unwrap();
    let mut command = copy.command(call);
    command.stdout(said.try_clone().unwrap());
    command.stderr(said.try_clone().unwrap());
    let child = command.spawn().unwrap_or_else(|e| panic!("{call:?}: {e}"));
    let mut running = Running(child, String::new());
    let born = Instant::now();
    let status = loop {
        match running.0.try_wait().unwrap() {
            Some(status) => break status.code(),
            None if born.elapsed() > PATIENCE => break None,
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    use std::io::{Read, Seek};
    let mut said = said;
    let mut text = String::new();
    said.rewind().unwrap();
    let _ = said.read_to_string(&mut text);
    (status, text)
}

/// Runs a document's commands in their order in a fresh copy; how many there were.
fn run(name: &str) -> usize {
    let documents = documents();
    let document = documents.iter().find(|d| d.name == name).unwrap();
    let copy = Tree::new();
    let mut running = Vec::new();
    let mut start = |place: &str, call: &Call| {
        let mut command = copy.command(call);
        command.stdout(Stdio::null()).stderr(Stdio::inherit());
        running.push(Running(command.spawn().unwrap(), place.to_owned()));
    };
    let meanwhile = MEANWHILE.iter().filter(|(document, _)| *document == name);
    let at_work: Vec<_> = meanwhile.flat_map(|(_, commands)| *commands).collect();
    for command in &at_work {
        start(command, &Call::read(command));
    }
    if !at_work.is_empty() {
        // Until both have met, there is nobody to ask.
        arm(&copy, "before the first command");
    }
    let mut count = 0;
    for act in document.acts() {
        let command = match act {
            Act::Command(command) => command,
            Act::File(path, text) => {
                std::fs::write(copy.0.path().join(path), text).unwrap();
                continue;
            }
        };
        let place = format!("{name}:{}: {}", command.line, command.text);
        match verdict(name, &command.text) {
            Some(Verdict::Runs(codes, changes)) => {
                count += 1;
                let call = changed(Call::read(&command.text), changes);
                if call.arguments == ["arm"] {
                    arm(&copy, &place);
                    continue;
                }
                let said = ended_with(&copy, &call, codes, &place);
                if let Some(file) = after(&call.arguments, "-o") {
                    let file = copy.0.path().join(file);
                    assert!(file.exists(), "{place}: no {}\n{said}", file.display());
                }
            }
            Some(Verdict::Stays(changes)) => {
                count += 1;
                start(&place, &changed(Call::read(&command.text), changes));
            }
            Some(Verdict::Checked(_)) | None => (),
        }
    }
    for Running(child, place) in &mut running {
        let is_judging =
            place.contains("hw-sim --") && !at_work.iter().any(|command| *command == place);
        let born = Instant::now();
        while is_judging && child.try_wait().unwrap().is_none() && born.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(10));
        }
        let code = child.try_wait().unwrap().map(|status| status.code());
        let good = match code {
            // Arrived or not: a memory of a few trajectories need not lead every start to the goal.
            Some(code) => code == Some(0) || is_judging && code == Some(1),
            None => !is_judging,
        };
        assert!(good, "{place}: {code:?}");
    }
    count
}

/// `vpcctl arm`, again until daemon and camera are there.
fn arm(copy: &Tree, place: &str) {
    let call = Call::read("vpcctl arm");
    eventually(copy, &call, place, |code| code == 0);
}

/// Runs a command that ends with one of these codes, and gives what it said. Where there is no `vpcd` yet it is run
/// again: one was started just before, and on a busy machine takes its time.
fn ended_with(copy: &Tree, call: &Call, codes: &[i32], place: &str) -> String {
    let (code, said) = eventually(copy, call, place, |code| {
        code != NO_DAEMON || codes.contains(&code)
    });
    assert!(codes.contains(&code), "{place}: exit code {code}\n{said}");
    said
}

/// Runs a command, again until its exit code is one of these, for half a minute: exit code, and what it said.
fn eventually(
    copy: &Tree,
    call: &Call,
    place: &str,
    is_one: impl Fn(i32) -> bool,
) -> (i32, String) {
    let born = Instant::now();
    loop {
        let (code, said) = ended(copy, call);
        if let Some(code) = code.filter(|code| is_one(*code)) {
            return (code, said);
        }
        let patient = code.is_some() && born.elapsed() < Duration::from_secs(30);
        assert!(patient, "{place}: exit code {code:?}\n{said}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn every_document_with_commands_to_run_is_run_by_a_test_below() {
    let runs = VERDICTS
        .iter()
        .filter(|(_, _, verdict)| !matches!(verdict, Verdict::Checked(_)));
    let named: BTreeSet<&str> = runs.map(|(document, _, _)| *document).collect();
    assert_eq!(named, BTreeSet::from(RUN));
}

const RUN: [&str; 7] = [
    "README.md",
    "hw-sim/README.md",
    "ipc/recording/README.md",
    "ipc/vpcctl/README.md",
    "memory-blob/GUIDE.md",
    "memory-blob/README.md",
    "memory-blob/builder/README.md",
];

#[test]
fn the_commands_of_the_readme_run() {
    assert!(run(RUN[0]) >= 9);
}

#[test]
fn the_commands_of_the_emulators_readme_run() {
    assert!(run(RUN[1]) >= 3);
}

#[test]
fn the_commands_about_recordings_run() {
    assert!(run(RUN[2]) >= 4);
}

#[test]
fn the_commands_of_the_operators_readme_run() {
    assert!(run(RUN[3]) >= 8);
}

#[test]
fn the_guide_to_a_task_of_ones_own_runs() {
    assert!(run(RUN[4]) >= 10);
}

#[test]
fn the_commands_about_memories_run() {
    assert!(run(RUN[5]) + run(RUN[6]) >= 2);
}
