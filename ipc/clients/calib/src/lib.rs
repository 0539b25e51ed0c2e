#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod arguments;
pub mod camera;
pub mod charuco;
pub mod chessboard;
pub mod command;
pub mod detector;
pub mod hand_eye;
pub mod intrinsics;
pub mod latency;
pub mod layout;
pub mod live;
pub mod motion;
pub mod output;
pub mod picture;
pub mod pose;
pub mod pose_file;
pub mod pose_fit;
pub mod saddle;
pub mod sheet;
pub mod still;
pub mod target;
pub mod trajectory;
pub mod verdict;
pub mod view;
