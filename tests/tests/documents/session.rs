//! The commands of the READMEs, run in their order in a copy of the repository; long ones with a
//! smaller task.

use std::os::unix::fs::symlink;
use std::process::{Command, Stdio};

use testkit::{Ended, Place, Running, root};

use crate::call::{self, BUILT, Call, after};
use crate::markdown::{Document, documents};

/// A memory in seconds.
pub const SMALL: &str = "--trajectories 6 --iterations 20 --gpr-samples 40";
pub const SCENE: (&str, &str) = ("SCENE.toml", "ipc/scene/scenes/paper-sim.toml");

/// A reader of one document, in a copy of the repository: links, but for the directories that
/// commands write to.
pub struct Session {
    pub document: Document,
    pub place: Place,
}

impl Session {
    pub fn of(name: &str) -> Self {
        let mut documents = documents().into_iter();
        let document = documents.find(|document| document.name == name).unwrap();
        let place = Place::new();
        for entry in std::fs::read_dir(root()).unwrap().map(Result::unwrap) {
            let name = entry.file_name();
            if !["out", "own", "target", ".git"]
                .iter()
                .any(|made| name == *made)
            {
                symlink(entry.path(), place.directory().join(name)).unwrap();
            }
        }
        Self { document, place }
    }

    /// The document's first command that begins so, seen through cargo: with words replaced or, for
    /// an empty one, added.
    pub fn call(&self, words: &str, changes: &[(&str, &str)]) -> Call {
        let commands = self.document.commands().into_iter();
        let mut calls = commands.map(|command| Call::read(&command.text));
        let call = calls.find(|call| {
            let text = format!("{} {}", call.program, call.arguments.join(" "));
            text.starts_with(words)
        });
        let name = &self.document.name;
        let mut call = call.unwrap_or_else(|| panic!("{name}: no command `{words}`"));
        for (old, new) in changes {
            if old.is_empty() {
                call.arguments.extend(new.split(' ').map(str::to_owned));
                continue;
            }
            let place = call.arguments.iter().position(|word| word == old);
            let place = place.unwrap_or_else(|| panic!("{name}: {words}: no word {old}"));
            call.arguments[place] = (*new).to_owned();
        }
        call
    }

    pub fn command(&self, call: &Call) -> Command {
        let mut command = match call.is_one_of(&BUILT) {
            true => call::command(&call.program),
            false => testkit::command(&call.program),
        };
        if ["vpcd", "hw-sim", "vpcctl"].contains(&&*call.program) {
            command.arg("--domain").arg(self.place.domain());
        }
        command
            .args(&call.arguments)
            .current_dir(self.place.directory());
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    /// Runs it to its end, which comes with one of these exit codes.
    pub fn ends(&self, words: &str, codes: &[i32], changes: &[(&str, &str)]) -> Ended {
        let call = self.call(words, changes);
        let said = Running::start(self.command(&call)).ended_within(6 * testkit::PATIENCE);
        let is_good = said.code.is_some_and(|code| codes.contains(&code));
        assert!(is_good, "{}: {words}: {said:?}", self.document.name);
        if let Some(file) = after(&call.arguments, "-o") {
            assert!(
                self.place.path(file).exists(),
                "{words}: no {file}: {said:?}"
            );
        }
        said
    }

    /// Runs it to its end, which is success.
    pub fn run(&self, words: &str, changes: &[(&str, &str)]) -> Ended {
        self.ends(words, &[0], changes)
    }

    /// Makes a scene, its mask and a small memory by the commands of the guide.
    pub fn makes_a_task(&self) {
        self.run("mkdir -p own", &[]);
        // Something to go round.
        let obstacles = "--ellipse 480,330,40,30 --box 150,90,60,20";
        self.run("vpc-memory new own/scene.toml", &[("", obstacles)]);
        self.run("vpc-memory mask own/scene.toml", &[]);
        self.run("vpc-memory preview own/painted.toml", &[]);
        let small = [("", "--trajectories 12 --gpr-samples 60 --iterations 30")];
        self.run("vpc-memory build own/painted.toml", &small);
        self.run("vpc-memory verify own/task.vpcmem", &[]);
    }
}
