//! Opens a memory and says what is in it: `cargo run -p memory-blob --example check -- FILE`.
//! Unlike `vpc-memory verify` it needs this package alone: for those who write such files from
//! another language.

use std::process::ExitCode;

use memory_blob::{MemoryFile, Report};

fn main() -> ExitCode {
    let Some(path) = std::env::args_os().nth(1) else {
        eprintln!("usage: check FILE");
        return ExitCode::from(2);
    };
    match MemoryFile::open(path.as_ref(), None) {
        Ok(file) => {
            print!("{}", Report::of(&file));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
