//! The promises of a recording, over real shared memory. A recorder that is killed or hangs is
//! `vpcctl record`, in the tests of `vpcctl`; others who read a recording are in the target `judges`.

mod fixture;
mod losses;
mod masked;
mod values;
