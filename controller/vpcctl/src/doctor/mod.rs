//! `vpcctl doctor`: what is wrong with this machine or set-up, and how to fix it.

mod arm;
mod daemon;
mod logind;

use std::path::Path;

use memory_blob::MemoryFile;
use program::Exit;
use scene::{FileError, Scene};

use crate::arguments::DoctorArguments;
use crate::output::{Tone, paint};

/// The result of one check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was checked, in one or two words.
    pub what: &'static str,
    /// How it is.
    pub verdict: Tone,
    /// What was found.
    pub found: String,
    /// How to fix it; empty if nothing is wrong.
    pub remedy: String,
}

impl Finding {
    fn ok(what: &'static str, found: impl Into<String>) -> Self {
        Self {
            what,
            verdict: Tone::Good,
            found: found.into(),
            remedy: String::new(),
        }
    }

    fn warn(what: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: Tone::Warning,
            remedy: remedy.into(),
            ..Self::ok(what, found)
        }
    }

    fn fail(what: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: Tone::Bad,
            ..Self::warn(what, found, remedy)
        }
    }
}

/// Looks at everything. A domain that does not exist is not created.
pub fn examine(directory: &Path, arguments: &DoctorArguments) -> Vec<Finding> {
    let scene = arguments.scene.as_deref().map(Scene::read);
    let given = scene.as_ref().and_then(|scene| scene.as_ref().ok());
    let arm = given.and_then(|scene| scene.arm.as_ref());
    let mut findings = daemon::examine(directory, arguments.watch, arm);
    findings.extend(scene.as_ref().map(scene_file));
    let scene = scene.and_then(Result::ok);
    let memory = arguments.memory.as_deref();
    findings.extend(memory.map(|path| memory_of_motion(path, scene.as_ref())));
    findings.extend(logind::examine());
    findings
}

fn scene_file(scene: &Result<Scene, FileError>) -> Finding {
    match scene {
        Ok(scene) => {
            let (points, areas) = (scene.pattern.len(), scene.occlusions.len());
            let found = format!("{points} points, {areas} occlusions");
            if scene.has_marker_size {
                return Finding::ok("scene", found);
            }
            Finding::warn(
                "scene",
                format!("{found}; pattern.marker_size is not given"),
                "give it, 0 if the features are points: else only the markers' centres are kept in sight, and a tag is \
                 lost before its centre is covered",
            )
        }
        Err(error) => Finding::fail("scene", error.to_string(), "correct the line that it names"),
    }
}

/// Whether the memory is intact and, where a scene is given, built for it.
fn memory_of_motion(path: &Path, scene: Option<&Scene>) -> Finding {
    let task = scene.map(|scene| *scene.fingerprint().bytes());
    let name = path.display();
    match MemoryFile::open(path, task.as_ref()) {
        Ok(memory) => {
            let samples = memory.view().samples().len();
            Finding::ok("memory", format!("{name}: {samples} samples"))
        }
        Err(error) => {
            let remedy = format!("vpc-memory build SCENE -o {name}");
            Finding::fail("memory", error.to_string(), remedy)
        }
    }
}

/// The findings as text, one line each and one more for the remedy, and the exit code.
pub fn report(findings: &[Finding], colours: bool) -> (String, Exit) {
    let mut text = String::new();
    for finding in findings {
        let word = match finding.verdict {
            Tone::Good => "ok  ",
            Tone::Warning => "warn",
            Tone::Bad => "FAIL",
        };
        let word = paint(word, finding.verdict, colours);
        text += &format!("{word}  {:<12}{}\n", finding.what, finding.found);
        if !finding.remedy.is_empty() {
            text += &format!("                  -> {}\n", finding.remedy);
        }
    }
    let has_failed = findings.iter().any(|one| one.verdict == Tone::Bad);
    let exit = match has_failed {
        true => Exit::Attention,
        false => Exit::Ok,
    };
    (text, exit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_does_not_fail_and_a_failure_does() {
        let warning = Finding::warn("clock", "hpet", "use tsc");
        let (text, exit) = report(std::slice::from_ref(&warning), false);
        assert_eq!(
            text,
            "warn  clock       hpet\n                  -> use tsc\n"
        );
        assert_eq!(exit, Exit::Ok);
        let failure = Finding::fail("domain", "gone", "mkdir");
        assert_eq!(report(&[warning, failure], false).1, Exit::Attention);
    }

    fn paths() -> (std::path::PathBuf, std::path::PathBuf) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let memory = root.join("memory-blob/default/paper-sim.vpcmem");
        (root.join("ipc/scene/scenes/paper-sim.toml"), memory)
    }

    #[test]
    fn the_default_memory_fits_the_papers_scene_alone() {
        let (path, memory) = paths();
        let verdict = |path: &Path| {
            let scene = Scene::read(path).unwrap();
            memory_of_motion(&memory, Some(&scene)).verdict
        };
        assert_eq!(verdict(&path), Tone::Good);
        let other = path.with_file_name("paper-robot.toml");
        assert_eq!(verdict(&other), Tone::Bad);
    }

    #[test]
    fn a_memory_that_was_cut_off_is_seen() {
        let (_, memory) = paths();
        let directory = tempfile::tempdir().unwrap();
        let cut = directory.path().join("cut.vpcmem");
        let bytes = std::fs::read(&memory).unwrap();
        for part in [&bytes[..bytes.len() - 1], b"hello"] {
            std::fs::write(&cut, part).unwrap();
            let finding = memory_of_motion(&cut, None);
            assert_eq!(finding.verdict, Tone::Bad);
            assert!(
                finding.found.contains("not an intact memory"),
                "{finding:?}"
            );
        }
    }

    #[test]
    fn a_scene_without_marker_size_is_warned_of() {
        let verdict = |text: &str| scene_file(&Scene::parse(text, "scene.toml")).verdict;
        assert_eq!(verdict(scene::PAPER_SIM), Tone::Good);
        assert_eq!(verdict(scene::TAGS_ROBOT), Tone::Good);
        let unknown = scene::TAGS_ROBOT.replace("marker_size = 0.03", "");
        assert_eq!(verdict(&unknown), Tone::Warning);
    }

    #[test]
    fn a_scene_that_is_wrong_is_named_with_its_key() {
        let wrong = scene::PAPER_SIM.replace("rate_hz = ", "rate_hz = -");
        let finding = scene_file(&Scene::parse(&wrong, "scene.toml"));
        assert_eq!(finding.verdict, Tone::Bad);
        assert!(finding.found.contains("rate_hz"), "{finding:?}");
    }
}
