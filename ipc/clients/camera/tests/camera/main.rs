//! From rendered frames to features, in process and as processes.

mod clutter;
mod drawing;
mod hidden;
mod pattern;
mod poses;
mod process;
