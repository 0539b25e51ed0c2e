//! Why a scene file was refused.

/// Why a scene file was refused.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file could not be read.
    #[error("{path}: cannot read the scene: {source}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's reason; as a raw name, because the message has it and a chain of causes would
        /// tell it twice.
        r#source: std::io::Error,
    },
    /// It is not the TOML of a scene: wrong syntax, an unknown or missing key, a wrong type.
    #[error("{path}: {message}")]
    Syntax {
        /// The file.
        path: String,
        /// Line, column, and what was expected.
        message: String,
    },
    /// A value is out of its range.
    #[error("{path}: {key} = {value}; allowed: {allowed}")]
    Value {
        /// The file.
        path: String,
        /// The key, with its table.
        key: String,
        /// What was found.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A mask is none.
    #[error("{path}: {key} = \"{mask}\": {reason}")]
    Mask {
        /// The file.
        path: String,
        /// The key, with its table.
        key: String,
        /// The image, from where it was looked for.
        mask: String,
        /// What is wrong with it and what is allowed.
        reason: String,
    },
}
