//! The promises of a recording, over real shared memory. One executable: each that links iceoryx2
//! costs up to a minute of build. A recorder that is killed is this same executable, started again.

mod fixture;
mod interrupted;
mod losses;
mod masked;
mod values;
