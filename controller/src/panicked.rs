//! A panic in the loop's thread: its last word is zero, then it is told, then the process aborts,
//! so that it looks like the crash that it is.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::cycle::Cycle;
use crate::log::Log;
use crate::machine::Machine;
use crate::summary::Summary;

/// Longest wait for the flight record to be written.
const PATIENCE: Duration = Duration::from_secs(2);

/// What a panic in the loop's thread said.
#[derive(Clone, Debug, Default)]
pub struct Panicked(Arc<Mutex<String>>);

impl Panicked {
    /// Keeps the words of panics in the calling thread, the loop's, which must not write before the
    /// zero twist is out; those of other threads go to the log.
    pub fn in_this_thread() -> Self {
        let (panicked, looping) = (Self::default(), std::thread::current().id());
        let kept = panicked.clone();
        std::panic::set_hook(Box::new(move |panic| {
            if std::thread::current().id() == looping {
                *kept.0.lock().unwrap_or_else(PoisonError::into_inner) = panic.to_string();
            } else {
                tracing::error!("{panic}");
            }
        }));
        panicked
    }

    /// Tells it, lets the flight record be written, and aborts. The zero twist was sent.
    pub fn end(self, cycle: Cycle<'_, Machine>, recorder: JoinHandle<Summary>, log: Log) -> ! {
        // What panicked once may do so again while its ports close.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(cycle)));
        let words = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        tracing::error!("the loop panicked, and has sent the zero twist: {words}");
        let begin = Instant::now();
        while !recorder.is_finished() && begin.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(1));
        }
        drop(log);
        std::process::abort()
    }
}
