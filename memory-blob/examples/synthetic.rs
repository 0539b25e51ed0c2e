//! Writes a memory of made-up trajectories without regression, for trying tools that read and refit
//! such files: `cargo run -p memory-blob --example synthetic -- OUT`.

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

use std::process::ExitCode;

fn main() -> ExitCode {
    let Some(path) = std::env::args_os().nth(1) else {
        eprintln!("usage: synthetic OUT");
        return ExitCode::from(2);
    };
    match synthetic::trajectories(2000, 1).write(path.as_ref()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
