//! Bars of time, and what missed them.
//!
//! Whoever misses a bar says what it was, and between which instants. Whether the machine was to
//! blame the reference tells (`sheet`).

use std::fmt;
use std::panic::resume_unwind;
use std::time::Duration;

use ipc::now_ns;

use crate::reference::{Class, Lateness};

/// How long to wait for anything that is expected to happen, on a loaded machine.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// Lateness of a wake-up that is the machine's, not the program's, ns. Idle, SCHED_FIFO: 0.2 ms.
pub const WAKE_NS: u64 = 3_000_000;

/// A bar of time that was missed.
#[derive(Debug)]
pub struct Miss {
    what: String,
    /// Of the slowest participant.
    class: Class,
    from_ns: u64,
    to_ns: u64,
    /// The bar of what is a duration; of what is none, the reference must not have been late for
    /// [`WAKE_NS`] at once.
    bar_ns: Option<u64>,
}

impl Miss {
    /// Something that a late machine may cause, and that is no duration, seen between two instants.
    pub fn upset(what: impl Into<String>, class: Class, from_ns: u64, to_ns: u64) -> Self {
        let what = what.into();
        Self {
            what,
            class,
            from_ns,
            to_ns,
            bar_ns: None,
        }
    }

    /// Nothing, where it is so; else that it is not, as a late machine may cause.
    pub fn unless(
        is_so: bool,
        what: impl FnOnce() -> String,
        class: Class,
        from_ns: u64,
    ) -> Result<(), Self> {
        match is_so {
            true => Ok(()),
            false => Err(Self::upset(what(), class, from_ns, now_ns())),
        }
    }

    /// Whether the machine was late enough to have caused it.
    pub fn is_the_machines(&self, seen: &Lateness) -> bool {
        match self.bar_ns {
            Some(bar_ns) => self.to_ns - self.from_ns <= bar_ns + self.late_ns(seen),
            None => self.late_ns(seen) > WAKE_NS,
        }
    }

    /// How late the reference was meanwhile, ns: all in all for a duration, at most for others.
    pub fn late_ns(&self, seen: &Lateness) -> u64 {
        let Self {
            class,
            from_ns,
            to_ns,
            ..
        } = *self;
        match self.bar_ns {
            Some(_) => seen.between(class, from_ns, to_ns),
            None => seen.longest_ns(class, from_ns, to_ns),
        }
    }
}

impl fmt::Display for Miss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |ns: u64| ns as f64 / 1e6;
        write!(f, "{}", self.what)?;
        match self.bar_ns {
            Some(bar_ns) => {
                let took_ns = self.to_ns - self.from_ns;
                write!(f, " after {:.1} ms, bar {:.1} ms", ms(took_ns), ms(bar_ns))
            }
            None => Ok(()),
        }
    }
}

impl std::error::Error for Miss {}

/// Why a round shows nothing, whatever the reference says.
#[derive(Debug)]
pub struct NotShown(pub String);

impl fmt::Display for NotShown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NotShown {}

/// How long something took, ns, if that was no longer than its bar; `from` and `to` are instants of
/// CLOCK_MONOTONIC, ns, and the class is that of the slowest participant.
pub fn in_time(
    what: &str,
    class: Class,
    from_ns: u64,
    to_ns: u64,
    bar_ns: u64,
) -> Result<u64, Miss> {
    let took_ns = to_ns - from_ns;
    match took_ns <= bar_ns {
        true => Ok(took_ns),
        false => Err(Miss {
            what: what.to_owned(),
            class,
            from_ns,
            to_ns,
            bar_ns: Some(bar_ns),
        }),
    }
}

/// Calls `attempt` every half millisecond until it returns `Some`. [`PATIENCE`] is a bar as any
/// other: where it is missed, the round ends, and is judged.
pub fn eventually<T>(what: &str, attempt: impl FnMut() -> Option<T>) -> T {
    let from_ns = now_ns();
    testkit::within(PATIENCE, attempt).unwrap_or_else(|| {
        let bar_ns = PATIENCE.as_nanos() as u64;
        give_up(Miss {
            what: what.to_owned(),
            class: Class::Ordinary,
            from_ns,
            to_ns: now_ns(),
            bar_ns: Some(bar_ns),
        })
    })
}

/// Ends the round with this, from anywhere in it.
pub fn give_up(why: impl Into<anyhow::Error>) -> ! {
    resume_unwind(Box::new(why.into()))
}
