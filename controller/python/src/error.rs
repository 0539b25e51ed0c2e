//! Errors of the crates as exceptions, with their own messages.

use std::fmt::Display;
use std::io::{self, ErrorKind};

use memory_blob::{OpenError, WriteError};
use pyo3::PyErr;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError};
use recording::ReadError;
use toml_schema::FileError;

/// A value that is not allowed.
pub fn value(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A flag of the table out of its range.
pub fn keyword(error: impl Display) -> PyErr {
    value(system_tests::flags::as_keywords(error))
}

/// A file that cannot be read or written.
pub fn os(error: impl Display, source: &io::Error) -> PyErr {
    let message = error.to_string();
    match source.kind() {
        ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        ErrorKind::PermissionDenied => PyPermissionError::new_err(message),
        _ => PyOSError::new_err(message),
    }
}

/// A file that cannot be read, or a value in it that is not allowed.
pub fn file(error: FileError) -> PyErr {
    match &error {
        FileError::Read { source, .. } | FileError::Named { source, .. } => os(&error, source),
        FileError::Syntax { .. } | FileError::Value { .. } => value(error),
    }
}

/// A memory that cannot be opened.
pub fn open(error: OpenError) -> PyErr {
    match &error {
        OpenError::Read { source, .. } => os(&error, source),
        _ => value(error),
    }
}

/// A memory that cannot be written.
pub fn write(error: WriteError) -> PyErr {
    match &error {
        WriteError::Write { source, .. } => os(&error, source),
        _ => value(error),
    }
}

/// A recording that cannot be read.
pub fn read(error: ReadError) -> PyErr {
    match &error {
        ReadError::Read { source, .. } => os(&error, source),
        _ => value(error),
    }
}
