//! Joining and leaving.

use std::ffi::{OsStr, c_char};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use crate::boundary::{self, Handle, Owner};
use crate::status::Status;

/// Membership of a domain.
pub struct Domain {
    pub(crate) domain: ipc::Domain,
    owner: Owner,
}

impl Handle for Domain {
    const NAME: &'static str = "domain";

    fn owner(&self) -> &Owner {
        &self.owner
    }
}

/// Joins the domain in `directory`, which is created where it is missing; NULL: /tmp/vpc-UID. The handle and what
/// is opened with it stay in this thread.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_domain_join(
    directory: *const c_char,
    out: *mut *mut Domain,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for NULL or a string that ends in NUL.
        let directory = match unsafe { boundary::text(directory) } {
            Some(text) => Path::new(OsStr::from_bytes(text.to_bytes())).to_owned(),
            None => ipc::default_directory(),
        };
        let domain = ipc::Domain::join(&directory)?;
        let owner = Owner::here();
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, Domain { domain, owner }) }
    })
}

/// Leaves the domain when the last port opened with it is closed, too. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_domain_leave(domain: *mut Domain) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(domain) })
}

/// CLOCK_MONOTONIC in ns: the clock of all stamps.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_now_ns() -> u64 {
    ipc::now_ns()
}
