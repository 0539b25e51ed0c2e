//! Records a domain, with topics that Foxglove draws, or serves the same to Foxglove live, and
//! shows what was recorded. The crate `recording` reads and writes the files; its `README.md`
//! tells topics and decisions.
//!
//! - [`record()`] subscribes to a domain and writes what is published and what Foxglove draws,
//! - [`live::serve`] sends the same to Foxglove while it happens,
//! - [`plot()`] draws figures of a recording, [`Report`] says how long its cycles took.
#![forbid(unsafe_code)]

mod annotation;
mod foxglove_server;
mod joint_bars;
mod ledger;
pub mod live;
mod plot;
mod ports;
mod record;
mod recorder;
mod report;
mod scenery;
mod view_writer;
mod views;
mod world;

pub use ledger::{Account, Ledger, Notice};
pub use plot::{Films, PlotError, plot};
pub use record::{Options, RecordError, record};
pub use recorder::Recorder;
pub use report::{Report, StageTimes};
pub use views::Viewed;
