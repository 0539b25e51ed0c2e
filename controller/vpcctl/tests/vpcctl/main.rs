//! The command, in this process or as one of its own, against a stand-in for the daemon: same ports,
//! same contract, no law. The target `judges` has browsers, Prometheus and the clients of others.

mod check_bridge;
mod command;
mod doctor;
mod foxglove;
mod metrics;
mod recorder;
mod recordings;
mod recover;
mod requests;
mod serve;
mod server;
mod smoke;
mod stand_in;
mod status;
mod teach;

use command::{painted_scene, stderr, stdout, vpcctl};
