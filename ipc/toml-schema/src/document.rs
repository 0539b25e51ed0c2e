//! A configuration file, overridden by the flags of the command line.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use crate::judge::{Refusal, judge};
use crate::schema::schema;

/// Stands for a file in messages about flags.
pub const COMMAND_LINE: &str = "command line";

/// Why a file was refused.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file could not be read. The raw name keeps thiserror from making the reason a source:
    /// the message has it.
    #[error("{path}: cannot read: {source}")]
    #[allow(missing_docs)]
    Read {
        path: String,
        r#source: std::io::Error,
    },
    /// The file that a key or a flag names could not be read; of a flag, the path is
    /// [`COMMAND_LINE`].
    #[error("{path}: {key} = {value}: cannot read: {source}")]
    #[allow(missing_docs)]
    Named {
        path: String,
        key: String,
        value: String,
        r#source: std::io::Error,
    },
    /// Wrong syntax, an unknown key or a wrong type, with line and column.
    #[error("{path}: {message}")]
    #[allow(missing_docs)]
    Syntax { path: String, message: String },
    /// A value that is not allowed, or a key that is missing; of a flag, the path is
    /// [`COMMAND_LINE`].
    #[error("{path}: {refusal}")]
    #[allow(missing_docs)]
    Value { path: String, refusal: Refusal },
}

impl FileError {
    /// Returns the error for the value of a key in the file `path`.
    pub fn value(path: &str, key: &str, value: impl ToString, allowed: impl Into<String>) -> Self {
        let refusal = Refusal {
            key: key.to_owned(),
            value: Some(value.to_string()),
            allowed: allowed.into(),
        };
        Self::Value {
            path: path.to_owned(),
            refusal,
        }
    }
}

/// Largest text file, bytes: a configuration has some thousands, a table of starts some millions.
pub const MOST_TEXT: u64 = 16 << 20;

