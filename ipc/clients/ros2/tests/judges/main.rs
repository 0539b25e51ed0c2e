//! `vpc-ros2` beside DDS implementations and a client library that nobody here wrote, which play
//! camera and robot.

mod attack;
mod bench;
mod dead_man;
mod launch;
mod policy;
mod refusals;
mod restarts;
mod starts;
mod stop;
