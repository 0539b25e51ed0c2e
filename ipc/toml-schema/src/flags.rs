//! Flags of a command line by clap that are keys of a configuration file, too.

use std::path::Path;

use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory, FromArgMatches};
use serde::Serialize;
use toml::Table;

use crate::document::{COMMAND_LINE, Document, FileError};

fn refused(error: &dyn ToString) -> FileError {
    FileError::Syntax {
        path: COMMAND_LINE.to_owned(),
        message: error.to_string(),
    }
}

/// The arguments of a command line.
///
/// # Errors
/// [`FileError::Syntax`]: clap refuses them.
pub fn arguments<A: FromArgMatches>(matches: &ArgMatches) -> Result<A, FileError> {
    A::from_arg_matches(matches).map_err(|error| refused(&error))
}

impl Document {
    /// Reads a file, and lays the flags of `A` over it that were given: those whose names are keys.
    /// The `paths` among the keys are relative to the file.
    ///
    /// # Errors
    /// [`FileError`] if the file cannot be read or is not TOML.
    pub fn with_flags<A: CommandFactory>(
        file: Option<&Path>,
        paths: &[&str],
        keys: &impl Serialize,
        matches: &ArgMatches,
    ) -> Result<Self, FileError> {
        let flags = Table::try_from(keys).map_err(|error| refused(&error))?;
        let mut document = Self::read(file)?;
        let directory = file.and_then(Path::parent);
        document.relative_to(directory.unwrap_or(Path::new("")), paths);
        for argument in A::command().get_arguments() {
            let key = argument.get_id().as_str();
            let flag = argument.get_long().unwrap_or_default();
            // A flag that was not given has its default, which must not win over the file.
            if let Some(value) = flags.get(key)
                && matches.value_source(key) == Some(ValueSource::CommandLine)
            {
                document.set(key, &format!("--{flag}"), Some(value.clone()));
            }
        }
        Ok(document)
    }
}
