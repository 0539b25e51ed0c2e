//! The file of a flight record, to and from bytes (`controller/FLIGHT.md`).

use std::path::Path;

use sha2::{Digest, Sha256};

use super::about::{About, hex};
use super::record::{FlightRecord, Key};
use super::words::{Layout, Words, Writer, fill, words_of};

/// First bytes of a file; the digit is the version of the container.
pub const MAGIC: &[u8; 8] = b"VPCFLT1\n";
/// Bytes before the header: magic, the header's length, its SHA-256, zeros.
pub const PREAMBLE: usize = 64;
/// The header's length is a multiple of this, so that words are aligned.
const ALIGNMENT: usize = 64;
/// Longest header believed, bytes.
const LONGEST_HEADER: u64 = 16 << 20;

/// Why a file was refused.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// It cannot be read.
    #[error("{path}: cannot read the flight record: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// It is damaged, or none.
    #[error("{path}: byte {offset}: {what} = {found}; allowed: {allowed}")]
    Damaged {
        /// The file.
        path: String,
        /// Where.
        offset: usize,
        /// Which part.
        what: String,
        /// What was found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
}

/// A flight record: keys and records of the last minutes, the oldest first, and who recorded them.
#[derive(Clone, Debug, PartialEq)]
pub struct Flight {
    /// Who recorded what.
    pub about: About,
    /// The keys, by rising cycle.
    pub keys: Vec<Key>,
    /// The records, by rising cycle.
    pub records: Vec<FlightRecord>,
}

impl Flight {
    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let about = About {
            keys: self.keys.len(),
            records: self.records.len(),
            ..self.about.clone()
        };
        // A struct of strings and finite numbers has a JSON text.
        let mut header = serde_json::to_vec_pretty(&about).unwrap_or_default();
        header.resize(header.len().next_multiple_of(ALIGNMENT), b' ');
        let mut words = Vec::new();
        let mut writer = Writer(&mut words);
        self.keys
            .iter()
            .for_each(|key| key.clone().words(&mut writer));
        for record in &self.records {
            record.clone().words(&mut writer);
        }
        let mut bytes = Vec::with_capacity(PREAMBLE + header.len() + 8 * words.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&(header.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&Sha256::digest(&header));
        bytes.resize(PREAMBLE, 0);
        bytes.extend_from_slice(&header);
        bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        bytes
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`FlightError`] names the file, the place, what was found and what is allowed.
    pub fn read(path: &Path) -> Result<Self, FlightError> {
        let name = path.display().to_string();
        match std::fs::read(path) {
            Ok(bytes) => Self::parse(&bytes, &name),
            Err(source) => Err(FlightError::Read { path: name, source }),
        }
    }

    /// Takes a file's bytes apart and checks all of them; `path` is for messages.
    ///
    /// # Errors
    /// [`FlightError::Damaged`].
    pub fn parse(bytes: &[u8], path: &str) -> Result<Self, FlightError> {
        let text = Text { path, bytes };
        let about = text.about()?;
        let start = PREAMBLE + text.header_length()? as usize;
        let (mut key_layout, mut record_layout) = (Key::layout(), FlightRecord::layout());
        text.check_fields("key_fields", &about.key_fields, &key_layout)?;
        text.check_fields("record_fields", &about.record_fields, &record_layout)?;
        let (key_size, record_size) = (8 * key_layout.count(), 8 * record_layout.count());
        let expected = (about.keys as u128) * (key_size as u128)
            + (about.records as u128) * (record_size as u128)
            + start as u128;
        if bytes.len() as u128 != expected {
            let allowed = format!(
                "{expected} bytes ({} keys of {key_size}, {} records of {record_size} from byte {start} on)",
                about.keys, about.records
            );
            return Err(text.damaged(bytes.len(), "the end of the file", bytes.len(), &allowed));
        }
        let (keys, records) = bytes[start..].split_at(about.keys * key_size);
        let keys = text.list(keys, start, &mut key_layout, "key", Key::blank)?;
        let start = start + about.keys * key_size;
        let records = text.list(
            records,
            start,
            &mut record_layout,
            "record",
            FlightRecord::blank,
        )?;
        Ok(Self {
            about,
            keys,
            records,
        })
    }
}

/// What keys and records have in common.
trait Sealed: Words + Copy {
    fn cycle(&self) -> u64;
    fn seals(&self) -> (u64, u64);
}

impl Sealed for Key {
    fn cycle(&self) -> u64 {
        self.cycle
    }

    fn seals(&self) -> (u64, u64) {
        (self.seal, self.computed_seal())
    }
}

impl Sealed for FlightRecord {
    fn cycle(&self) -> u64 {
        self.told.cycle
    }

    fn seals(&self) -> (u64, u64) {
        (self.seal, self.computed_seal())
    }
}

/// The bytes of a file, with its name for messages.
struct Text<'a> {
    path: &'a str,
    bytes: &'a [u8],
}

