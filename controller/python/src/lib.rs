//! The module `vpc` for Python: the law, the memory, the emulated cameras and the table, over the
//! same crates as `vpcd` and `cargo table`. No mathematics of its own: it converts arrays and
//! errors, and lets other threads of Python run.

mod array;
mod camera;
mod controller;
mod error;
mod flags;
mod foreseen;
mod law;
mod memory;
mod panda;
mod records;
mod run;
mod scene;
mod step;

/// What is written in Rust; the package `vpc` gives it its names.
#[pyo3::pymodule(name = "_vpc")]
mod module {
    #[pymodule_export]
    use crate::camera::FreeCamera;
    #[pymodule_export]
    use crate::controller::Controller;
    #[pymodule_export]
    use crate::foreseen::Foreseen;
    #[pymodule_export]
    use crate::memory::{Memory, Recall};
    #[pymodule_export]
    use crate::panda::Panda;
    #[pymodule_export]
    use crate::records::records;
    #[pymodule_export]
    use crate::run::run;
    #[pymodule_export]
    use crate::scene::{Scene, read_starts};
    #[pymodule_export]
    use crate::step::Step;

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
