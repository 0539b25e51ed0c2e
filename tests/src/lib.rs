//! What the program `vpc-lab`, the module for Python and the system tests share: closed-loop runs
//! against an exact camera, and their statistics.

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
pub mod results;
pub mod robot;
pub mod robot_table;
pub mod row;
pub mod run;
pub mod simulated;
pub mod source;
pub mod spec;
mod statistics;
pub mod steering;

/// The root of the repository.
pub fn root() -> &'static std::path::Path {
    std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}
