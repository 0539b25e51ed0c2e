//! `vpcd`: see the crate `controller`.

use std::process::ExitCode;

/// Counts the calls of each thread: telemetry tells those of the loop.
#[global_allocator]
static ALLOCATOR: heap_meter::Meter = heap_meter::Meter;

fn main() -> ExitCode {
    controller::daemon::main(std::env::args_os())
}
