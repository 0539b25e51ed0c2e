//! The stack of the loop's thread: touched before the loop begins, so that no cycle faults a page,
//! and measured when the loop has ended.

use std::mem::MaybeUninit;

use rustix::process::{Resource, getrlimit};

/// Bytes touched below the caller: eight times what a cycle with a memory was seen to use (48 KiB
/// without full optimization; `stack_used_bytes` of `vpcd --report`).
pub const SIZE: usize = 384 << 10;
/// A page, the unit of the measurement.
const PAGE: usize = 4096;
/// What untouched stack is painted with.
const PAINT: u8 = 0xA5;
/// Bytes of a page that may differ from the paint though no frame lies there: large frames probe
/// each page.
const PROBES: usize = 32;

/// Least limit on the stack, bytes, with which the daemon begins: what is touched, and as much for
/// reading its files.
const LEAST: u64 = 1 << 20;

/// Checks the limit on the stack: beyond it the kernel would end the daemon without a word.
///
/// # Errors
/// What is found, and what is allowed.
pub fn check() -> Result<(), String> {
    match getrlimit(Resource::Stack).current {
        Some(found) if found < LEAST => Err(format!(
            "a stack of at most {} KiB; allowed: {} KiB and more (ulimit -s, or LimitSTACK= in a unit)",
            found >> 10,
            LEAST >> 10
        )),
        _ => Ok(()),
    }
}

type Area = [MaybeUninit<u8>; SIZE];

/// Touches and paints [`SIZE`] bytes of stack below the caller.
#[allow(unsafe_code)]
#[inline(never)]
pub fn prepare() {
    let mut area: Area = [const { MaybeUninit::uninit() }; SIZE];
    let start = area.as_mut_ptr();
    for i in 0..SIZE {
        // SAFETY: i is within the area. Volatile, because the write must happen though it is never
        // read.
        unsafe { start.add(i).write_volatile(MaybeUninit::new(PAINT)) };
    }
}

/// Bytes of the painted stack that were used since, in whole pages; called from the same depth as
/// [`prepare`].
#[allow(unsafe_code)]
#[inline(never)]
pub fn used() -> usize {
    let mut area: Area = [const { MaybeUninit::uninit() }; SIZE];
    let start = area.as_mut_ptr();
    // SAFETY: no instruction; but for the compiler the block may have written the area, with what
    // was there before.
    unsafe { std::arch::asm!("/* {0} */", in(reg) start) };
    let is_used = |page: usize| {
        let changed = (0..PAGE).filter(|i| {
            // SAFETY: within the area, which the block above counts as having written.
            let byte = unsafe { start.add(page * PAGE + i).read_volatile().assume_init() };
            byte != PAINT
        });
        changed.count() > PROBES
    };
    // The stack grows downwards: the first page of the area is the deepest.
    let pages = SIZE / PAGE;
    let deepest = (0..pages).find(|page| is_used(*page)).unwrap_or(pages);
    (pages - deepest) * PAGE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(never)]
    fn deep(size: usize) -> u8 {
        let mut frame = [0_u8; 64 << 10];
        frame[..size].fill(7);
        std::hint::black_box(&frame)[size / 2]
    }

    #[test]
    fn the_depth_that_was_used_is_seen() {
        prepare();
        let shallow = used();
        prepare();
        assert_eq!(deep(64 << 10), 7);
        let grown = used();
        assert!(shallow < 32 << 10, "{shallow}");
        assert!((64 << 10..128 << 10).contains(&grown), "{grown}");
    }
}
