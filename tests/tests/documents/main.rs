//! The documents keep their word: every command of the READMEs runs, the reference of the configuration is the code's,
//! and the messages of the troubleshooting tables are the programs' own.

mod call;
mod markdown;
mod readme;
mod reference;
mod troubleshooting;
mod verdicts;

use std::path::Path;

/// The repository's root.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}
