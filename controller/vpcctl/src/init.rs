//! `init`: writes the folder of configuration files that a robot's recipe needs.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use arm::Model;
use clap::{Args, ValueEnum};
use program::Exit;

use crate::failure::Failure;

/// The command line of `init`.
#[derive(Clone, Debug, Args)]
pub struct InitArguments {
    /// Which robot: panda (also an FR3, with --robot).
    #[arg(value_enum)]
    pub recipe: Recipe,

    /// Directory to write to; it is created if it does not exist.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,

    /// The robot and the address of its control unit.
    #[arg(long, value_name = "MODEL:ADDRESS", default_value = ROBOT, value_parser = robot)]
    pub robot: String,
}

/// What there is a folder for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Recipe {
    /// A Franka Panda or FR3 with a camera in its hand, tags, and `vpc-panda`.
    Panda,
}

/// The robot of `vpc-panda.toml` as it ships.
const ROBOT: &str = "panda:172.16.0.2";
/// The scene of the files as they ship, each by its own path.
const SCENES: [&str; 2] = [
    "../../scene/scenes/tags-robot.toml",
    "../ipc/scene/scenes/tags-robot.toml",
];
/// Where `vpcd.toml` names its scene, and what stands behind that in the folder.
const SCENE_LINE: &str = "scene = \"scene.toml\"\n";
const MEMORY_LINE: &str = "# memory = \"task.vpcmem\" # foresight needs none; vpc-memory build scene.toml -o task.vpcmem\n";
/// What a real robot needs; without the right to it, `vpcd` says so and goes on.
const REAL_TIME: &str = "
[realtime]
priority = 80           # SCHED_FIFO; see vpcd --preflight
";
/// The emulated robot, for a rehearsal without one. Its other keys have defaults.
const EMULATOR: &str = "\
# Configuration of hw-sim: an emulated robot at the address 127.0.0.1, whose camera sends the points of the scene.

scene = \"scene.toml\"
starts = \"starts.csv\"
robot = \"panda\"
fci = \"127.0.0.1:1337\"
";

/// Reads a robot as `vpc-panda --robot` does.
fn robot(text: &str) -> Result<String, String> {
    let named = text.split_once(':').filter(|(_, at)| !at.is_empty());
    let is_known = named.is_some_and(|(model, _)| model.parse::<Model>().is_ok());
    match is_known {
        true => Ok(text.to_owned()),
        false => Err("allowed: panda:ADDRESS or fr3:ADDRESS".to_owned()),
    }
}

