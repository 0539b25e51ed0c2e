//! Writing a recording.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::Path;

use ipc::{
    CycleRecord, Features, Hold, Order, Reply, Request, RobotState, TwistCommand, TwistState,
};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, WriteOptions, Writer};
use serde_json::{Value, json};

use crate::clock::WallClock;
use crate::context::Context;
use crate::foxglove::{self, Annotations, BLUE, Known, Level, RED};
use crate::ledger::{Ledger, Notice, is_new};
use crate::message::Recorded;

/// Topic of the scene.
pub const SCENE: &str = "/vpc/scene";
/// Name of the scene's attachment.
pub const SCENE_FILE: &str = "scene.toml";
/// Name of the configuration's attachment.
pub const CONFIG_FILE: &str = "vpcd.toml";
/// Kind of the attached scene and configuration.
const TOML: &str = "application/toml";
/// Kind of the attached masks, which have the names that the scene gives them.
pub(crate) const PNG: &str = "image/png";
/// Name of the metadata record at the head of the file.
pub(crate) const ORIGIN: &str = "vpc.origin";
/// Name of the metadata record at its end.
pub(crate) const LEDGER: &str = "vpc.ledger";
/// Least time between two pictures of one topic, ns: nobody sees more than 60 a second.
const PICTURE_NS: u64 = 15_000_000;

/// Why a recording was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file exists.
    #[error("{path}: exists; allowed: a new file, or --force")]
    Exists {
        /// The file.
        path: String,
    },
    /// The file cannot be made.
    #[error("{path}: cannot create the recording: {source}")]
    Create {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Something cannot be written to it.
    #[error("{path}: cannot write the recording: {source}")]
    Write {
        /// The file.
        path: String,
        /// The reason.
        source: mcap::McapError,
    },
}

/// The topics that are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum View {
    Features,
    WayPoint,
    Pose,
}

/// What a cycle is about, as far as the log tells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Situation {
    state: u32,
    hold: u32,
}

/// A recording that is being written. It is readable up to the last [`RecordingFile::flush`] whatever happens, and
/// indexed after [`RecordingFile::finish`].
pub struct RecordingFile {
    path: String,
    mcap: Writer<NoSeek<BufWriter<File>>>,
    channels: BTreeMap<&'static str, u16>,
    clock: WallClock,
    ledger: Ledger,
    pictured_ns: BTreeMap<View, u64>,
    situation: Option<Situation>,
    logged: u32,
}