/// Reads a file of at most [`MOST_TEXT`].
///
/// # Errors
/// [`FileError::Read`].
pub fn read_text(path: &Path) -> Result<String, FileError> {
    let text = read_bytes(path, MOST_TEXT).and_then(|bytes| {
        String::from_utf8(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
    });
    text.map_err(|source| FileError::Read {
        path: path.display().to_string(),
        source,
    })
}

/// Opens a plain file for reading. Never waits: a pipe may have no writer, a device no end.
///
/// # Errors
/// It cannot be opened, or is no plain file.
pub fn open_file(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    let options = options.read(true);
    let file = options
        .custom_flags(OFlags::NONBLOCK.bits().cast_signed())
        .open(path)?;
    let found = file.metadata()?.file_type();
    let what = match found {
        _ if found.is_file() => return Ok(file),
        _ if found.is_dir() => "a folder",
        _ if found.is_fifo() => "a pipe",
        _ => "a device",
    };
    let message = format!("is {what}; allowed: a plain file");
    Err(io::Error::new(io::ErrorKind::InvalidInput, message))
}

/// Reads a plain file.
///
/// # Errors
/// It cannot be read, is no plain file, or has more than `most` bytes.
pub fn read_bytes(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open_file(path)?;
    let length = file.metadata()?.len();
    let mut bytes = Vec::new();
    // What is too long by its length is not read.
    if length <= most {
        file.take(most + 1).read_to_end(&mut bytes)?;
    }
    let length = length.max(bytes.len() as u64);
    if length > most {
        let message = format!("{length} bytes; allowed: up to {most}");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// A configuration file with the flags of the command line over it.
#[derive(Clone, Debug)]
pub struct Document {
    path: String,
    text: String,
    pub(crate) table: Table,
    /// The flag that set a key.
    flags: BTreeMap<String, String>,
}

impl Document {
    /// Reads a file; without one, the document is empty and named [`COMMAND_LINE`].
    ///
    /// # Errors
    /// [`FileError`] if it cannot be read or is not TOML.
    pub fn read(path: Option<&Path>) -> Result<Self, FileError> {
        let Some(path) = path else {
            return Self::parse("", COMMAND_LINE);
        };
        Self::parse(&read_text(path)?, &path.display().to_string())
    }

    /// Parses the text of a file; `path` is for messages.
    ///
    /// # Errors
    /// [`FileError::Syntax`] if it is not TOML.
    pub fn parse(text: &str, path: &str) -> Result<Self, FileError> {
        let table = text.parse().map_err(|error| syntax(path, &error))?;
        Ok(Self {
            path: path.to_owned(),
            text: text.to_owned(),
            table,
            flags: BTreeMap::new(),
        })
    }

    /// Makes these paths, keys with their tables, relative to `directory`.
    pub fn relative_to(&mut self, directory: &Path, keys: &[&str]) {
        for key in keys {
            if let Some(Value::String(path)) = self.entry(key) {
                *path = directory.join(&*path).display().to_string();
            }
        }
    }

    /// Sets a key, named with its table, to the value of a flag if the flag was given.
    pub fn set(&mut self, key: &str, flag: &str, value: Option<impl Into<Value>>) {
        let Some(value) = value else { return };
        let (tables, name) = key.rsplit_once('.').unwrap_or(("", key));
        let mut table = &mut self.table;
        for part in tables.split('.').filter(|part| !part.is_empty()) {
            let inner = table.entry(part).or_insert_with(|| Table::new().into());
            // What stands where a table should be is refused by `check`.
            let Value::Table(inner) = inner else { return };
            table = inner;
        }
        table.insert(name.to_owned(), value.into());
        self.flags.insert(key.to_owned(), flag.to_owned());
    }

    /// Whether a key of the file's first level, or its flag, was given.
    pub fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    /// Checks the document against the schema of a struct, and returns the struct.
    ///
    /// # Errors
    /// [`FileError`] names file or flag, key, value and what is allowed.
    pub fn check<T: DeserializeOwned + JsonSchema>(&self) -> Result<T, FileError> {
        let schema = schema::<T>();
        // A wrong type or an unknown key in the file is an error even where a flag replaces it.
        if let Ok(file) = self.text.parse::<Table>()
            && let Err(None) = judge(&schema, &Value::Table(file), "")
            && let Err(error) = toml::from_str::<T>(&self.text)
        {
            return Err(syntax(&self.path, &error));
        }
        let table = Value::Table(self.table.clone());
        if let Err(Some(refusal)) = judge(&schema, &table, "") {
            return Err(self.refused(refusal));
        }
        T::deserialize(table).map_err(|error| {
            // The error of the text has line and column.
            let error = toml::from_str::<T>(&self.text).err().unwrap_or(error);
            syntax(&self.path, &error)
        })
    }

    /// Checks that the files that these keys name can be read. Keys that are not given are passed
    /// over.
    ///
    /// # Errors
    /// [`FileError::Named`] names file or flag, key and value.
    pub fn readable(&self, keys: &[&str]) -> Result<(), FileError> {
        for key in keys {
            let Some(Value::String(value)) = self.table.get(*key) else {
                continue;
            };
            if let Err(source) = open_file(Path::new(value)) {
                let flag = self.flags.get(*key);
                return Err(FileError::Named {
                    path: flag.map_or(&*self.path, |_| COMMAND_LINE).to_owned(),
                    key: flag.map_or(*key, String::as_str).to_owned(),
                    value: value.clone(),
                    source,
                });
            }
        }
        Ok(())
    }

    /// Returns the error for a value that no schema refuses, for instance because it depends on
    /// another key.
    pub fn refuse(&self, key: &str, value: impl ToString, allowed: impl Into<String>) -> FileError {
        self.refused(Refusal {
            key: key.to_owned(),
            value: Some(value.to_string()),
            allowed: allowed.into(),
        })
    }

    /// Returns the error for a key that another key makes necessary.
    pub fn missing(&self, key: &str, allowed: impl Into<String>) -> FileError {
        self.refused(Refusal {
            key: key.to_owned(),
            value: None,
            allowed: allowed.into(),
        })
    }

    fn refused(&self, mut refusal: Refusal) -> FileError {
        let mut path = self.path.clone();
        if let Some(flag) = self.flags.get(&refusal.key) {
            path = COMMAND_LINE.to_owned();
            refusal.key.clone_from(flag);
        }
        FileError::Value { path, refusal }
    }

    fn entry(&mut self, key: &str) -> Option<&mut Value> {
        let mut parts = key.split('.');
        let first = self.table.get_mut(parts.next()?)?;
        parts.try_fold(first, |value, part| value.get_mut(part))
    }
}

fn syntax(path: &str, error: &toml::de::Error) -> FileError {
    FileError::Syntax {
        path: path.to_owned(),
        message: error.to_string().trim_end().to_owned(),
    }
}
