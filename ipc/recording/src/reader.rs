//! Reading a recording, whole or cut short.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use ipc::{CycleRecord, Features, Message, Reply, Request, RobotState, TwistCommand};
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use scene::{FileError, Scene};
use serde_json::Value;

use crate::clock::WallClock;
use crate::field::FieldError;
use crate::file::{CONFIG_FILE, LEDGER, ORIGIN, PNG, SCENE_FILE};
use crate::ledger::Ledger;
use crate::message::Recorded;

/// Longest record that is believed: a damaged length must not take all memory.
const LONGEST: usize = 256 << 20;

/// Why a recording could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file.
    #[error("{path}: cannot read the recording: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// It is no recording.
    #[error("{path}: not a recording: {source}")]
    Format {
        /// The file.
        path: String,
        /// The reason.
        source: McapError,
    },
    /// A message is not what its topic says.
    #[error("{path}: message {sequence} of {topic}: {reason}")]
    Message {
        /// The file.
        path: String,
        /// The topic.
        topic: String,
        /// The message's number.
        sequence: u32,
        /// What is wrong with it.
        reason: String,
    },
    /// The scene in it.
    #[error("{path}: {source}")]
    Scene {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: FileError,
    },
}

/// What was recorded; each list in the order in which its messages came.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// What the camera saw.
    pub features: Vec<Features>,
    /// What the controller commanded.
    pub twist: Vec<TwistCommand>,
    /// Where the robot was.
    pub robot: Vec<RobotState>,
    /// What the controller's cycles did.
    pub cycles: Vec<CycleRecord>,
    /// What operators asked for.
    pub requests: Vec<Request>,
    /// What the controller answered.
    pub replies: Vec<Reply>,
    /// The scene, where the recorder was told; its masks are in the recording as well.
    pub scene: Option<Scene>,
    /// Its file.
    pub scene_toml: Option<String>,
    /// The daemon's configuration file, where the recorder was told.
    pub config_toml: Option<String>,
    /// Where that file was.
    pub config_path: Option<String>,
    /// How stamps were translated.
    pub clock: Option<WallClock>,
    /// What the recorder counted; `None` where it did not come to its end.
    pub ledger: Option<Ledger>,
    /// Where the file is cut short: the reader's words.
    pub cut: Option<String>,
}

