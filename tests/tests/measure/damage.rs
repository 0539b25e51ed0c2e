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

use crate::fixture::{PERIOD_NS, Stage, WAKE_NS, classes, is_still};
use crate::judge::in_time;
use crate::reference::Class;
use crate::sheet::Sheet;

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

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let mut ends = Vec::new();
    for round in 0..sheet.repeats(6, 100) {
        let what = format!("damage {round}");
        let damaged = sheet.round(&classes(), &what, || damage(round));
        if let Some((end, stood_ns)) = damaged {
            sheet.longest("the robot stands after", stood_ns, STANDS_NS);
            ends.push(end);
        }
    }
    let count = |end| ends.iter().filter(|found| **found == end).count();
    sheet.figure("went on", count(End::GoesOn) as f64, "");
    sheet.figure("sent zero and aborted", count(End::Aborted) as f64, "");
    sheet.figure("killed where they were", count(End::Killed) as f64, "");
    // Otherwise nothing was damaged that the loop reads.
    if count(End::Aborted) == 0 {
        sheet.lacks("no damage that the loop reads");
    }
}

fn segments() -> BTreeSet<PathBuf> {
    let files = std::fs::read_dir("/dev/shm").unwrap();
    let paths = files.map(|file| file.unwrap().path());
    // Other programs have directories there.
    paths.filter(|path| !path.is_dir()).collect()
}

/// An operator comes, and its memory is damaged: how the daemon took it, and how long after its last
/// command the robot stood, ns, if it ended.
fn damage(round: usize) -> anyhow::Result<(End, u64)> {
    let mut random = ChaCha8Rng::seed_from_u64(round as u64);
    let Stage {
        place,
        mut witness,
        daemon,
        mut camera,
    } = Stage::in_motion(round)?;
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
    let (mut end, mut stood_ns) = (End::GoesOn, 0);
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
        let stands_ns = witness.until_it_stands(last_ns, &mut camera);
        let class = Class::of_vpcd();
        stood_ns = in_time("the robot stands", class, last_ns, stands_ns, STANDS_NS)?;
    }
    theirs
        .iter()
        .for_each(|path| _ = std::fs::remove_file(path));
    Ok((end, stood_ns))
}
