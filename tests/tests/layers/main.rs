//! The walls between the parts of the project, as ARCHITECTURE.md names them.

mod circles;
mod crates;