impl RecordingFile {
    /// Begins a recording: schemas and channels of all topics, the scene as a message, as pictures and as a file.
    ///
    /// # Errors
    /// [`WriteError`]; a file that exists is refused without `force`.
    pub fn create(path: &Path, force: bool, context: &Context) -> Result<Self, WriteError> {
        let name = path.display().to_string();
        let mut how = OpenOptions::new();
        how.write(true);
        if force {
            how.create(true).truncate(true);
        } else {
            how.create_new(true);
        }
        let file = how.open(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::AlreadyExists => WriteError::Exists { path: name.clone() },
            _ => WriteError::Create {
                path: name.clone(),
                source,
            },
        })?;
        let clock = WallClock::now();
        // A chunk is written as a whole when it is full or flushed: who is killed leaves whole chunks.
        let options = WriteOptions::new()
            .disable_seeking(true)
            .library(concat!("vpcd recording ", env!("CARGO_PKG_VERSION")))
            .compression_threads(0);
        let mcap = options.create(NoSeek::new(BufWriter::new(file)));
        let mcap = mcap.map_err(|source| WriteError::Write {
            path: name.clone(),
            source,
        })?;
        let mut recording = Self {
            path: name,
            mcap,
            channels: BTreeMap::new(),
            clock,
            ledger: Ledger::default(),
            pictured_ns: BTreeMap::new(),
            situation: None,
            logged: 0,
        };
        recording.head(context)?;
        recording.flush()?;
        Ok(recording)
    }

    /// How its stamps were translated.
    pub fn clock(&self) -> WallClock {
        self.clock
    }

    /// What was counted so far.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Adds features. Here as below, a message that is the one before again is passed over.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn features(
        &mut self,
        message: &Features,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        if !is_new(order) {
            return Ok(None);
        }
        let notice = self.message(message, order)?;
        if self.is_due(View::Features, message.stamp.published_ns) {
            let wall_ns = self.clock.wall_of(message.stamp.published_ns);
            let mut drawing = Annotations::at(wall_ns);
            for (i, at) in message.pairs().enumerate() {
                let visible = message.visible & (1 << i) != 0;
                let fill = if visible { BLUE } else { [0.0; 4] };
                drawing.circle(at, 10.0, BLUE, fill);
            }
            drawing.outline(message.pairs(), BLUE);
            self.view("/camera/features", &message.stamp, &drawing.finish())?;
        }
        Ok(notice)
    }

    /// Adds a command.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn twist(
        &mut self,
        message: &TwistCommand,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        if !is_new(order) {
            return Ok(None);
        }
        self.message(message, order)
    }

    /// Adds a state of the robot.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn robot(
        &mut self,
        message: &RobotState,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        if !is_new(order) {
            return Ok(None);
        }
        let notice = self.message(message, order)?;
        if self.is_due(View::Pose, message.stamp.published_ns) {
            let wall_ns = self.clock.wall_of(message.stamp.published_ns);
            let (transform, pose) =
                foxglove::camera_pose(message.translation, message.rotation, wall_ns);
            self.view("/tf", &message.stamp, &transform)?;
            self.view("/camera/pose", &message.stamp, &pose)?;
        }
        Ok(notice)
    }

    /// Adds a record of a cycle; changes of its state or cause go to the log as well.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn cycle(
        &mut self,
        message: &CycleRecord,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        if !is_new(order) {
            return Ok(None);
        }
        let notice = self.message(message, order)?;
        if self.is_due(View::WayPoint, message.stamp.published_ns) {
            let wall_ns = self.clock.wall_of(message.stamp.published_ns);
            let mut drawing = Annotations::at(wall_ns);
            let count = (message.way_point_count as usize).min(ipc::MAX_POINTS);
            let pairs = message.way_point.chunks_exact(2).take(count);
            let pairs: Vec<_> = pairs.map(|p| [p[0], p[1]]).collect();
            drawing.crosses(&pairs, 7.0, RED);
            drawing.text([8.0, 24.0], &caption(message));
            self.view("/camera/way_point", &message.stamp, &drawing.finish())?;
        }
        let situation = Situation {
            state: message.state,
            hold: message.hold,
        };
        if self.situation.replace(situation) != Some(situation) {
            let level = match TwistState::from_code(message.state) {
                Some(TwistState::Holding | TwistState::Braking) => Level::Warning,
                _ => Level::Info,
            };
            let text = format!("cycle {}: {}", message.cycle, caption(message));
            self.log(level, "vpcd", &text, message.stamp.published_ns)?;
        }
        Ok(notice)
    }

    /// Adds an operator's request.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn request(
        &mut self,
        message: &Request,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        if !is_new(order) {
            return Ok(None);
        }
        let notice = self.message(message, order)?;
        let action = message
            .action()
            .map_or_else(|| "?".to_owned(), |a| a.to_string());
        let text = format!("request {:016x}: {action}", message.id);
        self.log(Level::Info, "operator", &text, message.stamp.published_ns)?;
        Ok(notice)
    }

    /// Adds an answer to a request.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn reply(&mut self, message: &Reply, order: Order) -> Result<Option<Notice>, WriteError> {
        if !is_new(order) {
            return Ok(None);
        }
        let notice = self.message(message, order)?;
        let outcome = message
            .outcome()
            .map_or_else(|| "?".to_owned(), |o| o.to_string());
        let text = format!("reply to {:016x}: {outcome}", message.id);
        let level = if message.outcome == 0 {
            Level::Info
        } else {
            Level::Warning
        };
        self.log(level, "vpcd", &text, message.stamp.published_ns)?;
        Ok(notice)
    }

    /// Counts a message that broke the contract.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn refused(&mut self, topic: &'static str, reason: String) -> Result<Notice, WriteError> {
        let notice = self.ledger.refuse(topic, reason);
        self.log(Level::Error, "recorder", &notice.to_string(), ipc::now_ns())?;
        Ok(notice)
    }

    /// Hands everything so far to the operating system: from here on it survives the end of this process.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        let path = &self.path;
        self.mcap.flush().map_err(|source| WriteError::Write {
            path: path.clone(),
            source,
        })
    }

    /// Ends the recording with its counts and its index, on the disk.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(mut self) -> Result<Ledger, WriteError> {
        let path = std::mem::take(&mut self.path);
        let failed = |source| WriteError::Write {
            path: path.clone(),
            source,
        };
        let counts = Metadata {
            name: LEDGER.to_owned(),
            metadata: self.ledger.to_map(),
        };
        self.mcap.write_metadata(&counts).map_err(failed)?;
        self.mcap.finish().map_err(failed)?;
        let file = self.mcap.into_inner().into_inner();
        let file = file
            .into_inner()
            .map_err(|error| failed(error.into_error().into()))?;
        file.sync_all().map_err(|source| failed(source.into()))?;
        Ok(self.ledger)
    }

    /// Everything that stands before the first message.
    fn head(&mut self, context: &Context) -> Result<(), WriteError> {
        let origin = Metadata {
            name: ORIGIN.to_owned(),
            metadata: [
                Some(("version", env!("CARGO_PKG_VERSION").to_owned())),
                Some(("monotonic_ns", self.clock.monotonic_ns.to_string())),
                Some(("wall_ns", self.clock.wall_ns.to_string())),
                context
                    .scene
                    .as_ref()
                    .map(|(_, file)| ("scene", file.path.clone())),
                context
                    .config
                    .as_ref()
                    .map(|file| ("config", file.path.clone())),
            ]
            .into_iter()
            .flatten()
            .map(|(key, value)| (key.to_owned(), value))
            .collect(),
        };
        self.written(|mcap| mcap.write_metadata(&origin))?;
        self.channel::<Features>()?;
        self.channel::<TwistCommand>()?;
        self.channel::<RobotState>()?;
        self.channel::<CycleRecord>()?;
        self.channel::<Request>()?;
        self.channel::<Reply>()?;
        for (topic, known) in VIEWS {
            self.open(topic, known.name(), &known.schema())?;
        }
        self.open(SCENE, "vpc.Scene", &scene_schema())?;
        if let Some(config) = &context.config {
            self.attach(CONFIG_FILE, TOML, config.text.as_bytes())?;
        }
        for mask in &context.masks {
            self.attach(&mask.name, PNG, &mask.png)?;
        }
        if let Some((scene, file)) = &context.scene {
            self.attach(SCENE_FILE, TOML, file.text.as_bytes())?;
            let wall_ns = self.clock.wall_ns;
            let fingerprint = scene.fingerprint().to_string();
            let message =
                json!({ "path": file.path, "fingerprint": fingerprint, "toml": file.text });
            for (topic, message) in [
                (SCENE, message),
                ("/camera/image", foxglove::image(scene, wall_ns)),
                ("/camera/calibration", foxglove::calibration(scene, wall_ns)),
                ("/camera/scene", foxglove::scenery(scene, wall_ns)),
            ] {
                self.put(topic, 1, wall_ns, message.to_string().as_bytes())?;
            }
        }
        Ok(())
    }

    fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> Result<(), WriteError> {
        let attachment = Attachment {
            log_time: self.clock.wall_ns,
            create_time: self.clock.wall_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: data.into(),
        };
        self.written(|mcap| mcap.attach(&attachment))
    }

    fn channel<T: Recorded>(&mut self) -> Result<(), WriteError> {
        self.open(T::TOPIC, &T::schema_name(), &T::schema())
    }

    fn open(&mut self, topic: &'static str, schema: &str, text: &Value) -> Result<(), WriteError> {
        let text = text.to_string();
        let id = self.written(|mcap| {
            let schema = mcap.add_schema(schema, "jsonschema", text.as_bytes())?;
            mcap.add_channel(schema, topic, "json", &BTreeMap::new())
        })?;
        self.channels.insert(topic, id);
        Ok(())
    }

    /// Writes a message as it is.
    fn message<T: Recorded>(
        &mut self,
        message: &T,
        order: Order,
    ) -> Result<Option<Notice>, WriteError> {
        let stamp = *message.stamp();
        let notice = self.ledger.record(T::TOPIC, order);
        if let Some(notice) = &notice {
            self.log(
                Level::Warning,
                "recorder",
                &notice.to_string(),
                stamp.published_ns,
            )?;
        }
        let wall_ns = self.clock.wall_of(stamp.published_ns);
        self.put(
            T::TOPIC,
            stamp.sequence,
            wall_ns,
            message.to_json().as_bytes(),
        )?;
        Ok(notice)
    }

    fn view(
        &mut self,
        topic: &'static str,
        stamp: &ipc::Stamp,
        view: &Value,
    ) -> Result<(), WriteError> {
        let wall_ns = self.clock.wall_of(stamp.published_ns);
        self.put(topic, stamp.sequence, wall_ns, view.to_string().as_bytes())
    }

    fn log(
        &mut self,
        level: Level,
        name: &str,
        text: &str,
        monotonic_ns: u64,
    ) -> Result<(), WriteError> {
        self.logged += 1;
        let wall_ns = self.clock.wall_of(monotonic_ns);
        let entry = foxglove::log(level, name, text, wall_ns).to_string();
        self.put("/log", u64::from(self.logged), wall_ns, entry.as_bytes())
    }

    fn put(
        &mut self,
        topic: &'static str,
        sequence: u64,
        wall_ns: u64,
        data: &[u8],
    ) -> Result<(), WriteError> {
        let Some(channel_id) = self.channels.get(topic).copied() else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id,
            // The format has 32 bits; the message itself has all 64.
            sequence: sequence as u32,
            log_time: wall_ns,
            publish_time: wall_ns,
        };
        self.written(|mcap| mcap.write_to_known_channel(&header, data))
    }

    /// Whether a picture may be drawn at this time, which is taken as its time.
    fn is_due(&mut self, view: View, published_ns: u64) -> bool {
        let last = self.pictured_ns.get(&view);
        let due = last.is_none_or(|last| published_ns.abs_diff(*last) >= PICTURE_NS);
        if due {
            self.pictured_ns.insert(view, published_ns);
        }
        due
    }

    fn written<R>(
        &mut self,
        write: impl FnOnce(&mut Writer<NoSeek<BufWriter<File>>>) -> mcap::McapResult<R>,
    ) -> Result<R, WriteError> {
        write(&mut self.mcap).map_err(|source| WriteError::Write {
            path: self.path.clone(),
            source,
        })
    }
}

