//! The installed daemon, judged by systemd, dpkg and lintian, most of it as root. `cargo xtask
//! judges` runs them.

mod arms;
#[path = "../service/frozen.rs"]
mod frozen;
mod machine;
mod namespace;
mod package;
mod permission;
mod reload;
#[expect(dead_code, reason = "`cargo test` uses the rest")]
#[path = "../service/fixture.rs"]
mod service;
mod spin;
mod unit;

/// What the tests share.
mod fixture {
    pub use crate::frozen::{Frozen, thread};
    pub use crate::service::{
        Manager, Place, ended, eventually, files, installed, root, scene_file, units, vpcd,
    };
    pub use crate::spin::spin;
    pub use testkit::{are_installed, is_root, not_run};
}