impl Recording {
    /// Reads a file. One that its recorder did not finish is read as far as it goes, and says so in `cut`.
    ///
    /// # Errors
    /// [`ReadError`]: no file, not MCAP from its first bytes on, or a message that is not of the contract.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        let name = path.display().to_string();
        let failed = |source| ReadError::Read {
            path: name.clone(),
            source,
        };
        let mut file = BufReader::new(File::open(path).map_err(failed)?);
        let mut reader = LinearReader::new_with_options(
            LinearReaderOptions::default()
                .with_skip_end_magic(true)
                .with_validate_chunk_crcs(true)
                .with_record_length_limit(LONGEST),
        );
        let mut recording = Self::default();
        let mut channels = HashMap::new();
        let mut masks = HashMap::new();
        let mut finished = false;
        let mut records = 0_u64;
        // A message that is none: the reader comes to the checksum of its chunk later, and damage is no wrong message.
        let mut wrong = None;
        while let Some(event) = reader.next_event() {
            let record = match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    let read = file.read(reader.insert(need)).map_err(failed)?;
                    reader.notify_read(read);
                    continue;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => mcap::parse_record(opcode, data),
                Err(error) => Err(error),
            };
            let record = match record {
                Ok(record) => record,
                Err(source) if records == 0 => {
                    return Err(ReadError::Format { path: name, source });
                }
                Err(source) => {
                    recording.cut = Some(source.to_string());
                    break;
                }
            };
            records += 1;
            finished |= matches!(record, Record::Footer(_));
            if wrong.is_none() {
                let taken = recording.take(&name, &mut channels, &mut masks, record);
                wrong = taken.err();
            }
        }
        if let Some(wrong) = wrong.filter(|_| recording.cut.is_none()) {
            return Err(wrong);
        }
        recording.scene = recording
            .scene_toml
            .as_deref()
            .map(|text| parsed(text, &masks))
            .transpose()
            .map_err(|source| ReadError::Scene { path: name, source })?;
        if !finished && recording.cut.is_none() {
            recording.cut = Some("the file has no end".to_owned());
        }
        Ok(recording)
    }

    /// Messages between the first and the last number that are not in the recording, by the sequence numbers; a
    /// publisher that starts again starts a new count.
    pub fn missing<T: ipc::Message>(messages: &[T]) -> u64 {
        let pairs = messages.windows(2);
        pairs
            .filter_map(|pair| {
                let (one, next) = (pair[0].stamp().sequence, pair[1].stamp().sequence);
                next.checked_sub(one.checked_add(1)?)
            })
            .sum()
    }

    fn take(
        &mut self,
        path: &str,
        channels: &mut HashMap<u16, String>,
        masks: &mut HashMap<String, Vec<u8>>,
        record: Record<'_>,
    ) -> Result<(), ReadError> {
        match record {
            Record::Channel(channel) => {
                channels.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                if let Some(topic) = channels.get(&header.channel_id) {
                    self.message(topic, &data)
                        .map_err(|reason| ReadError::Message {
                            path: path.to_owned(),
                            topic: topic.clone(),
                            sequence: header.sequence,
                            reason,
                        })?;
                }
            }
            Record::Attachment { header, data, .. } if header.media_type == PNG => {
                masks.insert(header.name, data.into_owned());
            }
            Record::Attachment { header, data, .. } => {
                let text = || String::from_utf8_lossy(&data).into_owned();
                match header.name.as_str() {
                    SCENE_FILE => self.scene_toml = Some(text()),
                    CONFIG_FILE => self.config_toml = Some(text()),
                    _ => (),
                }
            }
            Record::Metadata(metadata) => match metadata.name.as_str() {
                ORIGIN => {
                    self.clock = clock(&metadata.metadata);
                    self.config_path = metadata.metadata.get("config").cloned();
                }
                LEDGER => self.ledger = Some(Ledger::from_map(&metadata.metadata)),
                _ => (),
            },
            _ => (),
        }
        Ok(())
    }

    fn message(&mut self, topic: &str, data: &[u8]) -> Result<(), String> {
        fn put<T: Recorded>(list: &mut Vec<T>, data: &[u8]) -> Result<(), String> {
            let json: Value = serde_json::from_slice(data).map_err(|error| error.to_string())?;
            let message = T::from_json(&json).map_err(|error: FieldError| error.to_string())?;
            list.push(message);
            Ok(())
        }
        match topic {
            Features::TOPIC => put(&mut self.features, data),
            TwistCommand::TOPIC => put(&mut self.twist, data),
            RobotState::TOPIC => put(&mut self.robot, data),
            CycleRecord::TOPIC => put(&mut self.cycles, data),
            Request::TOPIC => put(&mut self.requests, data),
            Reply::TOPIC => put(&mut self.replies, data),
            _ => Ok(()),
        }
    }
}

/// The scene with the masks that were recorded.
fn parsed(text: &str, masks: &HashMap<String, Vec<u8>>) -> Result<Scene, FileError> {
    Scene::parse_with(text, SCENE_FILE, &|name| {
        let mask = masks.get(name).cloned();
        mask.ok_or_else(|| {
            io::Error::other("not in the recording; allowed: the masks of its scene")
        })
    })
}

fn clock(origin: &BTreeMap<String, String>) -> Option<WallClock> {
    let number = |key: &str| origin.get(key)?.parse().ok();
    Some(WallClock {
        monotonic_ns: number("monotonic_ns")?,
        wall_ns: number("wall_ns")?,
    })
}
