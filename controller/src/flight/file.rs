//! The file of a flight record: a recording (MCAP) with the same topics and schemas as `vpcctl
//! record` writes.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use memory_blob::hex;
use recording::{CONFIG_FILE, RecordingFile, SCENE_FILE, Sink, WriteError};
use scene::SceneFiles;
use sha2::{Digest, Sha256};

use super::ring::Ring;
use crate::loaded::Loaded;

/// Entries about the origin of a flight record, beside those of every recording.
pub mod origin {
    /// Why it was written: `request`, `exit`, or `fault: ` and the reason of the hold.
    pub const CAUSE: &str = "cause";
    /// SHA-256 of the executable, 64 hexadecimal digits; empty if it could not be read.
    pub const EXECUTABLE: &str = "executable";
    /// SHA-256 of the memory of motion, 64 hexadecimal digits.
    pub const MEMORY_SHA256: &str = "memory_sha256";
}

/// What a flight record says about the daemon: all that a replay needs beside the messages.
#[derive(Clone, Debug)]
pub struct About {
    /// The whole configuration, flags and defaults included, with absolute paths.
    config: String,
    scene: SceneFiles,
    memory_sha256: Option<String>,
}

impl About {
    /// About what was loaded by this configuration; `text` is the whole of it.
    pub fn new(text: String, loaded: &Loaded) -> Self {
        Self {
            config: text,
            scene: loaded.files.clone(),
            memory_sha256: (loaded.memory.as_ref()).map(|memory| hex(memory.digest())),
        }
    }
}

/// Writes a flight record over the file at `path`, through to the disk; counts the cycles that are
/// written in `progress`.
///
/// # Errors
/// [`WriteError`].
pub fn write(
    path: &Path,
    about: &About,
    cause: &str,
    ring: &Ring,
    progress: &AtomicU64,
) -> Result<(), WriteError> {
    let mut file = RecordingFile::create(path, true)?;
    file.origin([
        (origin::CAUSE, cause.to_owned()),
        (origin::EXECUTABLE, executable()),
    ])?;
    if let Some(sha256) = &about.memory_sha256 {
        file.origin([(origin::MEMORY_SHA256, sha256.clone())])?;
    }
    file.attach(CONFIG_FILE, about.config.as_bytes())?;
    for (name, bytes) in &about.scene.beside {
        file.attach(name, bytes)?;
    }
    file.attach(SCENE_FILE, about.scene.text.as_bytes())?;
    messages(&mut file, ring, progress)?;
    file.finish()
}

/// Everything in the order in which it happened, from the oldest snapshot on; a message that
/// several cycles received once.
fn messages(file: &mut RecordingFile, ring: &Ring, progress: &AtomicU64) -> Result<(), WriteError> {
    let first = ring.snapshots().next().map_or(0, |snapshot| snapshot.cycle);
    let mut snapshots = ring.snapshots().peekable();
    let mut replies = ring.replies().peekable();
    let (mut features, mut robot, mut desired) = (None, None, None);
    for cycle in ring.cycles().filter(|cycle| cycle.record.cycle >= first) {
        let number = cycle.record.cycle;
        while let Some(snapshot) = snapshots.next_if(|snapshot| snapshot.cycle <= number) {
            file.write(snapshot)?;
        }
        while let Some(reply) = replies.next_if(|reply| reply.cycle <= number) {
            file.write(reply)?;
        }
        if let Some(message) = cycle.features.as_ref()
            && features.replace(message.stamp) != Some(message.stamp)
        {
            file.write(message)?;
        }
        if let Some(message) = cycle.robot.as_ref()
            && robot.replace(message.stamp) != Some(message.stamp)
        {
            file.write(message)?;
        }
        if let Some(message) = cycle.desired.as_ref()
            && desired.replace(message.stamp) != Some(message.stamp)
        {
            file.write(message)?;
        }
        file.write(&cycle.record)?;
        progress.fetch_add(1, Ordering::Relaxed);
    }
    Ok(())
}

/// SHA-256 of the running program, empty if it cannot be read. Reads all of its file, in parts: it
/// may be larger than everything else that the daemon holds.
pub fn executable() -> String {
    // Also after an upgrade this is the file that runs.
    let read = || {
        let (mut sha, mut part) = (Sha256::new(), [0; 16 << 10]);
        let mut program = File::open("/proc/self/exe")?;
        loop {
            match program.read(&mut part) {
                Ok(0) => return std::io::Result::Ok(hex(&sha.finalize())),
                Ok(count) => sha.update(&part[..count]),
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) => return Err(error),
            }
        }
    };
    read().unwrap_or_default()
}
