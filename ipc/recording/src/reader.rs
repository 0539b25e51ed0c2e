//! Reading a recording, whole or cut short.

use std::collections::{BTreeMap, HashMap};
use std::io::{self, BufReader, Read};
use std::path::Path;

use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use messages::{
    CycleRecord, DesiredTwist, Features, Message, Reply, Request, RobotState, Snapshot,
    TwistCommand,
};
use scene::{FileError, Scene};

use crate::clock::WallClock;
use crate::error::ReadError;
use crate::message::Recorded;
use crate::writer::{CONFIG_FILE, ORIGIN, SCENE_FILE};

/// Longest record, bytes: a damaged length must not take all memory. Chunks are decompressed record
/// by record.
const LONGEST: usize = 64 << 20;
/// Most bytes of records for each byte of the file, beside one of the longest: a small file does
/// not become a large recording. That of an idle vpcd, which changes least, has 19.
const RATIO: usize = 256;

/// What was recorded; messages in the order in which they were written.
#[derive(Clone, Debug, Default)]
#[allow(missing_docs)]
pub struct Recording {
    pub features: Vec<Features>,
    pub twist: Vec<TwistCommand>,
    pub robot: Vec<RobotState>,
    pub desired: Vec<DesiredTwist>,
    pub cycles: Vec<CycleRecord>,
    pub requests: Vec<Request>,
    pub replies: Vec<Reply>,
    pub snapshots: Vec<Snapshot>,
    /// Attached files by their names.
    pub attachments: BTreeMap<String, Vec<u8>>,
    /// Metadata records by their names; the entries of those of one name are together.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Why reading ended before the end of the file.
    pub cut: Option<String>,
}

impl Recording {
    /// Reads a file. One that was not finished is read as far as it goes, and says so in `cut`.
    ///
    /// # Errors
    /// [`ReadError`]: no file, not MCAP from its first bytes on, or a message that is not of the
    /// contract.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        let name = path.display().to_string();
        let failed = |source| ReadError::Read {
            path: name.clone(),
            source,
        };
        let file = toml_schema::open_file(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        let mut file = BufReader::new(file);
        let most = usize::try_from(length).unwrap_or(usize::MAX);
        let (mut decoded, most) = (0_usize, most.saturating_mul(RATIO).saturating_add(LONGEST));
        let mut reader = LinearReader::new_with_options(
            LinearReaderOptions::default()
                .with_skip_end_magic(true)
                .with_validate_chunk_crcs(true)
                .with_validate_data_section_crc(true)
                .with_validate_summary_section_crc(true)
                .with_record_length_limit(LONGEST),
        );
        let mut recording = Self {
            cut: Some("the file has no end".to_owned()),
            ..Self::default()
        };
        let mut channels = Channels::default();
        let mut is_first = true;
        // A message that cannot be read may turn out to be damaged: its chunk's checksum follows.
        let mut wrong = None;
        while let Some(event) = reader.next_event() {
            let record = match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    let read = file.read(reader.insert(need)).map_err(failed)?;
                    reader.notify_read(read);
                    continue;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    decoded = decoded.saturating_add(data.len());
                    if decoded > most {
                        let path = name;
                        return Err(ReadError::Bomb { path, length, most });
                    }
                    mcap::parse_record(opcode, data)
                }
                Err(error) => Err(error),
            };
            match record {
                Ok(record) if wrong.is_none() => {
                    wrong = recording.take(&name, &mut channels, record).err();
                }
                Ok(_) => (),
                Err(source) if is_first => return Err(ReadError::Format { path: name, source }),
                Err(source) => {
                    recording.cut = Some(source.to_string());
                    return Ok(recording);
                }
            }
            is_first = false;
        }
        wrong.map_or(Ok(recording), Err)
    }

    /// Number of messages missing between the first and the last, by sequence numbers; a publisher
    /// that starts again starts a new count.
    pub fn missing<T: Message>(messages: &[T]) -> u64 {
        let pairs = messages.windows(2);
        pairs
            .filter_map(|pair| {
                let (one, next) = (pair[0].stamp().sequence, pair[1].stamp().sequence);
                next.checked_sub(one.checked_add(1)?)
            })
            .sum()
    }

    /// An entry about the origin of the file: `version`, `cause`, or the path of an attached file.
    pub fn origin(&self, key: &str) -> Option<&str> {
        Some(self.metadata.get(ORIGIN)?.get(key)?.as_str())
    }

    /// The clock that the times of the messages in the file were translated by.
    pub fn clock(&self) -> Option<WallClock> {
        let number = |key| self.origin(key)?.parse().ok();
        Some(WallClock {
            monotonic_ns: number("monotonic_ns")?,
            wall_ns: number("wall_ns")?,
        })
    }

    /// The attached configuration of the daemon.
    pub fn config(&self) -> Option<&str> {
        self.text(CONFIG_FILE)
    }

    /// The attached scene as text.
    pub fn scene_toml(&self) -> Option<&str> {
        self.text(SCENE_FILE)
    }

    /// The attached scene with its masks.
    ///
    /// # Errors
    /// [`FileError`]; a mask that is not attached cannot be read.
    pub fn scene(&self) -> Result<Option<Scene>, FileError> {
        let mask = |name: &str| {
            let missing = "not in the recording; allowed: the masks of its scene";
            let attached = self.attachments.get(name).cloned();
            attached.ok_or_else(|| io::Error::other(missing))
        };
        let parse = |text| Scene::parse_with(text, SCENE_FILE, &mask);
        self.scene_toml().map(parse).transpose()
    }

    fn text(&self, name: &str) -> Option<&str> {
        std::str::from_utf8(self.attachments.get(name)?).ok()
    }

    fn take(
        &mut self,
        path: &str,
        channels: &mut Channels,
        record: Record<'_>,
    ) -> Result<(), ReadError> {
        match record {
            Record::Schema { header, .. } => {
                channels.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = channels.schemas.get(&channel.schema_id).cloned();
                let of = (channel.topic, schema.unwrap_or_default());
                channels.topics.insert(channel.id, of);
            }
            Record::Message { header, data } => {
                if let Some((topic, schema)) = channels.topics.get(&header.channel_id) {
                    let read = self.message(topic, schema, &data);
                    return read.map_err(|reason| ReadError::Message {
                        path: path.to_owned(),
                        topic: topic.clone(),
                        sequence: header.sequence,
                        reason,
                    });
                }
            }
            Record::Attachment { header, data, .. } => {
                self.attachments.insert(header.name, data.into_owned());
            }
            Record::Metadata(record) => {
                let entries = self.metadata.entry(record.name).or_default();
                entries.extend(record.metadata);
            }
            Record::Footer(_) => self.cut = None,
            _ => (),
        }
        Ok(())
    }

    fn message(&mut self, topic: &str, schema: &str, data: &[u8]) -> Result<(), String> {
        match topic {
            Features::TOPIC => put(&mut self.features, schema, data),
            TwistCommand::TOPIC => put(&mut self.twist, schema, data),
            RobotState::TOPIC => put(&mut self.robot, schema, data),
            DesiredTwist::TOPIC => put(&mut self.desired, schema, data),
            CycleRecord::TOPIC => put(&mut self.cycles, schema, data),
            Request::TOPIC => put(&mut self.requests, schema, data),
            Reply::TOPIC => put(&mut self.replies, schema, data),
            Snapshot::TOPIC => put(&mut self.snapshots, schema, data),
            _ => Ok(()),
        }
    }
}

