//! What a daemon left of its configuration in its domain: the whole of it, defaults and all.

use std::path::{Path, PathBuf};

use serde::Deserialize;

/// The keys that views and requests need; empty where there is no daemon, or none that is read.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// The scene.
    pub scene: Option<PathBuf>,
    /// The memory of motion.
    pub memory: Option<PathBuf>,
    /// `[flight]`.
    pub flight: Flight,
    /// `[safety]`.
    pub safety: Safety,
}

/// Where flight records go.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Flight {
    /// The directory.
    pub directory: Option<PathBuf>,
}

/// What the supervisor asks for.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Safety {
    /// Whether a robot must tell its state: `required` or `optional`.
    pub robot: Option<String>,
}

impl Settings {
    /// Those of the daemon of this domain.
    pub fn of(directory: &Path) -> Self {
        let text = std::fs::read_to_string(directory.join(ipc::CONFIG_FILE)).unwrap_or_default();
        // Of another version's file nothing is known.
        toml::from_str(&text).unwrap_or_default()
    }

    /// Whether the daemon moves without a robot that tells its state.
    pub fn does_without_robot(&self) -> bool {
        self.safety.robot.as_deref() == Some("optional")
    }
}
