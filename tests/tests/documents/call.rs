//! A command of a document as a program with arguments, and what can be said of it without running it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, OnceLock};

use crate::root;

/// The programs of the workspace that the documents call.
const OURS: [&str; 8] = [
    "vpcd",
    "hw-sim",
    "vpcctl",
    "vpc-memory",
    "vpc-replay",
    "demo",
    "table",
    "processes",
];

/// A command, as a program of ours where it is one.
#[derive(Clone, Debug)]
pub struct Call {
    pub program: String,
    pub arguments: Vec<String>,
    /// What cargo is asked to build for it: the words before `--`.
    cargo: Vec<String>,
}

impl Call {
    /// Reads a command. `cargo run`, `cargo demo`, `cargo table`, `target/release/NAME` and `sudo` are seen through.
    pub fn read(text: &str) -> Self {
        let mut words = words(text);
        words.retain(|word| word != "&");
        if words[0] == "sudo" {
            words.remove(0);
            if words[0] == "-u" {
                words.drain(..2);
            }
        }
        let mut cargo = Vec::new();
        let name = match (words[0].as_str(), words.get(1).map(String::as_str)) {
            ("cargo", Some(alias @ ("demo" | "table"))) => {
                let alias = alias.to_owned();
                words.drain(..2);
                if words.first().is_some_and(|word| word == "--") {
                    words.remove(0);
                }
                alias
            }
            ("cargo", Some("run")) => {
                let end = words.iter().position(|word| word == "--");
                let rest = end.map_or(Vec::new(), |end| words.split_off(end + 1));
                cargo = std::mem::replace(&mut words, rest);
                cargo.retain(|word| word != "--");
                match (after(&cargo, "--example"), after(&cargo, "--bin")) {
                    (Some(example), _) => format!("examples/{example}"),
                    (None, Some(bin)) => bin.to_owned(),
                    (None, None) => after(&cargo, "-p").unwrap().to_owned(),
                }
            }
            (path, _) => {
                let name = path
                    .strip_prefix("target/release/")
                    .unwrap_or(path)
                    .to_owned();
                words.remove(0);
                name
            }
        };
        Self {
            program: name,
            arguments: words,
            cargo,
        }
    }

    /// Whether it is a program of the workspace.
    pub fn is_ours(&self) -> bool {
        OURS.contains(&&*self.program) || self.program.starts_with("examples/")
    }

    /// Whether all that the command names exists: package, target, test, flags, files.
    pub fn check(&self) -> Result<(), String> {
        if !self.cargo.is_empty() {
            target(&self.cargo)?;
        }
        if OURS.contains(&&*self.program) {
            self.check_flags()?;
        } else if self.program == "cargo" {
            target(&self.arguments)?;
        } else if self.program == "systemctl" || self.program == "journalctl" {
            self.check_units()?;
        }
        let mut written = false;
        for word in std::iter::once(&self.program).chain(&self.arguments) {
            if !written {
                exists(word)?;
            }
            written = ["-o", "--output"].contains(&&**word);
        }
        Ok(())
    }

    /// Every flag is one of the program's, or of the subcommand's.
    fn check_flags(&self) -> Result<(), String> {
        let has_subcommands = ["vpcctl", "vpc-memory"].contains(&&*self.program);
        let mut before: Vec<&str> = Vec::new();
        if has_subcommands {
            let mut words = self.arguments.iter();
            while let Some(word) = words.next() {
                match word.as_str() {
                    "--domain" => drop(words.next()),
                    name => {
                        before.push(name);
                        break;
                    }
                }
            }
        }
        // It hands its words on to another program.
        let help = match (self.program.as_str(), &before[..]) {
            ("vpcctl", ["replay"]) => help("vpc-replay", &[])?,
            (program, before) => help(program, before)?,
        };
        let knows = |flag: &str| {
            let mut known = help.split([' ', ',', '\n', '=', '[', ']', '<', '>']);
            known.any(|word| word == flag)
        };
        for word in &self.arguments {
            let is_number = word[1..].starts_with(|c: char| c.is_ascii_digit() || c == '.');
            let flag = word.split('=').next().unwrap_or(word);
            if word.starts_with('-') && word != "-" && !is_number && !knows(flag) {
                let name = format!("{} {}", self.program, before.join(" "));
                return Err(format!("{} knows no {flag}", name.trim()));
            }
        }
        Ok(())
    }

