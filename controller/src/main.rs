//! `vpcd`: see the crate `controller`.

use std::process::ExitCode;

/// Counts the calls of each thread; the loop's are in the telemetry.
#[global_allocator]
static ALLOCATOR: heap_meter::Meter = heap_meter::Meter;

fn main() -> ExitCode {
    controller::daemon::main(std::env::args_os())
}
