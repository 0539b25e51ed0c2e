//! Other processes of these tests: `examples/peer.rs`.

use std::process::{Command, Stdio};

use messages::Features;
use testkit::{Place, Running, program};

/// The corners of a square.
pub fn square(offset: f64) -> Features {
    let (a, b) = (100.0 + offset, 200.0 + offset);
    Features::new(&[[a, a], [b, a], [b, b], [a, b]], ipc::now_ns())
}

/// A peer that plays `role` in the domain of a place; `tool` is a command before it.
pub fn peer(role: &str, place: &Place, tool: Option<Command>) -> Command {
    let this = program("examples/peer");
    let mut peer = tool.map_or_else(
        || testkit::command(&this),
        |mut tool| {
            tool.arg(&this);
            tool
        },
    );
    peer.arg(place.domain()).args(role.split(' '));
    peer.stdout(Stdio::piped());
    peer
}

/// Starts a peer and waits until its ports are open.
pub fn working(role: &str, place: &Place) -> Running {
    let mut peer = Running::start(peer(role, place, None));
    peer.line("working");
    peer
}
