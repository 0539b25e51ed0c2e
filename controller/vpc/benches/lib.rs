//! The bench is `step.rs`.
