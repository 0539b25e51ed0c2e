//! A recording with views: all that is published, what was lost of it, and what Foxglove draws.

use std::collections::HashMap;
use std::path::Path;

use foxglove::messages::{Log, Timestamp, log::Level};
use foxglove::{Encode, Schema};
use ipc::{Order, Stamp};
use recording::{CONFIG_FILE, Encoding, RecordingFile, SCENE_FILE, WriteError};

use crate::context::Context;
use crate::ledger::{Ledger, Notice};
use crate::views::{self, Viewed};

/// Name of the metadata record with the counts, at the end of the file.
const LEDGER: &str = "vpc.ledger";
/// Least time between two drawings on one topic, ns: nobody sees more than 60 a second.
const APART_NS: u64 = 15_000_000;

/// Writes messages, their views and an account of what was lost.
pub struct Recorder {
    file: RecordingFile,
    ledger: Ledger,
    drawn_ns: HashMap<&'static str, u64>,
    /// State and hold of the last cycle.
    pub(crate) situation: Option<[u32; 2]>,
    logged: u64,
}

impl Recorder {
    /// Creates the file.
    ///
    /// # Errors
    /// [`WriteError`]; a file that exists is refused without `force`.
    pub fn create(path: &Path, force: bool) -> Result<Self, WriteError> {
        let mut file = RecordingFile::create(path, force)?;
        file.flush()?;
        Ok(Self {
            file,
            ledger: Ledger::default(),
            drawn_ns: HashMap::new(),
            situation: None,
            logged: 0,
        })
    }

    /// What was counted so far.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Attaches configuration, scene and masks, and draws the scene; once for a recording.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn describe(&mut self, context: &Context) -> Result<(), WriteError> {
        if let Some(config) = &context.config {
            self.file.attach(CONFIG_FILE, config.text.as_bytes())?;
            self.file.origin([(CONFIG_FILE, config.path.clone())])?;
        }
        for (name, png) in &context.masks {
            self.file.attach(name, png)?;
        }
        let Some((scene, file)) = &context.scene else {
            return self.file.flush();
        };
        self.file.attach(SCENE_FILE, file.text.as_bytes())?;
        self.file.origin([
            (SCENE_FILE, file.path.clone()),
            ("task", scene.fingerprint().to_string()),
        ])?;
        let wall_ns = self.file.clock().wall_ns;
        self.put("/camera/image", 1, wall_ns, &views::image(scene, wall_ns))?;
        let camera = views::calibration(scene, wall_ns);
        self.put("/camera/calibration", 1, wall_ns, &camera)?;
        self.put("/camera/scene", 1, wall_ns, &views::scenery(scene, wall_ns))?;
        self.file.flush()
    }

    /// Writes a message with its views; one that is the one before again is passed over.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn take<T: Viewed>(
        &mut self,
        message: &T,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        // Late subscribers are handed the last message again.
        if order == Order::Repeated {
            return Ok(None);
        }
        let notice = self.ledger.record(T::TOPIC, order);
        if let Some(notice) = &notice {
            let published_ns = message.stamp().published_ns;
            self.log(Level::Warning, "recorder", notice.to_string(), published_ns)?;
        }
        self.file.write(message)?;
        message.view(self)?;
        Ok(notice)
    }

    /// Counts a message that broke the contract.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn refuse(&mut self, topic: &'static str, reason: String) -> Result<Notice, WriteError> {
        let notice = self.ledger.refuse(topic, reason);
        self.log(Level::Error, "recorder", notice.to_string(), ipc::now_ns())?;
        Ok(notice)
    }

    /// Hands everything so far to the operating system.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.file.flush()
    }

    /// Ends the recording with its counts and its index, on the disk.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(mut self) -> Result<Ledger, WriteError> {
        self.file.metadata(LEDGER, self.ledger.to_map())?;
        self.file.finish()?;
        Ok(self.ledger)
    }

    /// Writes an entry of the log.
    pub(crate) fn log(
        &mut self,
        level: Level,
        name: &str,
        text: String,
        monotonic_ns: u64,
    ) -> Result<(), WriteError> {
        self.logged += 1;
        let wall_ns = self.file.clock().wall_of(monotonic_ns);
        let entry = Log {
            timestamp: views::time(wall_ns),
            level: level.into(),
            message: text,
            name: name.to_owned(),
            ..Log::default()
        };
        self.put("/log", self.logged, wall_ns, &entry)
    }

    /// Returns whether a drawing on this topic may be made now, which then counts as its time.
    pub(crate) fn is_due(&mut self, topic: &'static str, published_ns: u64) -> bool {
        let last = self.drawn_ns.get(topic);
        let due = last.is_none_or(|last| published_ns.abs_diff(*last) >= APART_NS);
        if due {
            self.drawn_ns.insert(topic, published_ns);
        }
        due
    }

    /// Writes the view of a message, at its time.
    pub(crate) fn draw<M: Encode>(
        &mut self,
        topic: &'static str,
        stamp: &Stamp,
        view: impl FnOnce(Option<Timestamp>) -> M,
    ) -> Result<(), WriteError> {
        let wall_ns = self.file.clock().wall_of(stamp.published_ns);
        self.put(topic, stamp.sequence, wall_ns, &view(views::time(wall_ns)))
    }

    fn put<M: Encode>(
        &mut self,
        topic: &'static str,
        sequence: u64,
        wall_ns: u64,
        message: &M,
    ) -> Result<(), WriteError> {
        let encoding = || {
            let Schema {
                name,
                encoding,
                data,
            } = M::get_schema().unwrap_or_else(|| Schema::new("", "", &[][..]));
            Encoding {
                schema: (name, encoding, data.into_owned()),
                message: M::get_message_encoding(),
            }
        };
        let mut data = Vec::new();
        // Fails only where the buffer is full, and a vector grows.
        let _ = message.encode(&mut data);
        self.file.put(topic, encoding, sequence, wall_ns, &data)
    }
}
