//! A writer of log lines that drops and counts what it cannot write. An unread pipe or a full disk
//! must delay neither the ordinary thread nor the end of the daemon.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use tracing_subscriber::fmt::MakeWriter;

/// Lines that wait for being written.
const QUEUE: usize = 1024;
/// Longest wait for the lines that are left when the daemon ends.
const PATIENCE: Duration = Duration::from_millis(100);

/// Hands lines to a thread of its own, which may wait for ever; a line too many is dropped and
/// counted.
#[derive(Clone, Debug)]
pub struct Lossy {
    lines: SyncSender<Vec<u8>>,
    counts: Arc<Counts>,
}

#[derive(Debug, Default)]
struct Counts {
    handed: AtomicU64,
    written: AtomicU64,
    lost: AtomicU64,
}

impl Lossy {
    /// A writer in front of `slow`.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn new(slow: impl Write + Send + 'static) -> io::Result<Self> {
        let (lines, queue) = sync_channel(QUEUE);
        let counts = Arc::new(Counts::default());
        let theirs = Arc::clone(&counts);
        std::thread::Builder::new()
            .name("log".to_owned())
            .spawn(move || write_out(slow, &queue, &theirs))?;
        Ok(Self { lines, counts })
    }

    /// Lines lost so far: dropped, or refused by the writer.
    pub fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Relaxed)
    }

    /// Waits for the lines on their way, a tenth of a second at most.
    pub fn flush(&self) {
        let start = Instant::now();
        let counts = &self.counts;
        while counts.written.load(Ordering::Acquire) < counts.handed.load(Ordering::Acquire)
            && start.elapsed() < PATIENCE
        {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// The thread. It ends with the last writer; a daemon that ends does not wait for it.
fn write_out(mut slow: impl Write, queue: &Receiver<Vec<u8>>, counts: &Counts) {
    let mut told = 0;
    loop {
        match queue.recv_timeout(Duration::from_secs(1)) {
            Ok(line) => {
                if slow.write_all(&line).and_then(|()| slow.flush()).is_err() {
                    counts.lost.fetch_add(1, Ordering::Relaxed);
                }
                counts.written.fetch_add(1, Ordering::Release);
            }
            Err(RecvTimeoutError::Timeout) => (),
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let lost = counts.lost.load(Ordering::Relaxed);
        if lost > told {
            let words = format!("vpcd: {} lines of the log lost\n", lost - told);
            if slow.write_all(words.as_bytes()).is_ok() {
                told = lost;
            }
        }
    }
}

/// One event of the log: sent as a whole when it is complete.
#[derive(Debug)]
pub struct Line<'a> {
    to: &'a Lossy,
    bytes: Vec<u8>,
}

impl Write for Line<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line<'_> {
    fn drop(&mut self) {
        let counts = &self.to.counts;
        let line = std::mem::take(&mut self.bytes);
        if self.to.lines.try_send(line).is_ok() {
            counts.handed.fetch_add(1, Ordering::Release);
        } else {
            counts.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl<'a> MakeWriter<'a> for Lossy {
    type Writer = Line<'a>;

    fn make_writer(&'a self) -> Line<'a> {
        Line {
            to: self,
            bytes: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::Sender;

    /// Passes on what is written; blocks for ever when it is not read.
    struct Pipe(SyncSender<Vec<u8>>);

    impl Write for Pipe {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.send(bytes.to_vec()).map_err(io::Error::other)?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn lines_arrive_whole_and_in_order() {
        let (to, from) = sync_channel(8);
        let lossy = Lossy::new(Pipe(to)).unwrap();
        for word in ["one", "two"] {
            let mut line = lossy.make_writer();
            write!(line, "{word}").unwrap();
            writeln!(line, " line").unwrap();
        }
        let lines = [from.recv().unwrap(), from.recv().unwrap()];
        assert_eq!(lines, [b"one line\n", b"two line\n"]);
        assert_eq!(lossy.lost(), 0);
    }

    #[test]
    fn nobody_waits_for_who_does_not_read() {
        let (to, _unread) = sync_channel(0);
        let lossy = Lossy::new(Pipe(to)).unwrap();
        for _ in 0..3 * QUEUE {
            writeln!(lossy.make_writer(), "line").unwrap();
        }
        lossy.flush();
        // The thread holds one line, the queue is full.
        assert!(lossy.lost() >= (2 * QUEUE - 1) as u64, "{}", lossy.lost());
    }

    #[test]
    fn what_a_full_disk_refuses_is_counted() {
        let lossy = Lossy::new(std::fs::File::create("/dev/full").unwrap()).unwrap();
        for _ in 0..5 {
            writeln!(lossy.make_writer(), "line").unwrap();
        }
        testkit::eventually("five losses", || (lossy.lost() == 5).then_some(()));
    }

    /// A writer that fails until it is mended.
    struct Moody(Sender<Vec<u8>>, Arc<AtomicU64>);

    impl Write for Moody {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.1.load(Ordering::Relaxed) > 0 {
                return Err(io::Error::other("no space"));
            }
            self.0.send(bytes.to_vec()).map_err(io::Error::other)?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn the_loss_is_told_as_soon_as_somebody_listens() {
        let (to, from) = std::sync::mpsc::channel();
        let full = Arc::new(AtomicU64::new(1));
        let lossy = Lossy::new(Moody(to, Arc::clone(&full))).unwrap();
        writeln!(lossy.make_writer(), "lost").unwrap();
        testkit::eventually("a loss", || (lossy.lost() == 1).then_some(()));
        full.store(0, Ordering::Relaxed);
        writeln!(lossy.make_writer(), "kept").unwrap();
        let mut words = from.recv().unwrap();
        words.extend(from.recv().unwrap());
        let words = String::from_utf8(words).unwrap();
        assert!(
            words.contains("kept\n") && words.contains("1 lines of the log lost\n"),
            "{words}"
        );
    }
}
