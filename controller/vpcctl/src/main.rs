//! `vpcctl`: see the crate of that name.

use std::process::ExitCode;

fn main() -> ExitCode {
    vpcctl::main(std::env::args_os())
}
