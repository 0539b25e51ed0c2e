//! The contract of the crate `ipc` for C: a shared library and `include/vpc.h`.
//!
//! Everything that the header declares is here, a file for each kind of handle. The header is generated: messages and
//! codes from the sources of `ipc`, functions from these files, sizes and offsets from the compiler (`tests/client`).
//! Tour, rules and decisions: `README.md` beside this crate.
//!
//! Rust programs use `ipc`.

// What a caller owes is the same for every function, and stands once: at the head of the header and in the README.
#![allow(clippy::missing_safety_doc)]

pub mod boundary;
pub mod camera;
pub mod domain;
pub mod names;
pub mod observer;
pub mod operator;
pub mod status;
