//! A new scene for a daemon: its memory is built, both take the place of the daemon's files, and
//! the daemon begins again with them, disarmed.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use program::Exit;
use rustix::process::{Pid, Signal, kill_process};
use scene::SceneFiles;

use crate::failure::Failure;
use crate::presence::{self, Presence};
use crate::settings::Settings;

/// What builds memories.
const BUILDER: &str = "vpc-memory";
/// Ends the names of files that were there before.
const BEFORE: &str = ".before";
/// And of those that are taken back where the daemon does not take the new ones.
const UNDO: &str = ".undo";
/// Ends of the names of files that are moved away.
const PASSING: [&str; 4] = ["undo", "next", "taught", "partial"];
/// How long a daemon may check the files, brake and begin again.
const PATIENCE: Duration = Duration::from_secs(10);
/// Between two looks.
const PAUSE: Duration = Duration::from_millis(20);

/// A daemon at work, and its files.
#[derive(Debug)]
pub struct Daemon {
    directory: PathBuf,
    process: Pid,
    /// Its scene.
    pub scene: PathBuf,
    /// Its memory of motion, if it has one.
    pub memory: Option<PathBuf>,
}

impl Daemon {
    /// The daemon of this domain.
    ///
    /// # Errors
    /// None is at work, or it has not left its configuration in the domain.
    pub fn of(directory: &Path) -> Result<Self, Failure> {
        let process = Presence::of(directory).process();
        let process = process.and_then(|process| Pid::from_raw(process.try_into().ok()?));
        let settings = Settings::of(directory);
        let scene = settings.scene.ok_or_else(|| {
            let file = directory.join(ipc::CONFIG_FILE);
            let message = format!("{}: names no scene; is it vpcd's?", file.display());
            Failure::new(Exit::Data, message)
        });
        Ok(Self {
            directory: directory.to_owned(),
            process: process.ok_or_else(|| presence::absent(directory))?,
            scene: scene?,
            memory: settings.memory,
        })
    }

    /// Checks the text of a scene that is to take the place of the daemon's, with the files beside
    /// that one: what it says of more than goal and starts is as the daemon has it, but for the
    /// keys and tables that are `accepted`.
    ///
    /// # Errors
    /// The scene is wrong, or differs: names each key with both values.
    pub fn check(&self, text: String, accepted: &[String]) -> Result<(), Failure> {
        let new = SceneFiles::parse_at(text, &self.scene)?;
        let mut others = SceneFiles::read(&self.directory.join(ipc::SCENE_FILE))?.differences(&new);
        others.retain(|one| !accepted.iter().any(|name| one.is_within(name)));
        if others.is_empty() {
            return Ok(());
        }
        let differ: Vec<_> = others.iter().map(ToString::to_string).collect();
        let message = format!(
            "not only goal and starts differ from the daemon's scene: {}; allowed: the same, or --accept KEY for each key or table",
            differ.join(", ")
        );
        Err(Failure::new(Exit::Refused, message))
    }

    /// Puts these files in the places of the daemon's, and waits until it has begun again,
    /// disarmed. What was there is kept beside, as `*.before`, where `keeps` says so.
    ///
    /// # Errors
    /// As [`Daemon::check`]. A file cannot be moved, `stop` was set, or the daemon does not take
    /// them: then its files are as before.
    pub fn take_up(
        &self,
        scene: &Path,
        memory: Option<&Path>,
        keeps: bool,
        accepted: &[String],
        stop: &AtomicBool,
    ) -> Result<(), Failure> {
        let text = fs::read_to_string(scene)?;
        self.check(text.clone(), accepted)?;
        let memory = memory.zip(self.memory.as_deref());
        let pairs = || [(scene, &*self.scene)].into_iter().chain(memory);
        for (new, old) in pairs() {
            let found = old.symlink_metadata().map_err(Failure::write(old))?;
            if found.is_symlink() {
                let message = format!("{}: a link; allowed: the file itself", old.display());
                return Err(Failure::new(Exit::Refused, message));
            }
            let undo = with_suffix(old, UNDO);
            fs::copy(old, &undo).map_err(Failure::write(&undo))?;
            if keeps {
                keep(old).map_err(Failure::write(old))?;
            }
            fs::set_permissions(new, found.permissions()).map_err(Failure::write(new))?;
        }
        let moved =
            pairs().try_for_each(|(new, old)| fs::rename(new, old).map_err(Failure::write(old)));
        let begun = moved.and_then(|()| self.begin_again(&text, stop));
        for (_, old) in pairs() {
            let undo = with_suffix(old, UNDO);
            let ended = match &begun {
                Ok(()) => fs::remove_file(&undo),
                Err(_) => fs::copy(&undo, old).and_then(|_| fs::remove_file(&undo)),
            };
            if let Err(error) = ended {
                eprintln!("vpcctl: {}: {error}", undo.display());
            }
        }
        begun
    }

    /// Whether it is the one at work.
    pub fn is_at_work(&self) -> bool {
        let process = self.process.as_raw_nonzero().get();
        Presence::of(&self.directory).process() == u32::try_from(process).ok()
    }