/// The files: names and texts. Paths in them are relative to their folder.
fn files(robot: &str) -> [(&'static str, String); 7] {
    let here = |text: &str| {
        // The schemas are not in the folder.
        let lines = text.lines().filter(|line| !line.starts_with("#:schema"));
        let text: String = lines.map(|line| format!("{line}\n")).collect();
        SCENES
            .iter()
            .fold(text, |text, scene| text.replace(scene, "scene.toml"))
    };
    let camera = here(include_str!("../../../ipc/clients/camera/vpc-camera.toml")).replace(
        "# calibration = \"lens.yaml\"",
        "# calibration = \"camera.toml\"",
    );
    let bridge = here(include_str!("../../../ipc/clients/panda/vpc-panda.toml"))
        .replace("../../scene/scenes/paper-robot.toml", "scene.toml")
        .replace(ROBOT, robot);
    let emulator = match robot.starts_with("fr3:") {
        true => format!("{EMULATOR}fci_version = 10\n"),
        false => EMULATOR.to_owned(),
    };
    let daemon = here(include_str!("../../vpcd-tags.toml"))
        .replace(SCENE_LINE, &format!("{SCENE_LINE}{MEMORY_LINE}"))
        .replace(
            "hw-sim/hw-sim-tags.toml and ipc/clients/camera/vpc-camera.toml",
            "vpc-camera.toml",
        )
        .replace("in vpcd.toml; use", "in controller/CONFIGURATION.md; use");
    [
        ("scene.toml", here(scene::TAGS_ROBOT)),
        ("vpc-camera.toml", camera),
        ("vpc-panda.toml", bridge),
        (
            "hand-eye.toml",
            here(include_str!("../../../ipc/clients/panda/hand-eye.toml")),
        ),
        ("vpcd.toml", daemon + REAL_TIME),
        ("hw-sim.toml", emulator),
        ("starts.csv", scene::TAGS_ROBOT_STARTS.to_owned()),
    ]
}

/// Writes all files, or none: their names, a line each.
///
/// # Errors
/// A file is there already, or cannot be written. Then nothing is left of the others.
pub fn init(arguments: &InitArguments) -> Result<String, Failure> {
    let directory = &arguments.directory;
    let files = files(&arguments.robot);
    let is_there = |name: &&str| directory.join(name).symlink_metadata().is_ok();
    let there: Vec<&str> = files
        .iter()
        .map(|(name, _)| *name)
        .filter(is_there)
        .collect();
    if !there.is_empty() {
        let message = format!(
            "{}: there already: {}; nothing was written; allowed: a directory without these files",
            directory.display(),
            there.join(", ")
        );
        return Err(Failure::new(Exit::Refused, message));
    }
    let is_new = !directory.exists();
    fs::create_dir_all(directory).map_err(Failure::write(directory))?;
    let mut written = Vec::new();
    for (name, text) in &files {
        let path = directory.join(name);
        if let Err(error) = create(&path, text, &mut written) {
            remove(&written, is_new.then_some(directory));
            return Err(Failure::write(&path)(error));
        }
    }
    let lines = written.iter().map(|path| format!("{}\n", path.display()));
    Ok(lines.collect())
}

fn create(path: &Path, text: &str, written: &mut Vec<PathBuf>) -> io::Result<()> {
    // One that came meanwhile is not overwritten either.
    let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
    written.push(path.to_owned());
    file.write_all(text.as_bytes())
}

fn remove(written: &[PathBuf], directory: Option<&PathBuf>) {
    // The first error is the one that is reported.
    for path in written {
        let _ = fs::remove_file(path);
    }
    if let Some(directory) = directory {
        let _ = fs::remove_dir(directory);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(directory: &Path) -> InitArguments {
        InitArguments {
            recipe: Recipe::Panda,
            directory: directory.to_owned(),
            robot: "fr3:10.0.0.2".to_owned(),
        }
    }

    #[test]
    fn every_path_in_the_files_is_one_of_the_folder() {
        let files = files("fr3:10.0.0.2");
        let text = |name| &files.iter().find(|(file, _)| *file == name).unwrap().1;
        for (name, text) in &files {
            assert!(
                !text.contains("../") && !text.contains("#:schema"),
                "{name}"
            );
        }
        for name in ["vpc-camera.toml", "vpc-panda.toml", "vpcd.toml"] {
            assert!(text(name).contains("scene = \"scene.toml\""), "{name}");
        }
        assert!(text("vpc-camera.toml").contains("# calibration = \"camera.toml\""));
        assert!(text("vpcd.toml").contains("# memory = \"task.vpcmem\""));
        assert!(text("vpcd.toml").contains("priority = 80"));
        assert!(!text("vpcd.toml").contains("in vpcd.toml"));
        assert!(text("hw-sim.toml").contains("fci_version = 10"));
        assert!(text("vpc-panda.toml").contains("robot = \"fr3:10.0.0.2\""));
        assert!(!self::files(ROBOT)[5].1.contains("fci_version"));
        assert_eq!(robot(ROBOT).as_deref(), Ok(ROBOT));
        assert!(robot("ur5:10.0.0.2").is_err() && robot("panda:").is_err());
    }

    #[test]
    fn nothing_is_overwritten_and_all_or_nothing_is_written() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("cell");
        let names = init(&arguments(&folder)).unwrap();
        assert_eq!(names.lines().count(), 7);
        fs::remove_file(folder.join("vpcd.toml")).unwrap();
        let failure = init(&arguments(&folder)).unwrap_err();
        assert_eq!(failure.exit, Exit::Refused);
        let message = failure.to_string();
        assert!(message.contains("scene.toml, vpc-camera.toml"), "{message}");
        assert!(!message.contains("vpcd.toml") && !folder.join("vpcd.toml").exists());
    }

    #[test]
    fn what_was_written_before_a_failure_is_removed() {
        let place = tempfile::tempdir().unwrap();
        let first = place.path().join("new").join("first");
        fs::create_dir(place.path().join("new")).unwrap();
        let mut written = Vec::new();
        create(&first, "text", &mut written).unwrap();
        assert!(create(&first, "other", &mut written).is_err());
        remove(&written, Some(&place.path().join("new")));
        assert!(!place.path().join("new").exists());
    }
}
