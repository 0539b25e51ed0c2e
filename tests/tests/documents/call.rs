//! A command of a document as a program with arguments, and what can be said of it without running
//! it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, OnceLock};

use serde_json::Value;
use testkit::{ended, root};

/// The commands of `vpc-lab`, as cargo's aliases.
const LAB: [&str; 4] = ["demo", "table", "laboratory", "benchmark"];
/// The programs of the root, and these commands.
pub const BUILT: [&str; 8] = [
    "vpcd",
    "hw-sim",
    "vpcctl",
    "vpc-memory",
    LAB[0],
    LAB[1],
    LAB[2],
    LAB[3],
];
/// The programs of the clients' workspace.
pub const CLIENTS: [&str; 4] = ["vpc-camera", "vpc-calib", "vpc-panda", "vpc-ros2"];

/// A command, as a program of ours where it is one.
#[derive(Clone, Debug)]
pub struct Call {
    pub program: String,
    pub arguments: Vec<String>,
    /// What cargo is asked to run it by: the words before `--`.
    cargo: Vec<String>,
    /// Whether it is run in `ipc/clients`; `None` in a sentence, which need not say it.
    is_of_clients: Option<bool>,
}

impl Call {
    /// Reads the commands of a line of a shell: those between `&&`, and in `(cd ipc/clients && ...)`.
    pub fn line(text: &str) -> Vec<Self> {
        let (mut calls, mut is_of_clients) = (Vec::new(), false);
        for part in text.split(" && ") {
            if part == "(cd ipc/clients" {
                is_of_clients = true;
                continue;
            }
            let last = part.strip_suffix(')').filter(|_| is_of_clients);
            calls.push(Self {
                is_of_clients: Some(is_of_clients),
                ..Self::read(last.unwrap_or(part))
            });
            is_of_clients &= last.is_none();
        }
        calls
    }

    /// Reads a command. `cargo run`, `cargo demo`, `cargo table`, `cargo laboratory`,
    /// `target/release/NAME` and `sudo` are seen through.
    pub fn read(text: &str) -> Self {
        let mut words = words(text);
        words.retain(|word| word != "&");
        if words[0] == "sudo" {
            let end = if words[1] == "-u" { 3 } else { 1 };
            words.drain(..end);
        }
        let mut cargo = Vec::new();
        let mut program = words.remove(0);
        if program == "cargo" && (words[0] == "run" || LAB.contains(&&*words[0])) {
            let end = words.iter().position(|word| word == "--");
            let rest = end.map_or(Vec::new(), |end| words.split_off(end + 1));
            cargo = std::mem::replace(&mut words, rest);
            let named = after(&cargo, "--bin").or(after(&cargo, "--example"));
            let named = named.or(after(&cargo, "-p"));
            program = named.unwrap_or(&cargo[0]).to_owned();
        }
        let program = program.trim_start_matches("target/release/").to_owned();
        Self {
            program,
            arguments: words,
            cargo,
            is_of_clients: None,
        }
    }

    /// Whether it is one of these programs.
    pub fn is_one_of(&self, programs: &[&str]) -> bool {
        programs.contains(&&*self.program)
    }

    /// Whether all that the command names exists: package, target, test, files, and flags if it is
    /// one of these programs.
    pub fn check(&self, programs: &[&str]) -> Result<(), String> {
        check_targets(&self.cargo, self.is_of_clients)?;
        if self.is_one_of(programs) {
            self.check_flags()?;
        } else if self.program == "cargo" {
            check_targets(&self.arguments, self.is_of_clients)?;
        }
        let words: Vec<_> = std::iter::once(&self.program)
            .chain(&self.arguments)
            .collect();
        for (place, word) in words.iter().enumerate() {
            let is_written = place > 0 && ["-o", "--output"].contains(&words[place - 1].as_str());
            if !is_written {
                exists(word)?;
            }
        }
        Ok(())
    }

