#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod errors;
pub mod message;
pub mod server;
pub mod wire;

pub use message::{Answer, Command, Controller, Generator, Load, Request, State};
pub use server::{Event, Server, Ticket};
pub use wire::Version;
