//! `replay`: hands a recording to the program that knows the law. This command stays a client of the contract: another
//! controller brings a `vpc-replay` of its own.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use clap::Args;

use crate::exit::{Exit, Failure};

/// The program.
const PROGRAM: &str = "vpc-replay";

/// `replay`.
#[derive(Clone, Debug, Args)]
pub struct ReplayArguments {
    /// The recording, then flags of vpc-replay (--memory FILE, --config FILE, ...): see `vpc-replay --help`.
    #[arg(
        value_name = "FILE.mcap",
        required = true,
        trailing_var_arg = true,
        allow_hyphen_values = true
    )]
    pub words: Vec<OsString>,
}

/// Becomes the program; returns where that is not possible only.
pub fn run(arguments: &ReplayArguments) -> Failure {
    let program = beside().unwrap_or_else(|| PathBuf::from(PROGRAM));
    let source = Command::new(&program).args(&arguments.words).exec();
    let program = program.display();
    let message = format!("{program}: cannot run: {source}; allowed: beside vpcctl, or in PATH");
    Failure::new(Exit::NoInput, message)
}

/// The program in the directory of this one; else it is looked for in PATH.
fn beside() -> Option<PathBuf> {
    let program = std::env::current_exe().ok()?.with_file_name(PROGRAM);
    program.is_file().then_some(program)
}
