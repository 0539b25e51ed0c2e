//! Writing an MCAP file of messages.

use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, WriteOptions, Writer};

use crate::clock::WallClock;
use crate::error::WriteError;
use crate::message::Encoding;
use crate::sink::Sink;

/// Name of the attached configuration of `vpcd`.
pub const CONFIG_FILE: &str = "vpcd.toml";
/// Name of the attached scene; masks are attached under the names that the scene gives them.
pub const SCENE_FILE: &str = "scene.toml";
/// Name of the metadata record at the head of the file.
pub(crate) const ORIGIN: &str = "vpc.origin";

/// A recording that is being written.
///
/// It is readable up to the last [`flush`](Self::flush) whatever happens to the process, and
/// indexed after [`finish`](Self::finish). Compression takes milliseconds: use it from an ordinary
/// thread. The times of messages in the file are their `published_ns` moved to the wall clock.
///
/// A record of what happened before a fault:
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("fault.mcap");
/// # let features = [messages::Features::new(&[[1.0; 2]; 4], 0); 2];
/// # let cycles = [messages::CycleRecord::default(); 3];
/// use recording::{CONFIG_FILE, Recording, RecordingFile, SCENE_FILE, Sink};
///
/// let mut file = RecordingFile::create(&path, false)?;
/// file.origin([("cause", "fault".to_owned())])?;
/// file.attach(CONFIG_FILE, b"[law]\nnp = 4\n")?;
/// // Then attach each mask under its name in the scene.
/// file.attach(SCENE_FILE, scene::PAPER_SIM.as_bytes())?;
/// features.iter().try_for_each(|message| file.write(message))?;
/// cycles.iter().try_for_each(|message| file.write(message))?;
/// file.finish()?; // synchronised to the disk
///
/// let recording = Recording::read(&path)?;
/// assert_eq!((recording.features.len(), recording.cycles.len()), (2, 3));
/// assert_eq!(recording.origin("cause"), Some("fault"));
/// # Ok(())
/// # }
/// ```
pub struct RecordingFile {
    path: String,
    mcap: Writer<NoSeek<BufWriter<File>>>,
    channels: HashMap<&'static str, u16>,
    clock: WallClock,
}

impl RecordingFile {
    /// Creates the file.
    ///
    /// # Errors
    /// [`WriteError`]; a file that exists is refused without `force`.
    pub fn create(path: &Path, force: bool) -> Result<Self, WriteError> {
        let name = path.display().to_string();
        let mut how = OpenOptions::new();
        how.write(true)
            .create(true)
            .truncate(force)
            .create_new(!force);
        let file = how.open(path).map_err(|source| match source.kind() {
            ErrorKind::AlreadyExists => WriteError::Exists { path: name.clone() },
            _ => WriteError::Create {
                path: name.clone(),
                source,
            },
        })?;
        // Chunks are written whole, when they are full or flushed, and never mended afterwards: a
        // writer that is killed leaves whole chunks.
        let options = WriteOptions::new()
            .disable_seeking(true)
            .library(concat!("vpcd recording ", env!("CARGO_PKG_VERSION")))
            .compression_threads(0);
        let mcap = options.create(NoSeek::new(BufWriter::new(file)));
        let mut recording = Self {
            mcap: mcap.map_err(|source| WriteError::Write {
                path: name.clone(),
                source,
            })?,
            path: name,
            channels: HashMap::new(),
            clock: WallClock::now(),
        };
        let WallClock {
            monotonic_ns,
            wall_ns,
        } = recording.clock;
        recording.origin([
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("monotonic_ns", monotonic_ns.to_string()),
            ("wall_ns", wall_ns.to_string()),
        ])?;
        Ok(recording)
    }

    /// Adds to what the file says about its origin; version and clocks are there from the
    /// beginning.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn origin(
        &mut self,
        entries: impl IntoIterator<Item = (&'static str, String)>,
    ) -> Result<(), WriteError> {
        let entries = entries.into_iter();
        let entries = entries.map(|(key, value)| (key.to_owned(), value));
        self.metadata(ORIGIN, entries.collect())
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), WriteError> {
        let record = Metadata {
            name: name.to_owned(),
            metadata: entries,
        };
        self.written(|mcap| mcap.write_metadata(&record))
    }

    /// Attaches a file under its name; the ending says what it is.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn attach(&mut self, name: &str, data: &[u8]) -> Result<(), WriteError> {
        let media_type = match Path::new(name).extension().and_then(|end| end.to_str()) {
            Some("toml") => "application/toml",
            Some("png") => "image/png",
            _ => "application/octet-stream",
        };
        let attachment = Attachment {
            log_time: self.clock.wall_ns,
            create_time: self.clock.wall_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: data.into(),
        };
        self.written(|mcap| mcap.attach(&attachment))
    }

    /// Hands everything so far to the operating system: from here on it survives the end of this
    /// process.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.written(Writer::flush)
    }

    /// Writes the index and synchronises the file to the disk.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(mut self) -> Result<(), WriteError> {
        self.written(Writer::finish)?;
        let file = self.mcap.into_inner().into_inner().into_inner();
        file.map_err(|error| error.into_error())
            .and_then(|file| file.sync_all())
            .map_err(|source| WriteError::Write {
                path: self.path,
                source: source.into(),
            })
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

impl Sink for RecordingFile {
    fn clock(&self) -> WallClock {
        self.clock
    }

    fn put(
        &mut self,
        topic: &'static str,
        encoding: impl FnOnce() -> Encoding,
        sequence: u64,
        wall_ns: u64,
        data: impl FnOnce() -> Vec<u8>,
    ) -> Result<(), WriteError> {
        let channel_id = match self.channels.get(topic) {
            Some(id) => *id,
            None => {
                let Encoding { schema, message } = encoding();
                let id = self.written(|mcap| {
                    let schema = mcap.add_schema(&schema.0, &schema.1, &schema.2)?;
                    mcap.add_channel(schema, topic, &message, &BTreeMap::new())
                })?;
                self.channels.insert(topic, id);
                id
            }
        };
        let header = MessageHeader {
            channel_id,
            // The format has 32 bits; the message itself has all 64.
            sequence: sequence as u32,
            log_time: wall_ns,
            publish_time: wall_ns,
        };
        self.written(|mcap| mcap.write_to_known_channel(&header, &data()))
    }
}
