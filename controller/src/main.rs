//! `vpcd`: see the crate `controller`.

use std::process::ExitCode;

/// Counts the calls of each thread; the loop's are in the telemetry.
#[global_allocator]
static ALLOCATOR: heap_meter::Meter = heap_meter::Meter;

fn main() -> ExitCode {
    program::begin();
    if let Err(why) = controller::stack::check() {
        return program::Exit::Config.say("vpcd", why);
    }
    controller::daemon::main(std::env::args_os())
}
