//! A recording of runs: one JSON line a frame.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use panda::JOINTS;
use scene::Scene;
use serde::{Deserialize, Serialize};

use crate::referee::Referee;
use crate::robot::sequence::TaskStep;

/// The first line of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Version of the emulator.
    pub hw_sim: String,
    /// Scene file.
    pub scene: String,
    /// Fingerprint of the task.
    pub task: String,
    /// Features at the goal, px.
    pub goal: Vec<[f64; 2]>,
}

/// A frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Seconds since the start.
    pub time_s: f64,
    /// Object in the camera frame: translation, m.
    pub translation: [f64; 3],
    /// Object in the camera frame: rotation vector, rad.
    pub rotation: [f64; 3],
    /// Velocity of the object against the world (m/s, rad/s; camera frame, at the camera's origin);
    /// none where it always rests.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object_twist: Option<[f64; 6]>,
    /// True features, px.
    pub features: Vec<[f64; 2]>,
    /// Delivered features, px; none where the frame was lost or is under way.
    pub measured: Option<Vec<[f64; 2]>>,
    /// Twist that moves the camera at this frame (m/s, rad/s; camera frame).
    pub twist: [f64; 6],
    /// Sequence number of the features that the twist answered; 0 where none.
    pub answered: u64,
    /// Whether the camera was held because no valid command was there.
    pub stale: bool,
    /// The arm that carries the camera, where one does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm: Option<ArmRecord>,
}

/// What an arm adds to a recorded frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmRecord {
    /// Measured joint positions, rad.
    pub q: [f64; JOINTS],
    /// Measured joint velocities, rad/s.
    pub dq: [f64; JOINTS],
    /// The step of the task.
    pub phase: TaskStep,
    /// The robot's mode.
    pub mode: String,
    /// Bits of the markers that the last delivered frame showed.
    pub visible: u32,
}

/// A file of records.
#[derive(Debug)]
pub struct Recorder {
    file: BufWriter<File>,
}

impl Recorder {
    /// Begins a recording of a scene that was read from `scene_file`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path, scene: &Scene, scene_file: &str) -> io::Result<Self> {
        let mut recorder = Self {
            file: BufWriter::new(File::create(path)?),
        };
        recorder.line(&Head {
            hw_sim: env!("CARGO_PKG_VERSION").to_owned(),
            scene: scene_file.to_owned(),
            task: scene.fingerprint().to_string(),
            goal: Referee::new(scene).goal().to_vec(),
        })?;
        Ok(recorder)
    }

    /// Adds a record.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&mut self, record: &Record) -> io::Result<()> {
        self.line(record)
    }

    /// Writes everything out.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.file.flush()
    }

    fn line(&mut self, value: &impl Serialize) -> io::Result<()> {
        serde_json::to_writer(&mut self.file, value)?;
        self.file.write_all(b"\n")
    }
}

/// Reads a recording back.
///
/// # Errors
/// The file cannot be read, or a line is not a record.
pub fn read(path: &Path) -> io::Result<(Head, Vec<Record>)> {
    let text = io::read_to_string(toml_schema::open_file(path)?)?;
    let mut lines = text.lines();
    let head = serde_json::from_str(lines.next().unwrap_or(""))?;
    let records = lines
        .map(|line| Ok(serde_json::from_str(line)?))
        .collect::<io::Result<_>>()?;
    Ok((head, records))
}
