//! The contract beside programs of others: the client in Python with its libraries, and `strace`,
//! which kills a peer at each call of its start-up.

mod killed;
#[path = "../peers/mod.rs"]
mod peers;
mod python;
