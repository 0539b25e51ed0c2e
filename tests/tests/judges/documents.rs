//! What the documents say, where other programs or real time judge it: the README's and the guide's
//! commands with a daemon at work, the flags of the clients' programs, configuration files by Python's
//! `jsonschema`, and the book by mdBook.

use testkit::python::Environment;
use testkit::{Ended, Running, eventually};

use crate::call::{CLIENTS, Call};
use crate::commands::check_commands;
use crate::reference;
use crate::session::Session;

/// A session with programs at work, which end with it, the last one first.
struct Live {
    session: Session,
    running: Vec<Running>,
}

impl Live {
    fn of(name: &str) -> Self {
        Self::from(Session::of(name))
    }

    fn from(session: Session) -> Self {
        let running = Vec::new();
        Self { session, running }
    }

    /// Starts a command of the document.
    fn start(&mut self, words: &str, changes: &[(&str, &str)]) {
        let call = self.session.call(words, changes);
        let command = self.session.command(&call);
        self.running.push(Running::start(command));
    }

    /// Daemon and camera at work, which no command of the document starts.
    fn at_work(name: &str) -> Self {
        let mut live = Self::of(name);
        for text in [
            "vpcd --scene ipc/scene/scenes/paper-sim.toml",
            "hw-sim --config hw-sim/hw-sim.toml --start 82 --time-limit 600",
        ] {
            let command = live.session.command(&Call::read(text));
            live.running.push(Running::start(command));
        }
        live.arm();
        live
    }

    /// Waits until `vpcctl arm` finds daemon and camera.
    fn arm(&self) {
        eventually("arming", || {
            let arm = self.session.command(&Call::read("vpcctl arm"));
            (testkit::ended(arm).code == Some(0)).then_some(())
        });
    }

    /// Waits for the end of what was started last: a run that is judged, arrived or not. Returns
    /// what it said.
    fn is_judged(&mut self) -> Ended {
        let last = self.running.pop().unwrap();
        let said = last.ended_within(6 * testkit::PATIENCE);
        assert!(matches!(said.code, Some(0 | 1)), "{said:?}");
        assert!(said.stdout.contains("\"verdict\""), "{said:?}");
        said
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        while self.running.pop().is_some() {}
    }
}

#[test]
fn the_readme_leads_to_a_run() {
    let mut readme = Live::of("README.md");
    readme.start("vpcd --config", &[]);
    // It would go on until Ctrl-C.
    readme.start("hw-sim --config", &[("--all", "--start"), ("--loop", "0")]);
    readme.arm();
    // Its standard output is no terminal here.
    readme.session.ends("vpcctl watch", &[64], &[]);
    readme.is_judged();
}

#[test]
fn the_emulators_readme_leads_to_a_run() {
    let mut readme = Live::of("hw-sim/README.md");
    readme.start("vpcd --scene", &[]);
    readme.session.run("hw-sim --config", &[]);
}

#[test]
fn the_commands_about_recordings_run() {
    let live = Live::at_work("ipc/recording/README.md");
    let readme = &live.session;
    readme.run("vpcctl record run.mcap", &[("", "--duration 1")]);
    readme.run("vpcctl plot run.mcap", &[]);
}

#[test]
fn the_commands_of_the_operators_readme_run() {
    let mut live = Live::at_work("controller/vpcctl/README.md");
    live.start("vpcctl serve", &[("", "--listen 127.0.0.1:0")]);
    let readme = &live.session;
    // In front of the occlusion the camera stands; it may still be on its way.
    readme.ends("vpcctl status", &[0, 1], &[]);
    readme.ends("vpcctl watch", &[64], &[]);
    // What it finds is the machine's.
    readme.ends("vpcctl doctor", &[0, 1], &[]);
    readme.run("vpcctl metrics", &[("", "--once")]);
    readme.run("vpcctl record run.mcap", &[("", "--duration 1")]);
    readme.run("vpcctl plot run.mcap", &[]);
}

/// Areas far from a pattern with markers, of a camera of 1280x720 px: the referee's work is largest
/// where nothing is near.
#[test]
fn the_guides_emulator_keeps_real_time() {
    let guide = Session::of("memory-blob/GUIDE.md");
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
    let mut guide = Live::from(guide);
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
fn commands_of_the_clients_have_their_flags() {
    check_commands(&CLIENTS, |call| call.is_one_of(&CLIENTS), 20);
}

/// Our readers agree with the schemas (`documents/reference.rs`), and so does Python's `jsonschema`.
#[test]
fn every_bound_of_a_configuration_file_is_in_its_schema() {
    let what = "configuration files against their JSON Schemas";
    let Some(python) = Environment::JUDGES.python(what) else {
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("cases.json");
    std::fs::write(&file, serde_json::to_string(&reference::cases()).unwrap()).unwrap();
    let program = "import json, sys, tomllib, jsonschema\n\
        for case in json.load(open(sys.argv[1])):\n\
        \x20   jsonschema.Draft7Validator.check_schema(case['schema'])\n\
        \x20   errors = list(jsonschema.Draft7Validator(case['schema']).iter_errors(tomllib.loads(case['text'])))\n\
        \x20   if bool(errors) == case['good']:\n\
        \x20       sys.exit(f\"{case['name']}, good {case['good']}: {case['text']!r} {errors}\")\n";
    let mut command = testkit::command(python);
    let outcome = testkit::python::run(command.args(["-c", program]).arg(file));
    assert_eq!(outcome, Ok(String::new()));
}
