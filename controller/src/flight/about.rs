//! Who recorded what: the head of a flight record's file.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use vpc::{Settings, SolverOptions, Strategy};

use super::record::{FlightRecord, Key};
use super::words::Field;
use crate::config::Config;
use crate::law::Law;

/// All that a replay needs beside keys and records, and what a reader of the file wants to know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct About {
    /// The program.
    pub build: Build,
    /// When the file was written, ms since 1970 (UTC, the wall clock's word).
    pub written_unix_ms: u64,
    /// Why: `request`, `exit`, or `fault: ` and the cause of the hold.
    pub cause: String,
    /// The scene.
    pub scene: SceneAbout,
    /// The memory of motion; none where there was none.
    pub memory: Option<MemoryAbout>,
    /// The settings of the law.
    pub settings: SettingsAbout,
    /// The clock: fixed, phase or lockstep.
    pub clock: String,
    /// Keys in the file.
    pub keys: usize,
    /// Records in the file.
    pub records: usize,
    /// Fields of a key.
    pub key_fields: Vec<Field>,
    /// Fields of a record.
    pub record_fields: Vec<Field>,
}

/// The program that recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Build {
    /// Version of the package.
    pub version: String,
    /// SHA-256 of the executable, 64 hexadecimal digits; empty where it could not be read.
    pub executable: String,
}

impl Build {
    /// The running program. Reads all of its file: for an ordinary thread.
    pub fn running() -> Self {
        // Also after an upgrade this is the file that runs.
        let executable = std::fs::read("/proc/self/exe");
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            executable: executable.map_or(String::new(), |bytes| hex(&Sha256::digest(bytes))),
        }
    }
}

/// The scene, whole.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneAbout {
    /// Its file.
    pub path: String,
    /// Its fingerprint, 64 hexadecimal digits.
    pub fingerprint: String,
    /// The file's text.
    pub text: String,
}

/// Which memory of motion.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MemoryAbout {
    /// Its file.
    pub path: String,
    /// SHA-256 of the file, 64 hexadecimal digits.
    pub sha256: String,
}

/// The settings of the law, by their names in the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsAbout {
    strategy: String,
    np: usize,
    nc: usize,
    iterations: u32,
    tolerance: f64,
    #[serde(with = "crate::config::ModelWord")]
    model: vpc::Model,
    trigger_px: f64,
    release: f64,
    margin_px: f64,
    lambda: f64,
    detour: bool,
    delay_compensation: bool,
}

impl From<&Settings> for SettingsAbout {
    fn from(settings: &Settings) -> Self {
        // Whole: a setting that is not recorded could not be replayed.
        let Settings {
            strategy,
            np,
            nc,
            solver,
            model,
            trigger_px,
            hysteresis: release,
            margin_px,
            lambda,
            detour,
            delay_compensation,
        } = *settings;
        Self {
            strategy: strategy.to_string(),
            np,
            nc,
            iterations: solver.max_iterations,
            tolerance: solver.tolerance,
            model,
            trigger_px,
            release,
            margin_px,
            lambda,
            detour,
            delay_compensation,
        }
    }
}

impl SettingsAbout {
    /// The settings.
    ///
    /// # Errors
    /// Name, value, and what is allowed.
    pub fn settings(&self) -> Result<Settings, String> {
        let strategy: Strategy = self
            .strategy
            .parse()
            .map_err(|allowed| format!("strategy = {}; {allowed}", self.strategy))?;
        let settings = Settings {
            strategy,
            np: self.np,
            nc: self.nc,
            solver: SolverOptions {
                max_iterations: self.iterations,
                tolerance: self.tolerance,
            },
            model: self.model,
            trigger_px: self.trigger_px,
            hysteresis: self.release,
            margin_px: self.margin_px,
            lambda: self.lambda,
            detour: self.detour,
            delay_compensation: self.delay_compensation,
        };
        settings.check().map_err(|error| error.to_string())?;
        Ok(settings)
    }
}

impl About {
    /// About what this law does under this configuration; counts, cause and time are still open.
    pub fn new(config: &Config, law: &Law) -> Self {
        let memory = law.memory().zip(config.memory.as_ref());
        Self {
            build: Build {
                version: String::new(),
                executable: String::new(),
            },
            written_unix_ms: 0,
            cause: String::new(),
            scene: SceneAbout {
                path: absolute(&config.scene),
                fingerprint: law.scene().fingerprint().to_string(),
                text: law.text().to_owned(),
            },
            memory: memory.map(|(memory, path)| MemoryAbout {
                path: absolute(path),
                sha256: hex(memory.digest()),
            }),
            settings: law.settings().into(),
            clock: config.clock.to_string(),
            keys: 0,
            records: 0,
            key_fields: Key::layout().fields().to_vec(),
            record_fields: FlightRecord::layout().fields().to_vec(),
        }
    }
}

fn absolute(path: &PathBuf) -> String {
    let absolute = std::path::absolute(path);
    absolute.as_ref().unwrap_or(path).display().to_string()
}

/// Lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