    fn begin_again(&self, scene: &str, stop: &AtomicBool) -> Result<(), Failure> {
        let process = self.process.as_raw_nonzero();
        let refused = |why: &str| {
            let message = format!("the daemon, process {process}, {why}; its files are as before");
            Failure::new(Exit::Refused, message)
        };
        if !self.is_at_work() {
            return Err(refused("has ended"));
        }
        let told = self.directory.join(ipc::SCENE_FILE);
        let written = |told: &Path| fs::metadata(told)?.modified();
        let before = written(&told).ok();
        kill_process(self.process, Signal::USR2).map_err(|error| refused(&error.to_string()))?;
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end && !stop.load(Ordering::Relaxed) {
            // While it begins there is none.
            let is_new = written(&told).is_ok_and(|at| Some(at) != before);
            let is_told = is_new && fs::read_to_string(&told).is_ok_and(|told| told == scene);
            if is_told && self.is_at_work() {
                return Ok(());
            }
            std::thread::sleep(PAUSE);
        }
        Err(refused("did not take the new files: its log says why"))
    }
}

/// The right to change the daemon's files, of one program at a time.
///
/// # Errors
/// Another has it.
pub fn turn(directory: &Path) -> Result<fs::File, Failure> {
    let path = directory.join("take-up.lock");
    let file = fs::File::create(&path).map_err(Failure::write(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(_) => {
            let message = "another vpcctl teaches a goal or visits some: wait for its end";
            Err(Failure::new(Exit::Refused, message))
        }
    }
}

/// Keeps what is in a file, as `*.before`, or `*.before.2` and so on where that is something else;
/// unless it stands in a file of the same folder already that nobody will move away.
fn keep(file: &Path) -> io::Result<()> {
    let content = fs::read(file)?;
    let is_kept = |other: PathBuf| {
        let extension = other.extension().and_then(|extension| extension.to_str());
        let is_lasting = extension.is_none_or(|extension| !PASSING.contains(&extension));
        let is_long = |found: fs::Metadata| found.is_file() && found.len() == content.len() as u64;
        is_lasting
            && other != file
            // No link, which may lead to the file itself.
            && fs::symlink_metadata(&other).is_ok_and(is_long)
            && fs::read(&other).is_ok_and(|there| there == content)
    };
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let others = fs::read_dir(folder).into_iter().flatten();
    let mut others = others.map_while(Result::ok);
    if others.any(|other| is_kept(folder.join(other.file_name()))) {
        return Ok(());
    }
    let first = with_suffix(file, BEFORE);
    let further = (2..).map(|number| with_suffix(&first, &format!(".{number}")));
    for kept in std::iter::once(first.clone()).chain(further) {
        match fs::File::create_new(&kept) {
            Ok(_) => {
                return fs::copy(file, &kept).map(|_| ()).or_else(|error| {
                    // No half of it, which somebody may take for all.
                    fs::remove_file(&kept)?;
                    Err(error)
                });
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => (),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The path with this after its last letter.
pub fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

/// Builds the memory of a scene; its progress goes to standard error.
///
/// # Errors
/// There is no builder, or it fails.
#[expect(
    clippy::disallowed_methods,
    reason = "it shares the terminal's Ctrl-C, and keeps what it has"
)]
pub fn build(scene: &Path, memory: &Path) -> Result<(), Failure> {
    let mut command = Command::new(program::sibling(BUILDER));
    let status = command
        .arg("build")
        .arg(scene)
        .arg("-o")
        .arg(memory)
        .status();
    let status = status.map_err(|error| {
        let message = format!("{BUILDER}: {error}; allowed: one beside vpcctl, or in PATH");
        Failure::new(Exit::NoInput, message)
    })?;
    if status.success() {
        return Ok(());
    }
    let message = format!("{BUILDER} build {}: {status}", scene.display());
    Err(Failure::new(Exit::Software, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_was_there_is_lost_and_nothing_is_kept_twice() {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name);
        let file = path("own.toml");
        for content in ["first", "second", "first", "shelf"] {
            fs::write(&file, content).unwrap();
            if content == "shelf" {
                fs::write(path("shelf.toml"), content).unwrap();
            }
            for passing in [UNDO, ".next"] {
                fs::write(with_suffix(&file, passing), content).unwrap();
            }
            let _ = std::os::unix::fs::symlink(&file, path("link.toml"));
            keep(&file).unwrap();
        }
        assert_eq!(fs::read(path("own.toml.before")).unwrap(), b"first");
        assert_eq!(fs::read(path("own.toml.before.2")).unwrap(), b"second");
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 7);
    }

    #[test]
    fn a_scene_with_other_limits_is_taken_up_by_name_alone() {
        let place = tempfile::tempdir().unwrap();
        let told = place.path().join(ipc::SCENE_FILE);
        fs::create_dir_all(told.parent().unwrap()).unwrap();
        fs::write(&told, scene::PAPER_SIM).unwrap();
        let daemon = Daemon {
            directory: place.path().to_owned(),
            process: rustix::process::getpid(),
            scene: place.path().join("own.toml"),
            memory: None,
        };
        let check = |text: &str, accepted: &[&str]| {
            let accepted: Vec<_> = accepted.iter().map(ToString::to_string).collect();
            let checked = daemon.check(text.to_owned(), &accepted);
            checked.map_err(|failure| failure.to_string())
        };
        let there = "[0.0, 0.0, 0.7]";
        let goal = scene::with_value(scene::PAPER_SIM, "goal", "translation", there).unwrap();
        assert_eq!(check(&goal, &[]), Ok(()));
        let faster = scene::with_value(&goal, "limits", "linear", "5.0").unwrap();
        let faster = scene::with_value(&faster, "success", "time_s", "20.0").unwrap();
        let refused = check(&faster, &["success"]).unwrap_err();
        assert!(
            refused.contains(": limits.linear: 0.5 -> 5.0; allowed: "),
            "{refused}"
        );
        assert_eq!(check(&faster, &["success.time_s", "limits"]), Ok(()));
    }
}
