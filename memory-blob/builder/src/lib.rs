//! To come.

pub mod mixture;
