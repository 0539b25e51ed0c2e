//! The system's allocator, counting the calls of each thread (why and how: `README.md`).

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The counting allocator; becomes the program's with `#[global_allocator]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Meter;

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

/// Allocations, reallocations and releases by the calling thread so far; zero for ever where
/// [`Meter`] is not the program's allocator.
pub fn calls() -> u64 {
    CALLS.try_with(Cell::get).unwrap_or(0)
}

fn count() {
    // A thread that is ending has no counter any more, and needs none.
    let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every call goes to the system's allocator unchanged; counting touches a thread-local cell
// without a destructor, which does not allocate.
unsafe impl GlobalAlloc for Meter {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[global_allocator]
    static METER: Meter = Meter;

    #[test]
    fn allocation_and_release_count_in_their_thread_only() {
        let before = calls();
        let boxed = std::hint::black_box(Box::new(1));
        assert_eq!(calls() - before, 1);
        drop(boxed);
        assert_eq!(calls() - before, 2);
        let elsewhere = std::thread::spawn(|| {
            let before = calls();
            drop(std::hint::black_box(vec![0_u8; 100]));
            calls() - before
        });
        assert_eq!(elsewhere.join().ok(), Some(2));
    }
}
