//! A wall clock that jumps by hours while everything runs: nothing happens. In lockstep a run is the
//! same to the last bit with and without the jumps. Gaps of the monotonic clock are in
//! `cargo test --test simulation hang`.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use rustix::process::Signal;
use serde_json::Value;

use crate::fixture::{Place, Running, program, scene_file, starts_file};

/// Stands before the C library: each time that it is read the wall clock is some hours elsewhere.
const SHIM: &str = r#"
#define _GNU_SOURCE
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long jump(void) {
    static _Atomic long count;
    return ((count++ * 7919) % 11 - 5) * 3600;
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

/// The shim, compiled.
fn shim(place: &Place) -> PathBuf {
    let source = place.file("shim.c", SHIM);
    let library = place.path("shim.so");
    let mut compile = testkit::command("cc");
    compile.args(["-shared", "-fPIC", "-O1", "-o"]);
    let compiled = compile.arg(&library).arg(source).output().unwrap();
    assert!(compiled.status.success(), "{compiled:?}");
    library
}

/// What `date` shows, in hours.
fn hour(library: &Path) -> i64 {
    let mut date = testkit::command("date");
    let shown = date.arg("+%s").env("LD_PRELOAD", library).output().unwrap();
    let text = String::from_utf8(shown.stdout).unwrap();
    text.trim().parse::<i64>().unwrap() / 3600
}

/// The verdict on a run of daemon and camera, under this library if any.
fn run(library: Option<&Path>) -> Value {
    let place = Place::new();
    let mut daemon = place.vpcd("[law]\nstrategy = 'previous'\n[cycle]\nclock = 'lockstep'");
    daemon.envs(library.map(|library| ("LD_PRELOAD", library)));
    let daemon = Running::start(daemon);
    let mut camera = testkit::command(program("hw-sim"));
    camera.arg("--scene").arg(scene_file());
    camera.arg("--starts").arg(starts_file());
    camera.args(["--start", "0", "--clock", "lockstep", "--domain"]);
    camera.arg(place.domain());
    camera.envs(library.map(|library| ("LD_PRELOAD", library)));
    camera.stdout(Stdio::piped()).stderr(Stdio::piped());
    let camera = Running::start(camera).ended();
    assert_eq!(camera.code, Some(0), "{camera:?}");
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    serde_json::from_str(&camera.stdout).unwrap()
}

#[test]
fn jumps_of_the_wall_clock_have_no_effect() {
    let place = Place::new();
    let library = shim(&place);
    // The shim works: the first hour that `date` shows is five hours ago.
    let now = std::time::SystemTime::now();
    let now = now.duration_since(std::time::UNIX_EPOCH).unwrap();
    assert!(hour(&library) <= now.as_secs() as i64 / 3600 - 4);
    let (calm, jumping) = (run(None), run(Some(&library)));
    for key in ["verdict", "error_px", "time_s", "frames"] {
        assert!(!calm[key].is_null(), "{key}: {calm}");
        assert_eq!(calm[key], jumping[key], "{key}: {calm} {jumping}");
    }
}