    /// Units are those that ship.
    fn check_units(&self) -> Result<(), String> {
        let unit = match after(&self.arguments, "-u") {
            Some(unit) => unit,
            None => self.arguments.get(1).ok_or("no unit is named")?,
        };
        exists(&format!("controller/systemd/{unit}.service"))
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

/// The help of a program, asked once.
fn help(program: &str, subcommand: &[&str]) -> Result<String, String> {
    static KNOWN: Mutex<BTreeMap<String, Result<String, String>>> = Mutex::new(BTreeMap::new());
    let name = format!("{program} {}", subcommand.join(" "));
    let mut known = KNOWN.lock().unwrap();
    let ask = || {
        let mut command = Command::new(self::program(program));
        command.args(subcommand).arg("--help").stdin(Stdio::null());
        let output = command.output().map_err(|e| format!("{name}: {e}"))?;
        match output.status.success() {
            true => Ok(String::from_utf8(output.stdout).unwrap()),
            false => Err(format!(
                "{name}: {}",
                String::from_utf8_lossy(&output.stderr)
            )),
        }
    };
    known.entry(name.clone()).or_insert_with(ask).clone()
}

/// A program of the workspace, or `examples/NAME`, built in the profile of the tests.
pub fn program(name: &str) -> PathBuf {
    static BINARIES: OnceLock<PathBuf> = OnceLock::new();
    let binaries = BINARIES.get_or_init(|| {
        let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        build.current_dir(root()).args(["build", "--quiet"]);
        for package in ["controller", "hw-sim", "vpcctl", "vpc-client-c"] {
            build.args(["-p", package]);
        }
        build.args(["-p", "memory-builder", "-p", "recording", "--bins"]);
        build.args(["-p", "memory-blob", "--example", "check"]);
        if !cfg!(debug_assertions) {
            build.arg("--release");
        }
        assert!(build.status().unwrap().success(), "the build failed");
        Path::new(env!("CARGO_BIN_EXE_demo"))
            .parent()
            .unwrap()
            .to_owned()
    });
    binaries.join(name)
}

/// A word that begins with a place of the repository must be there.
fn exists(word: &str) -> Result<(), String> {
    let path = word.trim_end_matches('/').trim_start_matches("./");
    let top = path.split('/').next().unwrap_or("");
    let is_ours = ["controller", "ipc", "memory-blob", "hw-sim", "tests"].contains(&top);
    if is_ours && path.contains('/') && !root().join(path).exists() {
        return Err(format!("{path} does not exist"));
    }
    Ok(())
}

/// Package, test, bench, binary, example and filter of a cargo command.
fn target(words: &[String]) -> Result<(), String> {
    let end = words.iter().position(|word| word == "--");
    let words = &words[..end.unwrap_or(words.len())];
    let Some(name) = after(words, "-p") else {
        return Ok(());
    };
    let directory = package(name)?;
    for (flag, folder) in [
        ("--test", "tests"),
        ("--bench", "benches"),
        ("--example", "examples"),
        ("--bin", "src/bin"),
    ] {
        let Some(target) = after(words, flag) else {
            continue;
        };
        let manifest = std::fs::read_to_string(directory.join("Cargo.toml")).unwrap();
        let folder = directory.join(folder);
        let known = folder.join(format!("{target}.rs")).exists()
            || folder.join(target).join("main.rs").exists()
            || manifest.contains(&format!("name = \"{target}\""));
        if !known {
            return Err(format!("{name} has no {flag} {target}"));
        }
    }
    if words.first().is_some_and(|word| word == "test") {
        filter(words, &directory)?;
    }
    Ok(())
}

/// The filter of a `cargo test` fits the name of a test, or of a module with tests.
fn filter(words: &[String], directory: &Path) -> Result<(), String> {
    let mut rest = words.iter().skip(1);
    while let Some(word) = rest.next() {
        match word.as_str() {
            "-p" | "--test" | "--bench" => drop(rest.next()),
            "NAME" => (),
            flag if flag.starts_with('-') => (),
            filter => return is_a_test(directory, filter),
        }
    }
    Ok(())
}

/// Whether a path of module and beginning of a test, either alone or both, is one of a package.
pub fn is_a_test(directory: &Path, filter: &str) -> Result<(), String> {
    let mut sources = Vec::new();
    for folder in ["src", "tests"] {
        gather(&directory.join(folder), &mut sources);
    }
    let (module, name) = filter.split_once("::").unwrap_or(("", filter));
    let fits = |path: &Path, text: &str| {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let has_test = |part: &str| {
            let mut names = text.split("fn ").skip(1).map(|rest| rest.split('(').next());
            names.any(|name| name.is_some_and(|name| name.contains(part)))
        };
        let is_tested = text.contains("#[test]");
        match module {
            "" => is_tested && (stem == name || has_test(name)),
            module => stem == module && has_test(name),
        }
    };
    let mut read = sources
        .iter()
        .map(|path| (path, std::fs::read_to_string(path).unwrap()));
    match read.any(|(path, text)| fits(path, &text)) {
        true => Ok(()),
        false => Err(format!("{} has no test {filter}", directory.display())),
    }
}

fn gather(directory: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(directory) else {
        return;
    };
    for path in entries.map(|entry| entry.unwrap().path()) {
        match path.is_dir() {
            true => gather(&path, found),
            false if path.extension().is_some_and(|end| end == "rs") => found.push(path),
            false => (),
        }
    }
}

/// The directory of a package of the workspace.
pub fn package(name: &str) -> Result<PathBuf, String> {
    let manifest: toml::Table = std::fs::read_to_string(root().join("Cargo.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let members = manifest["workspace"]["members"].as_array().unwrap();
    let found = members.iter().find_map(|member| {
        let directory = root().join(member.as_str().unwrap());
        let text = std::fs::read_to_string(directory.join("Cargo.toml")).unwrap();
        let own: toml::Table = text.parse().unwrap();
        (own["package"]["name"].as_str() == Some(name)).then_some(directory)
    });
    found.ok_or_else(|| format!("there is no package {name}"))
}
