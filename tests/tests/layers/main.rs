//! The walls between the parts of the project, as ARCHITECTURE.md names them, and the commands by
//! which it says that they are tested.

mod circles;
mod crates;
mod invariants;
mod order;