/// Topics that Foxglove draws.
pub(crate) const VIEWS: [(&str, Known); 8] = [
    ("/camera/image", Known::RawImage),
    ("/camera/calibration", Known::CameraCalibration),
    ("/camera/scene", Known::ImageAnnotations),
    ("/camera/features", Known::ImageAnnotations),
    ("/camera/way_point", Known::ImageAnnotations),
    ("/camera/pose", Known::PoseInFrame),
    ("/tf", Known::FrameTransform),
    ("/log", Known::Log),
];

fn scene_schema() -> Value {
    let text = |about: &str| json!({ "type": "string", "description": about });
    json!({
        "title": "vpc.Scene",
        "type": "object",
        "properties": {
            "path": text("Where the file was"),
            "fingerprint": text("SHA-256 of the task: camera, pattern, goal, limits, occlusions"),
            "toml": text("The file, as attached"),
        },
        "required": ["path", "fingerprint", "toml"],
    })
}

/// State, cause and error in one line.
fn caption(record: &CycleRecord) -> String {
    let mut text = TwistState::from_code(record.state)
        .map_or_else(|| "unknown state".to_owned(), |state| state.to_string());
    match Hold::from_code(record.hold) {
        Some(Hold::None) | None => (),
        Some(cause) => text += &format!(": {cause}"),
    }
    if record.error_px.is_finite() {
        text += &format!(", error {:.1} px", record.error_px);
    }
    if record.way_point_count > 0 {
        text += ", way point";
    }
    text
}

