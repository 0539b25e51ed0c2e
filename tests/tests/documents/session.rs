//! The commands of the READMEs, run in their order in a copy of the repository; long ones with a
//! smaller task.

use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use testkit::{Ended, Place, Running, eventually, root};

use crate::call::{BUILT, Call, after, program};
use crate::markdown::{Document, documents};

/// A memory in seconds.
const SMALL: &str = "--trajectories 6 --iterations 20 --gpr-samples 40";
const SCENE: (&str, &str) = ("SCENE.toml", "ipc/scene/scenes/paper-sim.toml");

/// A reader of one document, in a copy of the repository: links, but for the directories that
/// commands write to.
struct Session {
    document: Document,
    running: Vec<Running>,
    place: Place,
}

impl Session {
    fn of(name: &str) -> Self {
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
        Self {
            document,
            running: Vec::new(),
            place,
        }
    }

    /// The document's first command that begins so, seen through cargo: with words replaced or, for
    /// an empty one, added.
    fn call(&self, words: &str, changes: &[(&str, &str)]) -> Call {
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

    fn command(&self, call: &Call) -> Command {
        let path = match call.is_one_of(&BUILT) {
            true => program(&call.program),
            false => PathBuf::from(&call.program),
        };
        let mut command = testkit::command(path);
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
    fn ends(&self, words: &str, codes: &[i32], changes: &[(&str, &str)]) -> Ended {
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
    fn run(&self, words: &str, changes: &[(&str, &str)]) -> Ended {
        self.ends(words, &[0], changes)
    }

    /// Starts it; it ends with the session.
    fn start(&mut self, words: &str, changes: &[(&str, &str)]) {
        let call = self.call(words, changes);
        self.running.push(Running::start(self.command(&call)));
    }

    /// Daemon and camera at work, which no command of the document starts.
    fn at_work(name: &str) -> Self {
        let mut session = Self::of(name);
        for text in [
            "vpcd --scene ipc/scene/scenes/paper-sim.toml",
            "hw-sim --config hw-sim/hw-sim.toml --start 82 --time-limit 600",
        ] {
            let command = session.command(&Call::read(text));
            session.running.push(Running::start(command));
        }
        session.arm();
        session
    }

    /// `vpcctl arm`, again until daemon and camera are there.
    fn arm(&self) {
        eventually("arming", || {
            let said = testkit::ended(self.command(&Call::read("vpcctl arm")));
            (said.code == Some(0)).then_some(())
        });
    }

    /// Waits for the end of what was started last: a run that is judged, arrived or not. Returns
    /// what it said.
    fn is_judged(&mut self) -> Ended {
        let said = self
            .running
            .pop()
            .unwrap()
            .ended_within(6 * testkit::PATIENCE);
        assert!(matches!(said.code, Some(0 | 1)), "{said:?}");
        assert!(said.stdout.contains("\"verdict\""), "{said:?}");
        said
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        while self.running.pop().is_some() {}
    }
}

#[test]
fn the_commands_of_the_readme_run() {
    let mut readme = Session::of("README.md");
    let small = "--memory memory-blob/default/paper-sim.vpcmem --strategies gpr:3 --repeats 1";
    readme.run("table --scene", &[("", small)]);
    let file = ("FILE", "small.vpcmem");
    readme.run("vpc-memory build SCENE.toml", &[SCENE, file, ("", SMALL)]);
    readme.run("vpc-memory inspect FILE", &[file]);
    readme.run("vpc-memory verify FILE", &[SCENE, file]);
    readme.start("vpcd --config", &[]);
    // It would go on until Ctrl-C.
    readme.start("hw-sim --config", &[("--all", "--start"), ("--loop", "0")]);
    readme.arm();
    // Its standard output is no terminal here.
    readme.ends("vpcctl watch", &[64], &[]);
    readme.is_judged();
}

#[test]
fn the_commands_of_the_emulators_readme_run() {
    let mut readme = Session::of("hw-sim/README.md");
    readme.start("vpcd --scene", &[]);
    readme.run("hw-sim --config", &[]);
    // One start of one strategy instead of 200 runs.
    let few = [("previous:3,gpr:3,foresight:3", "gpr:3"), ("", "--only 0")];
    readme.run("table --robot panda", &few);
}

#[test]
fn the_commands_about_recordings_run() {
    let readme = Session::at_work("ipc/recording/README.md");
    readme.run("vpcctl record run.mcap", &[("", "--duration 1")]);
    readme.run("vpcctl plot run.mcap", &[]);
}

#[test]
fn the_commands_of_the_operators_readme_run() {
    let mut readme = Session::at_work("controller/vpcctl/README.md");
    // In front of the occlusion the camera stands; it may still be on its way.
    readme.ends("vpcctl status", &[0, 1], &[]);
    readme.ends("vpcctl watch", &[64], &[]);
    readme.start("vpcctl serve", &[("", "--listen 127.0.0.1:0")]);
    readme.run("vpcctl arm", &[]);
    // What it finds is the machine's.
    readme.ends("vpcctl doctor", &[0, 1], &[]);
    readme.run("vpcctl metrics", &[("", "--once")]);
    readme.run("vpcctl record run.mcap", &[("", "--duration 1")]);
    readme.run("vpcctl plot run.mcap", &[]);
}

#[test]
fn the_guide_to_a_task_of_ones_own_runs() {
    let mut guide = Session::of("memory-blob/GUIDE.md");
    guide.run("mkdir -p own", &[]);
    // Something to go round.
    let obstacles = "--ellipse 480,330,40,30 --box 150,90,60,20";
    guide.run("vpc-memory new own/scene.toml", &[("", obstacles)]);
    guide.run("vpc-memory mask own/scene.toml", &[]);
    guide.run("vpc-memory preview own/painted.toml", &[]);
    let small = [("", "--trajectories 12 --gpr-samples 60 --iterations 30")];
    guide.run("vpc-memory build own/painted.toml", &small);
    guide.run("vpc-memory verify own/task.vpcmem", &[]);
    guide.run("vpc-memory starts own/painted.toml", &[("50", "5")]);
    guide.run("table --scene own/painted.toml", &[("", "--repeats 1")]);
    for (path, text) in guide.document.files() {
        std::fs::write(guide.place.path(path), text).unwrap();
    }
    guide.start("vpcd --config own/vpcd.toml", &[]);
    guide.start("hw-sim --scene own/painted.toml", &[]);
    // A memory of a few trajectories need not lead every start to the goal.
    guide.is_judged();
}

/// Areas far from a pattern with markers, of a camera of 1280x720 px: the referee's work is largest
/// where nothing is near.
#[test]
fn the_guides_emulator_keeps_real_time() {
    let mut guide = Session::of("memory-blob/GUIDE.md");
    guide.run("mkdir -p own", &[]);
    let (large, goal) = (("640x480", "1280x720"), ("0.4", "0.5"));
    let changes = [large, goal, ("610", "900"), ("", "--marker-size 0.03")];
    guide.run("vpc-memory new own/scene.toml", &changes);
    guide.run("vpc-memory mask own/scene.toml", &[]);
    let areas = [(150, 150), (1130, 150), (640, 690)];
    let is_white = |i: u32, j: u32| {
        let is_near = |(u, v): &(u32, u32)| i.abs_diff(*u).pow(2) + j.abs_diff(*v).pow(2) < 900;
        areas.iter().any(is_near)
    };
    scene::write_mask(&guide.place.path("own/areas.png"), 1280, 720, is_white).unwrap();
    let small = [("", "--trajectories 12 --gpr-samples 60 --iterations 30")];
    guide.run("vpc-memory build own/painted.toml", &small);
    // The goal, turned: all the way the areas are 150 px from the markers.
    let turned = "tx,ty,tz,rx,ry,rz\n0,0,0.5,0,0,1.4\n";
    std::fs::write(guide.place.path("own/starts.csv"), turned).unwrap();
    let said = guide.run("table --scene own/painted.toml", &[("", "--repeats 1")]);
    assert!(
        said.stdout.contains("| foresight:3 | 100.0 % |"),
        "{said:?}"
    );
    for (path, text) in guide.document.files() {
        std::fs::write(guide.place.path(path), text).unwrap();
    }
    guide.start("vpcd --config own/vpcd.toml", &[]);
    guide.start("hw-sim --scene own/painted.toml", &[]);
    let said = guide.is_judged();
    let outcome: serde_json::Value = serde_json::from_str(&said.stdout).unwrap();
    // A machine that stands still delays a frame or two.
    let late = outcome["late"]["late"].as_f64().unwrap_or(0.0);
    let frames = outcome["frames"].as_f64().unwrap();
    assert!(frames > 20.0 && late < 0.1 * frames, "{said:?}");
    assert_eq!(outcome["verdict"], "arrived", "{said:?}");
}

#[test]
fn the_commands_about_memories_run() {
    let builder = Session::of("memory-blob/builder/README.md");
    builder.run("vpc-memory build", &[("", SMALL)]);
}