    /// Every flag is one of the program's, or of the subcommand's.
    fn check_flags(&self) -> Result<(), String> {
        let mut help = help(&self.program, None)?;
        let mut words = self.arguments.iter().peekable();
        words
            .next_if(|word| *word == "--domain")
            .map(|_| words.next());
        if ["vpcctl", "vpc-memory", "vpc-camera", "vpc-calib"].contains(&&*self.program)
            && let Some(subcommand) = words.next().filter(|word| !word.starts_with('-'))
        {
            help += &self::help(&self.program, Some(subcommand))?;
        }
        let known: Vec<&str> = help
            .split([' ', ',', '\n', '=', '[', ']', '<', '>'])
            .collect();
        for word in &self.arguments {
            let is_number = word[1..].starts_with(|c: char| c.is_ascii_digit() || c == '.');
            let flag = word.split('=').next().unwrap_or(word);
            if word.starts_with('-') && word != "-" && !is_number && !known.contains(&flag) {
                return Err(format!("{} has no {flag}", self.program));
            }
        }
        Ok(())
    }
}

/// The word after a flag.
pub fn after<'a>(words: &'a [String], flag: &str) -> Option<&'a str> {
    let place = words.iter().position(|word| word == flag)?;
    words.get(place + 1).map(String::as_str)
}

