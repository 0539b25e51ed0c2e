//! What all programs share: command line, log, signals, exit codes, real-time scheduling, files
//! that are replaced atomically, quantiles, and the rule for kernels.

#![deny(unsafe_code)]

#[cfg(feature = "process")]
mod exit;
#[cfg(feature = "process")]
mod fifo;
pub mod kernel;
mod quantile;
mod replace;
#[cfg(feature = "process")]
mod sibling;
#[cfg(feature = "process")]
mod signals;
#[cfg(feature = "process")]
mod start;

#[cfg(feature = "process")]
pub use exit::Exit;
#[cfg(feature = "process")]
pub use fifo::take_fifo;
pub use quantile::quantile;
pub use replace::{publish, replace};
#[cfg(feature = "process")]
pub use sibling::sibling;
#[cfg(feature = "process")]
pub use signals::{
    StartUp, end_within, ending, ignore, is_ignored, set_on, stop_on_signals,
    stop_or_end_on_signals,
};
#[cfg(feature = "process")]
pub use start::{arguments, begin, log, notify};
