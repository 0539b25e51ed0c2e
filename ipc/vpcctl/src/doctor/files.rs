//! Scene and memory. The memory's head is read here; `vpc-memory verify` checks all of it.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use scene::Scene;

use super::Finding;

/// Longest header that the format allows, bytes.
const HEADER: u64 = 64 * 1024;

pub(super) fn examine(scene: Option<&Path>, memory: Option<&Path>) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut task = None;
    if let Some(path) = scene {
        findings.push(match Scene::read(path) {
            Ok(scene) => {
                task = Some(scene.fingerprint().to_string());
                let (points, areas) = (scene.pattern.len(), scene.occlusions.len());
                let words = format!("{}: {points} points, {areas} occlusions", path.display());
                Finding::ok("scene", words)
            }
            Err(error) => Finding::fail("scene", error.to_string(), "mend the line that is named"),
        });
    }
    findings.extend(memory.map(|path| judge(path, task.as_deref())));
    findings
}

fn judge(path: &Path, task: Option<&str>) -> Finding {
    let what = "memory";
    let name = path.display();
    let build = format!("vpc-memory build SCENE -o {name}");
    let found = match head(path) {
        Ok(found) => found,
        Err(reason) => return Finding::fail(what, format!("{name}: {reason}"), build),
    };
    match task {
        Some(task) if task != found.task => {
            let words = format!("{name}: built for another scene");
            Finding::fail(what, words, build)
        }
        _ => {
            let words = format!(
                "{name}: {} samples; `vpc-memory verify` checks all",
                found.samples
            );
            Finding::ok(what, words)
        }
    }
}

/// What the head says.
#[derive(Debug, PartialEq, Eq)]
struct Head {
    task: String,
    samples: String,
}

/// Reads the head and compares the length of the file with what it promises (FORMAT.md).
fn head(path: &Path) -> Result<Head, String> {
    let mut file = File::open(path).map_err(|error| error.to_string())?;
    let length = file.metadata().map_err(|error| error.to_string())?.len();
    let mut prefix = [0; 8];
    file.read_exact(&mut prefix)
        .map_err(|_| "too short for a memory".to_owned())?;
    let header = u64::from_le_bytes(prefix);
    if header > HEADER {
        return Err(format!("header of {header} bytes; allowed: {HEADER}"));
    }
    let mut text = Vec::new();
    file.take(header)
        .read_to_end(&mut text)
        .map_err(|error| error.to_string())?;
    let json: serde_json::Value =
        serde_json::from_slice(&text).map_err(|error| format!("no safetensors header: {error}"))?;
    let tensors = json.as_object().ok_or("no safetensors header")?;
    let metadata = tensors.get("__metadata__");
    let word = |key: &str| {
        metadata
            .and_then(|all| all.get(key))
            .and_then(|value| value.as_str())
    };
    if word("format") != Some("vpc-memory") {
        return Err("not a memory of motion (metadata `format`)".to_owned());
    }
    let ends = tensors
        .values()
        .filter_map(|tensor| tensor.get("data_offsets")?.get(1)?.as_u64());
    let promised = 8 + header + ends.max().unwrap_or(0);
    if promised != length {
        return Err(format!(
            "{length} bytes, where its header says {promised}: cut off?"
        ));
    }
    Ok(Head {
        task: word("task").unwrap_or_default().to_owned(),
        samples: word("samples").unwrap_or("?").to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::Verdict;
    use super::*;

    fn paths() -> (std::path::PathBuf, std::path::PathBuf) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let memory = root.join("memory-blob/default/paper-sim.vpcmem");
        (root.join("ipc/scene/scenes/paper-sim.toml"), memory)
    }

    #[test]
    fn the_default_memory_was_built_for_the_papers_scene_and_no_other() {
        let (scene, memory) = paths();
        let verdicts = |scene: &Path| -> Vec<Verdict> {
            let findings = examine(Some(scene), Some(&memory));
            findings.iter().map(|finding| finding.verdict).collect()
        };
        assert_eq!(verdicts(&scene), [Verdict::Ok, Verdict::Ok]);
        let other = scene.with_file_name("paper-robot.toml");
        assert_eq!(verdicts(&other), [Verdict::Ok, Verdict::Fail]);
    }

    #[test]
    fn a_memory_that_was_cut_off_is_seen() {
        let (_, memory) = paths();
        let directory = tempfile::tempdir().unwrap();
        let cut = directory.path().join("cut.vpcmem");
        let bytes = std::fs::read(&memory).unwrap();
        std::fs::write(&cut, &bytes[..bytes.len() - 1]).unwrap();
        let reason = head(&cut).unwrap_err();
        assert!(reason.contains("cut off"), "{reason}");
        std::fs::write(&cut, b"hello").unwrap();
        assert_eq!(head(&cut).unwrap_err(), "too short for a memory");
    }

    #[test]
    fn a_scene_that_is_wrong_is_named_with_its_key() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("scene.toml");
        std::fs::write(&path, scene::PAPER_SIM.replace("rate_hz = ", "rate_hz = -")).unwrap();
        let findings = examine(Some(&path), None);
        assert_eq!(findings[0].verdict, Verdict::Fail);
        assert!(findings[0].found.contains("rate_hz"), "{findings:?}");
    }
}
