//! The daemon under a service manager: what it says to it, its signals, and the files that are
//! installed. This executable does not link iceoryx2: it meets the daemon as a process. The target
//! `judges` has a real systemd.

mod fixture;
mod frozen;
mod notify;
mod permission;
mod reload;
mod signal;
mod unit;
