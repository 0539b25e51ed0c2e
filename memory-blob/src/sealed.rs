//! Memory that no process can change: a sealed memory file (memfd), mapped read-only.

use std::fs::File;
use std::io::{self, Write};

use memmap2::Mmap;
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, memfd_create};

/// Copies some bytes into sealed memory. The file they came from may then be truncated or changed:
/// a mapping of that file would fault the control loop, this one cannot.
#[allow(unsafe_code)] // mapping a file is unsafe because the file may change; this one is sealed against it
pub(crate) fn seal(bytes: &[u8]) -> io::Result<Mmap> {
    let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
    let mut file = File::from(memfd_create("vpc-memory", flags)?);
    file.write_all(bytes)?;
    fcntl_add_seals(
        &file,
        SealFlags::SHRINK | SealFlags::GROW | SealFlags::WRITE | SealFlags::SEAL,
    )?;
    // SAFETY: the file is sealed against writing and resizing, so the mapped bytes never change and
    // never vanish.
    unsafe { Mmap::map(&file) }
}
