//! Programs in C play their parts against this crate's peers in domains of their own. One
//! executable: each that links iceoryx2 takes up to a minute to build.

mod installed;
mod library;
mod process;
