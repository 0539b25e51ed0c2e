//! To come.

pub mod lbfgs;
pub mod mixture;
pub mod regression;
