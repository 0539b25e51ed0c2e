//! Whether `vpcd` and the gateway have the same scene.

use std::fmt::Debug;
use std::path::{Path, PathBuf};

use scene::{Scene, SceneFiles};

/// vpcd's scene is another one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{path}: vpcd's scene has {table} {found}; ours (key scene) has {ours}: give both the same file", path = path.display())]
pub struct OtherScene {
    path: PathBuf,
    table: &'static str,
    found: String,
    ours: String,
}

/// Compares with the scene that vpcd leaves in its domain.
pub struct Agreement {
    ours: Scene,
    path: PathBuf,
    /// What was compared last.
    text: String,
}

impl Agreement {
    /// Of our scene with that of the domain.
    pub fn new(ours: Scene, domain: &Path) -> Self {
        Self {
            ours,
            path: domain.join(ipc::SCENE_FILE),
            text: String::new(),
        }
    }

    /// Compares what matters here: camera, pattern, goal, limits. A file that is not there, or not
    /// whole, is that of a vpcd that begins or ends.
    ///
    /// # Errors
    /// [`OtherScene`].
    pub fn check(&mut self) -> Result<(), OtherScene> {
        // Once a second: a scene that is known is not parsed again.
        if std::fs::read_to_string(&self.path).is_ok_and(|text| text == self.text) {
            return Ok(());
        }
        let Ok(files) = SceneFiles::read(&self.path) else {
            return Ok(());
        };
        self.text = files.text;
        let (its, ours) = (&files.scene, &self.ours);
        self.same("camera", &its.camera, &ours.camera)?;
        self.same("pattern", &its.pattern, &ours.pattern)?;
        self.same("goal", &its.goal, &ours.goal)?;
        self.same("limits", &its.limits, &ours.limits)
    }

    fn same<T: Debug + PartialEq>(
        &self,
        table: &'static str,
        its: &T,
        ours: &T,
    ) -> Result<(), OtherScene> {
        match its == ours {
            true => Ok(()),
            false => Err(OtherScene {
                path: self.path.clone(),
                table,
                found: format!("{its:?}"),
                ours: format!("{ours:?}"),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_scene_of_vpcd_is_named_and_the_same_one_is_not() {
        let domain = tempfile::tempdir().unwrap();
        let file = domain.path().join(ipc::SCENE_FILE);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        let ours = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
        let mut agreement = Agreement::new(ours, domain.path());
        assert_eq!(agreement.check(), Ok(()));
        std::fs::write(&file, scene::PAPER_SIM).unwrap();
        assert_eq!(agreement.check(), Ok(()));
        std::fs::write(&file, scene::PAPER_SIM.replace("800.0", "600.0")).unwrap();
        let other = agreement.check().unwrap_err().to_string();
        assert!(other.contains("vpcd's scene has camera "), "{other}");
        assert!(
            other.contains("600.0") && other.contains("800.0"),
            "{other}"
        );
        // What counts as success is no matter of the gateway.
        let tuned = scene::PAPER_SIM.replace("convergence_px = 2.0", "convergence_px = 3.0");
        assert_ne!(tuned, scene::PAPER_SIM);
        std::fs::write(&file, tuned).unwrap();
        assert_eq!(agreement.check(), Ok(()));
    }
}