/// What a file says of its channels.
#[derive(Default)]
struct Channels {
    schemas: HashMap<u16, String>,
    /// Topic and name of the schema.
    topics: HashMap<u16, (String, String)>,
}

/// Appends a message of this schema to those of its topic. One of another layout is read all the
/// same if it has every field: fields are found by their names.
fn put<T: Recorded>(list: &mut Vec<T>, schema: &str, data: &[u8]) -> Result<(), String> {
    let json = serde_json::from_slice(data).map_err(|error| error.to_string())?;
    let message = T::from_json(&json).map_err(|error| match T::schema_name() {
        ours if ours != schema => {
            format!("{error} (another version of the contract: {schema}; this program's: {ours})")
        }
        _ => error.to_string(),
    });
    list.push(message?);
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// What reading says of a recording of this many messages of a MiB, in chunks of this size.
    fn read(messages: usize, chunk: u64) -> Result<Recording, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let file = std::fs::File::create(&path).unwrap();
        let options = mcap::WriteOptions::new().chunk_size(Some(chunk));
        let mut writer = options.create(io::BufWriter::new(file)).unwrap();
        let channel = writer.add_channel(0, "/a", "json", &BTreeMap::new());
        let header = mcap::records::MessageHeader {
            channel_id: channel.unwrap(),
            sequence: 0,
            log_time: 0,
            publish_time: 0,
        };
        for _ in 0..messages {
            let data = vec![b' '; 1 << 20];
            writer.write_to_known_channel(&header, &data).unwrap();
        }
        writer.finish().unwrap();
        assert!(std::fs::metadata(&path).unwrap().len() < 100_000);
        Recording::read(&path).map_err(|error| error.to_string())
    }

    /// What reading says of a recording of this text on `/vpc/features`, under this schema.
    fn read_text(schema: &str, text: &str) -> Result<Recording, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
        let schema = writer.add_schema(schema, "jsonschema", b"{}").unwrap();
        let channel = writer.add_channel(schema, Features::TOPIC, "json", &BTreeMap::new());
        let header = mcap::records::MessageHeader {
            channel_id: channel.unwrap(),
            sequence: 1,
            log_time: 0,
            publish_time: 0,
        };
        writer
            .write_to_known_channel(&header, text.as_bytes())
            .unwrap();
        writer.finish().unwrap();
        Recording::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn a_message_of_another_layout_is_read_if_it_has_each_field() {
        let other = "vpc.Features.00000000";
        let features = Features::new(&[[1.0, 2.0]; 4], 3);
        let text = features.to_json();
        assert_eq!(read_text(other, &text).unwrap().features, [features]);
        let lacking = text.replace("exposure_ns", "exposed_ns");
        let said = read_text(other, &lacking).unwrap_err();
        let ours = Features::schema_name();
        let words = format!(
            "message 1 of /vpc/features: exposure_ns = nothing; allowed: 0 to 2^64-1 (another \
             version of the contract: {other}; this program's: {ours})"
        );
        assert!(said.ends_with(&words), "{said}");
        let said = read_text(&ours, &lacking).unwrap_err();
        assert!(said.ends_with("allowed: 0 to 2^64-1"), "{said}");
    }

    #[test]
    fn a_small_file_does_not_become_a_large_recording() {
        assert_eq!(read(40, 1 << 22).unwrap().cut, None);
        for chunk in [1 << 22, 1 << 30] {
            let said = read(120, chunk).unwrap_err();
            assert!(
                said.contains("bytes of records; allowed: up to that"),
                "{said}"
            );
        }
    }
}
