//! What the programs `demo` and `table` and the system tests share: closed-loop runs against an
//! exact camera, and their statistics.

#![forbid(unsafe_code)]

pub mod benchmark;
pub mod children;
pub mod column;
pub mod document;
pub mod edge;
pub mod external;
pub mod fci_table;
pub mod film;
pub mod flags;
pub mod flaw;
pub mod joint_task;
pub mod laboratory;
pub mod pictures;
pub mod processes;
pub mod robot;
pub mod robot_table;
pub mod row;
pub mod run;
pub mod simulated;
pub mod source;
pub mod spec;
mod statistics;
pub mod steering;

/// The arguments of this process. The aliases in `.cargo/config.toml` end with `--`, so that `cargo
/// demo --help` asks the program; who writes `cargo demo -- --help`, as everywhere else, gets the
/// same.
pub fn arguments() -> impl Iterator<Item = std::ffi::OsString> {
    // Neither program takes words without a flag, which a separator would be for.
    std::env::args_os().filter(|argument| argument != "--")
}

/// The root of the repository.
pub fn root() -> &'static std::path::Path {
    std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}
