//! What the programs `demo` and `table` and the system tests share: closed-loop runs against an exact camera, and
//! what they add up to.

pub mod pictures;
pub mod robot;
pub mod robot_table;
pub mod row;
pub mod run;
pub mod spec;
