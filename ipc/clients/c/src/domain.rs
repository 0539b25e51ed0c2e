//! Joining and leaving.

use std::ffi::{OsStr, c_char};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use crate::boundary::{self, Handle};
use crate::status::Status;

/// Membership of a domain.
pub type Domain = Handle<ipc::Domain>;

/// Joins the domain in `directory`, which is created if it is missing; NULL: /tmp/vpc-UID. The
/// handle and everything opened with it stay in this thread.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_domain_join(
    directory: *const c_char,
    out: *mut *mut Domain,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for NULL or a string that ends in NUL.
        let domain = ipc::Domain::join(&unsafe { named(directory) })?;
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, domain) }
    })
}

/// The directory of this name; NULL: the default.
///
/// # Safety
/// `directory` is NULL or a string that ends in NUL.
pub unsafe fn named(directory: *const c_char) -> PathBuf {
    // SAFETY: as above.
    match unsafe { boundary::text(directory) } {
        Some(text) => Path::new(OsStr::from_bytes(text.to_bytes())).to_owned(),
        None => ipc::default_directory(),
    }
}

/// Leaves the domain once the last port opened with it is closed. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_domain_leave(domain: *mut Domain) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(domain, "domain") })
}

/// CLOCK_MONOTONIC in ns: the clock of all stamps.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_now_ns() -> u64 {
    ipc::now_ns()
}
