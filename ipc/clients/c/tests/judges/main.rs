//! The library in C beside programs of others: valgrind, which checks each access to memory, CMake,
//! Debian's tools.

mod installed;
mod process;
#[path = "../client/program.rs"]
mod program;
