//! A wall clock that jumps by hours while everything runs: nothing happens. Gaps of the monotonic
//! clock are in `hang.rs`, and by a clock moved by hand in the unit tests of
//! `controller/decision/src/supervisor.rs`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::ensure;
use messages::Hold;
use rustix::process::Signal;

use crate::fixture::{Place, Stage, not_run, turn};
use crate::stall::fairly;

/// Stands before the C library: every second the wall clock is some hours elsewhere.
const SHIM: &str = r#"
#define _GNU_SOURCE
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long jump(void) {
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now);
    return ((now.tv_sec * 7919) % 11 - 5) * 3600;
}
int clock_gettime(clockid_t clock, struct timespec *now) {
    int result = syscall(SYS_clock_gettime, clock, now);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) now->tv_sec += jump();
    return result;
}
int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec real;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &real);
    now->tv_sec = real.tv_sec;
    now->tv_usec = real.tv_nsec / 1000;
    return 0;
}
time_t time(time_t *now) {
    struct timespec real;
    clock_gettime(CLOCK_REALTIME, &real);
    if (now) *now = real.tv_sec;
    return real.tv_sec;
}
"#;

/// The shim, compiled; why not.
fn shim(place: &Place) -> Result<PathBuf, String> {
    let source = place.file("shim.c", SHIM);
    let library = place.path("shim.so");
    let mut compile = testkit::command("cc");
    compile
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .arg(source);
    let output = compile.output().map_err(|error| format!("cc: {error}"))?;
    if output.status.success() {
        Ok(library)
    } else {
        Err(String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

#[test]
fn jumps_of_the_wall_clock_have_no_effect() {
    let _turn = turn();
    let place = Place::new();
    let library = match shim(&place) {
        Ok(library) => library,
        Err(reason) => return not_run("jumps of the wall clock", reason),
    };
    // The shim works: `date` shows hours that are not ours.
    let hours: Vec<_> = (0..3)
        .map(|_| {
            std::thread::sleep(Duration::from_millis(1001));
            let date = testkit::command("date")
                .arg("+%s")
                .env("LD_PRELOAD", &library)
                .output()
                .unwrap();
            let told: i64 = String::from_utf8(date.stdout)
                .unwrap()
                .trim()
                .parse()
                .unwrap();
            let now = std::time::SystemTime::now()
                .duration_since(std::time::UNIX_EPOCH)
                .unwrap();
            (told - now.as_secs() as i64) / 3600
        })
        .collect();
    assert!(hours.iter().any(|hour| *hour != hours[0]), "{hours:?}");

    fairly("jumps of the wall clock", || jump(&library));
}

/// A run under jumps: no cycle has a reason not to send the law's twist, and none is missed.
fn jump(library: &Path) -> anyhow::Result<()> {
    let Stage {
        place: _stage,
        mut witness,
        daemon,
        camera: _camera,
    } = Stage::with(0, &[("LD_PRELOAD", library)]);
    witness.records();
    std::thread::sleep(Duration::from_secs(3));
    let records = witness.records();
    ensure!(records.len() > 75, "{}", records.len());
    let missed = records[records.len() - 1].overruns - records[0].overruns;
    ensure!(missed == 0, "{missed} releases missed");
    // hw-sim ends when the goal is reached; until then no cycle had a reason not to send the law's
    // twist.
    let causes: Vec<_> = records
        .iter()
        .map(|record| record.hold())
        .take_while(|hold| !matches!(hold, Some(Hold::Stale | Hold::Lost)))
        .collect();
    ensure!(causes.len() > 15, "{causes:?}");
    ensure!(causes.iter().all(Option::is_none), "{causes:?}");
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    Ok(())
}