#[cfg(test)]
mod tests {
    use ipc::Message;

    use super::*;

    /// Fields of a topic's messages.
    fn fields(topic: &str) -> Option<Vec<String>> {
        let schema = [
            (Features::TOPIC, Features::schema()),
            (TwistCommand::TOPIC, TwistCommand::schema()),
            (RobotState::TOPIC, RobotState::schema()),
            (CycleRecord::TOPIC, CycleRecord::schema()),
        ]
        .into_iter()
        .chain(VIEWS.map(|(topic, known)| (topic, known.schema())))
        .find(|(name, _)| *name == topic)?
        .1;
        let names = schema["properties"].as_object()?.keys();
        Some(names.cloned().collect())
    }

    /// Every text in some JSON, keys included.
    fn texts(json: &Value, to: &mut Vec<String>) {
        match json {
            Value::String(text) => to.push(text.clone()),
            Value::Array(list) => list.iter().for_each(|value| texts(value, to)),
            Value::Object(map) => map.iter().for_each(|(key, value)| {
                to.push(key.clone());
                texts(value, to);
            }),
            _ => (),
        }
    }

    #[test]
    fn the_layout_for_foxglove_names_topics_and_fields_that_are_recorded() {
        let layout: Value = serde_json::from_str(include_str!("../foxglove-layout.json")).unwrap();
        let mut found = Vec::new();
        texts(&layout, &mut found);
        let paths: Vec<_> = found.iter().filter(|text| text.starts_with('/')).collect();
        assert!(paths.len() > 15, "{paths:?}");
        for path in paths {
            let (topic, field) = path.split_once('.').unwrap_or((path, ""));
            let fields = fields(topic).unwrap_or_else(|| panic!("{path}: no such topic"));
            let field = field.split('[').next().unwrap_or_default();
            assert!(
                field.is_empty() || fields.iter().any(|name| name == field),
                "{path}"
            );
        }
    }
}
