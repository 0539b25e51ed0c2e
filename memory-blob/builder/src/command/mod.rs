//! The subcommands that help with a task of one's own.

pub mod mask;
pub mod new;
pub mod preview;
