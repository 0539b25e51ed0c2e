//! The whole robot, stepped by hand: what it accepts, what trips it, how it stops and recovers.

mod communication;
mod drift;
mod reflexes;
mod rig;
mod staircase;
mod stops;
