//! Work for the processors that disturbs whoever has deadlines: arithmetic, caches, page tables,
//! files and the page cache, timers and switches between threads.

use std::fs::File;
use std::hint::black_box;
use std::io::{Seek, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Scope;
use std::time::Duration;

/// Bytes of the memory and of the file.
const BYTES: usize = 16 << 20;
/// Bytes of a page of memory.
const PAGE: usize = 4096;
/// Threads that a timer wakes up every 50 us and a bit.
const TIMERS: usize = 4;

/// Works in threads of this scope until `done`; the file is in `directory`.
pub fn work<'a>(threads: &'a Scope<'a, '_>, directory: &'a Path, done: &'a AtomicBool) {
    let until_done = move |mut work: Box<dyn FnMut() + Send + 'a>| {
        threads.spawn(move || {
            while !done.load(Ordering::Relaxed) {
                work();
            }
        });
    };
    for _ in 0..2 {
        until_done(Box::new(arithmetic()));
    }
    until_done(Box::new(caches()));
    until_done(Box::new(pages));
    until_done(Box::new(files(&directory.join("load"))));
    for _ in 0..TIMERS {
        until_done(Box::new(|| std::thread::sleep(Duration::from_micros(50))));
    }
}

fn arithmetic() -> impl FnMut() {
    let mut x = 1.0_f64;
    move || {
        for _ in 0..10_000 {
            x = black_box(x).mul_add(1.000_001, 1e-9).sqrt();
        }
    }
}

/// Reads and writes lines of the cache all over a memory larger than the cache.
fn caches() -> impl FnMut() {
    let mut words = vec![0_u64; BYTES / 8];
    let mut at = 1_usize;
    move || {
        for _ in 0..10_000 {
            at = at.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            words[(at >> 20) % (BYTES / 8)] += 1;
        }
    }
}

/// Takes memory from the kernel, touches each page, and gives it back.
fn pages() {
    let mut memory = vec![0_u8; BYTES];
    for page in memory.iter_mut().step_by(PAGE) {
        *page = 1;
    }
    black_box(&memory);
}

/// Writes a file from its begin, reads it back, and empties it before the disk has it.
fn files(path: &Path) -> impl FnMut() + use<> {
    let mut file = File::create(path).unwrap();
    let reader = File::open(path).unwrap();
    let (mut block, mut written) = (vec![7_u8; 1 << 16], 0_u64);
    move || {
        file.write_all(&block).unwrap();
        written += block.len() as u64;
        reader.read_at(&mut block, written / 2).unwrap();
        if written >= BYTES as u64 {
            file.set_len(0).unwrap();
            file.rewind().unwrap();
            written = 0;
        }
    }
}

/// Ends threads, which look at the flag, when it is dropped: also when an assertion fails, for
/// whose scope waits.
pub struct EndOnDrop<'a>(pub &'a AtomicBool);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
