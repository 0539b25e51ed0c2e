//! `vpcctl`: see the crate of that name.

use std::process::ExitCode;

fn main() -> ExitCode {
    program::begin();
    vpcctl::main(std::env::args_os())
}
