//! Why a configuration was refused.

use super::COMMAND_LINE;
use crate::exit::Exit;

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{path}: cannot read the configuration: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// It is not the TOML of a configuration: wrong syntax, an unknown key, a wrong type.
    #[error("{path}: {message}")]
    Syntax {
        /// The file.
        path: String,
        /// Line, column, and what was expected.
        message: String,
    },
    /// A key without a default is missing.
    #[error("{path}: {key} is missing; allowed: {allowed}")]
    Missing {
        /// The file, or the command line.
        path: String,
        /// The key.
        key: &'static str,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A value is out of its range.
    #[error("{path}: {key} = {value}; allowed: {allowed}")]
    Value {
        /// The file, or the command line.
        path: String,
        /// The key with its table, or the flag.
        key: String,
        /// What was found.
        value: String,
        /// What is allowed.
        allowed: String,
    },
}

impl ConfigError {
    /// The exit code that it asks for.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Read { .. } => Exit::NoInput,
            Self::Value { path, .. } | Self::Missing { path, .. } if path == COMMAND_LINE => {
                Exit::Usage
            }
            _ => Exit::Config,
        }
    }
}