/// Words of a command; quotes hold them together.
fn words(text: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in text.chars() {
        match (quote, c) {
            (None, '\'' | '"') => quote = Some(c),
            (Some(open), c) if open == c => quote = None,
            (None, c) if c.is_whitespace() => words.push(String::new()),
            (_, c) => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A program of ours, or a command of `vpc-lab`.
pub fn command(name: &str) -> Command {
    if !LAB.contains(&name) {
        return testkit::command(testkit::program(name));
    }
    let mut lab = testkit::command(env!("CARGO_BIN_EXE_vpc-lab"));
    lab.arg(name);
    lab
}

/// The help of a program, asked once.
fn help(name: &str, subcommand: Option<&str>) -> Result<String, String> {
    static KNOWN: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());
    let key = format!("{name} {subcommand:?}");
    let mut known = KNOWN.lock().unwrap();
    let help = known.entry(key).or_insert_with(|| {
        let mut command = command(name);
        ended(command.args(subcommand).arg("--help")).stdout
    });
    match help.is_empty() {
        true => Err(format!(
            "{name} has no subcommand {}",
            subcommand.unwrap_or("")
        )),
        false => Ok(help.clone()),
    }
}

/// A word that begins with a directory of the repository is a path, and must be there.
fn exists(word: &str) -> Result<(), String> {
    let path = word.trim_end_matches('/').trim_start_matches("./");
    let top = path.split('/').next().unwrap_or("");
    let is_ours = ["controller", "ipc", "memory-blob", "hw-sim", "tests"].contains(&top);
    let is_path = is_ours && path.contains('/') && !path.contains('$');
    match is_path && !root().join(path).exists() {
        true => Err(format!("{path} does not exist")),
        false => Ok(()),
    }
}

/// The packages of the root and of the clients, as cargo sees them.
fn packages() -> &'static [Vec<Value>; 2] {
    static PACKAGES: OnceLock<[Vec<Value>; 2]> = OnceLock::new();
    PACKAGES.get_or_init(|| {
        [".", "ipc/clients"].map(|workspace| {
            let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
            let mut cargo = testkit::command(cargo);
            cargo.args(["metadata", "--no-deps", "--offline", "--format-version=1"]);
            let said = ended(cargo.current_dir(root().join(workspace)));
            let said: Value = serde_json::from_str(&said.stdout).unwrap();
            said["packages"].as_array().unwrap().clone()
        })
    })
}

/// Package, test, bench, binary, example and filter of a cargo command in a workspace, or in either.
fn check_targets(words: &[String], is_of_clients: Option<bool>) -> Result<(), String> {
    let end = words.iter().position(|word| word == "--");
    let (words, rest) = words.split_at(end.unwrap_or(words.len()));
    let runs_ignored = rest.iter().any(|word| word.contains("ignored"));
    let package = after(words, "-p").or(after(words, "--package"));
    let packages = || {
        let [root, clients] = packages();
        let (has_root, has_clients) = (is_of_clients != Some(true), is_of_clients != Some(false));
        let root = root.iter().filter(move |_| has_root);
        root.chain(clients.iter().filter(move |_| has_clients))
    };
    let named = |p: &&Value| package.is_none_or(|name| p["name"] == name);
    let mut within = packages().filter(named);
    if within.clone().next().is_none() {
        return Err(match is_of_clients {
            Some(true) => format!("ipc/clients has no package {}", package.unwrap_or("")),
            _ => format!("there is no package {} here", package.unwrap_or("")),
        });
    }
    for kind in ["test", "bench", "example", "bin"] {
        let Some(name) = after(words, &format!("--{kind}")) else {
            continue;
        };
        let is_it = |target: &Value| target["kind"][0] == kind && target["name"] == name;
        if !within.any(|package| package["targets"].as_array().unwrap().iter().any(is_it)) {
            return Err(format!("there is no {kind} {name}"));
        }
    }
    let filters = words.iter().enumerate().skip(1).filter(|(place, word)| {
        let is_value = words[place - 1].starts_with("--") || words[place - 1] == "-p";
        let is_value =
            is_value && words[place - 1] != "--workspace" && words[place - 1] != "--release";
        !is_value && !word.starts_with('-') && *word != "NAME"
    });
    for (_, filter) in filters.filter(|_| words[0] == "test") {
        let sources = packages()
            .filter(named)
            .flat_map(|package| sources(package, after(words, "--test")));
        let found: Vec<Test> = sources.flat_map(|path| fitting(&path, filter)).collect();
        if found.is_empty() {
            return Err(format!("there is no test {filter}"));
        }
        if !runs_ignored && found.iter().all(|test| test.is_ignored) {
            return Err(format!(
                "{filter} fits ignored tests only: add -- --ignored"
            ));
        }
    }
    Ok(())
}

/// Whether `NAME`, `MODULE` or `MODULE::NAME`, as `cargo test` takes them, fits a test of a
/// package.
pub fn is_a_test(package: &str, filter: &str) -> Result<(), String> {
    let mut packages = packages().iter().flatten();
    let package = packages.find(|p| p["name"] == package).unwrap();
    let fits = |path: &PathBuf| !fitting(path, filter).is_empty();
    match sources(package, None).iter().any(fits) {
        true => Ok(()),
        false => Err(format!("{} has no test {filter}", package["name"])),
    }
}

/// Whether `cargo xtask measure` has a measurement whose name begins so.
pub fn is_measured(name: &str) -> Result<(), String> {
    let mut sources = Vec::new();
    gather(&root().join("tests/tests/measure"), &mut sources);
    let begin = format!("\"{}", name.trim_matches('"'));
    let is_it = |path: &PathBuf| std::fs::read_to_string(path).unwrap().contains(&begin);
    match sources.iter().any(is_it) {
        true => Ok(()),
        false => Err(format!("there is no measurement {name}")),
    }
}

/// A function that `cargo test` runs.
struct Test {
    name: String,
    is_ignored: bool,
}

/// The tests of a source file that a filter fits.
fn fitting(path: &Path, filter: &str) -> Vec<Test> {
    let text = std::fs::read_to_string(path).unwrap();
    let (module, name) = filter.split_once("::").unwrap_or(("", filter));
    // Behind the mark come more attributes, and then the function.
    let tests = text.split("#[test]").skip(1).filter_map(|rest| {
        let (attributes, rest) = rest.split_once("fn ")?;
        Some(Test {
            name: rest.split('(').next()?.to_owned(),
            is_ignored: attributes.contains("#[ignore"),
        })
    });
    let inside = path.strip_prefix(root()).unwrap();
    let is_in = |module: &str| {
        inside
            .iter()
            .any(|part| Path::new(part).file_stem() == Some(module.as_ref()))
    };
    let fits = |test: &Test| match module {
        "" => is_in(name) || test.name.contains(name),
        module => is_in(module) && test.name.contains(name),
    };
    tests.filter(fits).collect()
}

/// The sources of a package, or of one of its integration tests.
fn sources(package: &Value, test: Option<&str>) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let Some(test) = test else {
        let manifest = Path::new(package["manifest_path"].as_str().unwrap());
        for folder in ["src", "tests"] {
            gather(&manifest.with_file_name(folder), &mut found);
        }
        return found;
    };
    let targets = package["targets"].as_array().unwrap().iter();
    for target in targets.filter(|t| t["kind"][0] == "test" && t["name"] == test) {
        let main = PathBuf::from(target["src_path"].as_str().unwrap());
        match main.ends_with("main.rs") {
            true => gather(main.parent().unwrap(), &mut found),
            false => found.push(main),
        }
    }
    found
}

fn gather(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            gather(&path, found);
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
}
