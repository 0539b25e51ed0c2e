#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod config;
mod datagrams;
pub mod diagnosis;
pub mod drive;
pub mod first_motion;
pub mod look;
pub mod robot;
pub mod steering;
