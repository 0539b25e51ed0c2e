//! What `vpcctl` serves and prints, judged by Chromium, Prometheus, the clients of Foxglove and of
//! Prometheus, bash and terminals; and how it does under floods and a full `/dev/shm`. `cargo xtask
//! judges` runs them.

mod bash;
mod browser;
#[path = "../vpcctl/command.rs"]
mod command;
mod floods;
mod foxglove;
mod full;
mod metrics;
mod monitoring;
mod page;
#[expect(dead_code, reason = "`cargo test` uses the rest")]
#[path = "../vpcctl/server.rs"]
mod server;
#[path = "../vpcctl/stand_in.rs"]
mod stand_in;
mod watch;

use command::{painted_scene, stderr, stdout, vpcctl};
