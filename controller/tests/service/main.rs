//! The daemon under a service manager: what it says to it, what the units promise, and a real
//! systemd in a namespace. This executable does not link iceoryx2: it meets the daemon as a
//! process.

mod arms;
mod fixture;
mod instance;
mod machine;
mod namespace;
mod notify;
mod package;
mod permission;
mod reload;
mod signal;
mod unit;
