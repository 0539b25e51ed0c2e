//! `vpc-panda` as a process, and another client, with the emulated robot behind the vendor's
//! interface, in lockstep: nothing is late.

mod configuration;
mod first_motion;
mod lockstep;
mod motion;
mod robot;
