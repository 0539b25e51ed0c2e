//! `vpcd`: see the crate `controller`.

use std::process::ExitCode;

fn main() -> ExitCode {
    controller::daemon::main(std::env::args_os())
}