impl Text<'_> {
    fn damaged(
        &self,
        offset: usize,
        what: &str,
        found: impl ToString,
        allowed: &str,
    ) -> FlightError {
        FlightError::Damaged {
            path: self.path.to_owned(),
            offset,
            what: what.to_owned(),
            found: found.to_string(),
            allowed: allowed.to_owned(),
        }
    }

    /// The header's length, bytes.
    fn header_length(&self) -> Result<u64, FlightError> {
        let bytes = self.bytes;
        let Some((magic, rest)) = bytes.split_first_chunk::<8>() else {
            return Err(self.damaged(0, "magic", "the end of the file", "VPCFLT1 and a line feed"));
        };
        if magic != MAGIC {
            let found = magic.escape_ascii();
            return Err(self.damaged(0, "magic", found, "VPCFLT1 and a line feed"));
        }
        let length = rest
            .first_chunk::<8>()
            .map(|word| u64::from_le_bytes(*word));
        let most = (bytes.len() as u64).saturating_sub(PREAMBLE as u64);
        match length {
            Some(length) if length <= most.min(LONGEST_HEADER) => Ok(length),
            Some(length) => {
                let allowed = format!("at most {}, what the file holds", most.min(LONGEST_HEADER));
                Err(self.damaged(8, "length of the header", length, &allowed))
            }
            None => Err(self.damaged(8, "length of the header", "the end of the file", "8 bytes")),
        }
    }

    fn about(&self) -> Result<About, FlightError> {
        let length = self.header_length()? as usize;
        let header = &self.bytes[PREAMBLE..PREAMBLE + length];
        let (digest, zeros) = self.bytes[16..PREAMBLE].split_at(32);
        let found = Sha256::digest(header);
        if digest != found.as_slice() {
            let allowed = format!("{}, the SHA-256 of the header", hex(&found));
            return Err(self.damaged(16, "digest of the header", hex(digest), &allowed));
        }
        if let Some(at) = zeros.iter().position(|byte| *byte != 0) {
            return Err(self.damaged(48 + at, "reserved byte", zeros[at], "0"));
        }
        serde_json::from_slice(header).map_err(|error| {
            self.damaged(
                PREAMBLE,
                "header",
                error,
                "the JSON of FLIGHT.md, as this version of vpcd writes it",
            )
        })
    }

    /// Only what the same fields mean can be replayed.
    fn check_fields(
        &self,
        what: &str,
        found: &[super::words::Field],
        layout: &Layout,
    ) -> Result<(), FlightError> {
        let own = layout.fields();
        if found == own {
            return Ok(());
        }
        let show = |field: Option<&super::words::Field>| {
            field.map_or("none".to_owned(), |field| {
                format!("{} ({} x {})", field.name, field.count, field.kind)
            })
        };
        let at = (0..).find(|&k| found.get(k) != own.get(k)).unwrap_or(0);
        let what = format!("{what}[{at}]");
        let allowed = format!(
            "{} (another version of vpcd recorded; replay with that one)",
            show(own.get(at))
        );
        Err(self.damaged(PREAMBLE, &what, show(found.get(at)), &allowed))
    }

    fn list<T: Sealed>(
        &self,
        bytes: &[u8],
        start: usize,
        layout: &mut Layout,
        what: &str,
        blank: fn() -> T,
    ) -> Result<Vec<T>, FlightError> {
        let size = 8 * layout.count();
        let mut list: Vec<T> = Vec::with_capacity(bytes.len() / size);
        let mut words = Vec::with_capacity(layout.count());
        for (index, bytes) in bytes.chunks_exact(size).enumerate() {
            let offset = start + index * size;
            words.clear();
            let (chunks, _) = bytes.as_chunks::<8>();
            words.extend(chunks.iter().map(|word| u64::from_le_bytes(*word)));
            let item = fill(blank(), &words).map_err(|at| {
                let (name, kind) = layout.word(at).unwrap_or_default();
                let what = format!("{what} {index}: {name}");
                self.damaged(offset + 8 * at, &what, kind.show(words[at]), "its codes")
            })?;
            // A message that did not come, say, has words that are all zero.
            let own = words_of(&mut item.clone());
            if let Some(at) = own.iter().zip(&words).position(|(own, word)| own != word) {
                let (name, kind) = layout.word(at).unwrap_or_default();
                let what = format!("{what} {index}: {name}");
                let found = kind.show(words[at]);
                return Err(self.damaged(offset + 8 * at, &what, found, &kind.show(own[at])));
            }
            let (found, expected) = item.seals();
            if found != expected {
                let what = format!("{what} {index}: seal");
                let allowed = format!(
                    "{expected:#018x}, which fits bytes {offset} to {}",
                    offset + size - 8
                );
                let found = format!("{found:#018x}");
                return Err(self.damaged(offset + size - 8, &what, found, &allowed));
            }
            if let Some(last) = list.last()
                && last.cycle() >= item.cycle()
            {
                let what = format!("{what} {index}: cycle");
                let allowed = format!("more than {}, that of the one before", last.cycle());
                return Err(self.damaged(offset, &what, item.cycle(), &allowed));
            }
            list.push(item);
        }
        Ok(list)
    }
}
