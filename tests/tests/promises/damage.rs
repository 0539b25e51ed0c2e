//! Damaged shared memory: random bytes in the segments of a peer, which the loop reads. It may go
//! on, or end; but it ends by an abort after a zero twist, or by a signal of the processor, and the
//! robot stands within the dead man's time either way.

use std::collections::BTreeSet;
use std::fs::OpenOptions;
use std::mem::ManuallyDrop;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use ipc::{Domain, OperatorPorts};
use messages::{Action, Request, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fixture::{PERIOD_NS, Stage, WAKE_NS, is_still, repeats, tell, turn};
use crate::stall::{fairly, in_time};

/// Longest time from the last command to standstill, ns.
const STANDS_NS: u64 = 100_000_000 + WAKE_NS;

/// How the daemon took it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    GoesOn,
    /// The loop panicked, and sent zero.
    Aborted,
    /// The processor, or a check of the debug build, ended it.
    Killed,
}

#[test]
fn damaged_memory_of_a_peer_ends_in_standstill() {
    let _turn = turn();
    let mut ends = Vec::new();
    for round in 0..repeats("damaged memories", 6, 100) {
        ends.push(fairly(&format!("damage {round}"), || damage(round)));
    }
    let count = |end| ends.iter().filter(|found| **found == end).count();
    tell(format!(
        "damaged memory: {} went on, {} sent zero and aborted, {} were killed where they were",
        count(End::GoesOn),
        count(End::Aborted),
        count(End::Killed)
    ));
    // Otherwise nothing was damaged that the loop reads.
    assert!(count(End::Aborted) > 0, "{ends:?}");
}

fn segments() -> BTreeSet<PathBuf> {
    let files = std::fs::read_dir("/dev/shm").unwrap();
    files.map(|file| file.unwrap().path()).collect()
}

/// An operator comes, and its memory is damaged.
fn damage(round: usize) -> anyhow::Result<End> {
    let mut random = ChaCha8Rng::seed_from_u64(round as u64);
    let Stage {
        place,
        mut witness,
        daemon,
        mut camera,
    } = Stage::in_motion(round);
    let before = segments();
    // Never dropped: to leave in order, this process would read what it damages.
    let domain = ManuallyDrop::new(Domain::join(&place.domain())?);
    let mut operator = ManuallyDrop::new(OperatorPorts::open(&domain)?);
    let status = Request::new(random.random(), Action::Status);
    operator.ask(&status, Duration::from_secs(2))?;
    let status = Request::new(random.random(), Action::Status);
    operator.requests.publish(&status)?;
    let mut commands = witness.commands();
    let theirs: Vec<_> = segments().difference(&before).cloned().collect();
    assert!(!theirs.is_empty());
    // Random bytes in one of its files, from some place on; each third time from the one where the
    // queue of its requests says where the next one is.
    let connections = theirs
        .iter()
        .filter(|path| path.extension() == Some("connection".as_ref()));
    let length = |path: &PathBuf| std::fs::metadata(path).map_or(0, |found| found.len());
    let longest = connections
        .max_by_key(|path| length(path))
        .context("no connection")?;
    let (path, from) = match round % 3 {
        0 => (longest, length(longest) / 4),
        _ => {
            let path = &theirs[random.random_range(0..theirs.len())];
            (path, random.random_range(0..length(path)))
        }
    };
    let file = OpenOptions::new().write(true).open(path)?;
    let length = length(path);
    let mut bytes = vec![0; (length - from) as usize];
    random.fill(&mut bytes[..]);
    file.write_all_at(&bytes, from)?;
    std::thread::sleep(Duration::from_nanos(10 * PERIOD_NS));
    commands.extend(witness.commands());
    let mut end = End::GoesOn;
    let mut daemon = daemon;
    if !daemon.is_running() {
        let last = commands.last().expect("a command");
        let ended = daemon.ended();
        // The checks of the debug build abort where they are; those of no other build do.
        let is_checked = ended.stderr.contains("non-unwinding panic");
        end = match ended.signal {
            Some(libc::SIGABRT) if !is_checked => End::Aborted,
            Some(libc::SIGABRT) => End::Killed,
            Some(libc::SIGSEGV | libc::SIGBUS) => End::Killed,
            _ => panic!("{ended:?}"),
        };
        if end == End::Aborted {
            assert!(is_still(last), "{last:?}: {}", ended.stderr);
            assert_eq!(last.state(), Some(TwistState::Stopped));
            assert!(ended.stderr.contains("the loop panicked"), "{ended:?}");
        }
        let last_ns = last.stamp.published_ns;
        if let Some(stands_ns) = witness.until_it_stands(last_ns, &mut camera) {
            in_time("the robot stands", last_ns, stands_ns, STANDS_NS)?;
        }
    }
    theirs
        .iter()
        .for_each(|path| _ = std::fs::remove_file(path));
    Ok(end)
}
