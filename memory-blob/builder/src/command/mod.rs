//! Subcommands: building, merging, and those that help with a task of one's own.

pub mod build;
pub mod mask;
pub mod new;
pub mod preview;
mod seen;
mod workspace;
