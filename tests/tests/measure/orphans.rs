//! `demo` starts `cargo`, `vpcd` and `hw-sim`, and leaves nothing behind however it ends: no
//! process, and, unless it was killed, no directory and nothing in shared memory. A test harness
//! that aborts or is killed leaves no process either.

use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use ipc::{Domain, shared_memory_prefix};
use rustix::process::{Pid, Signal, kill_process};
use testkit::within;

use crate::fixture::{PATIENCE, Place, Running, eventually, program, scene_file};
use crate::judge::{NotShown, give_up};
use crate::reference::Class;
use crate::sheet::Sheet;

/// Environment variable that all descendants of a program inherit.
const MARK: &str = "VPC_ORPHANS_OF";
/// The demo, and its word.
const DEMO: [&str; 2] = [env!("CARGO_BIN_EXE_vpc-lab"), "demo"];
/// Longest time for the pair to run: `cargo build` may have something to do.
const BUILD: Duration = Duration::from_secs(300);

/// A program that starts children; itself and what it left are killed in the end.
struct Parent {
    place: Place,
    child: Child,
    mark: Vec<u8>,
}

impl Parent {
    fn start(program: &str, arguments: &[&str], cargo: Option<&Path>) -> Self {
        let place = Place::new();
        let text = place.path("").display().to_string();
        // As from a terminal: what runs the tests in the background may ignore signals, which
        // children inherit.
        let mut command = testkit::command("env");
        command.args(["--default-signal=INT,TERM,HUP", program]);
        command.args(arguments).current_dir(place.path(""));
        command.env(MARK, &text).env("TMPDIR", &text);
        if let Some(cargo) = cargo {
            command.env("CARGO", cargo);
        }
        command.stdout(Stdio::null()).stderr(Stdio::null());
        Self {
            child: command.spawn().unwrap(),
            mark: format!("{MARK}={text}\0").into_bytes(),
            place,
        }
    }

    /// Processes of this program, with itself: number and name. Those that wait to be reaped have
    /// no environment.
    fn family(&self) -> Vec<(i32, String)> {
        let processes = fs::read_dir("/proc").unwrap().filter_map(Result::ok);
        let marked = processes.filter_map(|entry| {
            let id = entry.file_name().to_str()?.parse().ok()?;
            let environment = fs::read(entry.path().join("environ")).ok()?;
            let is_ours = environment.windows(self.mark.len()).any(|w| w == self.mark);
            let name = fs::read_to_string(entry.path().join("comm")).ok()?;
            is_ours.then(|| (id, name.trim().to_owned()))
        });
        marked.collect()
    }

    /// Domains of its children so far.
    fn domains(&self) -> Vec<PathBuf> {
        fn below(directory: &Path, found: &mut Vec<PathBuf>) {
            for entry in fs::read_dir(directory).into_iter().flatten().flatten() {
                let path = entry.path();
                if entry.file_name() == "domain" {
                    found.extend(path.canonicalize());
                } else if path.is_dir() {
                    below(&path, found);
                }
            }
        }
        let mut found = Vec::new();
        below(&self.place.path(""), &mut found);
        found
    }

    /// Waits until all of these run.
    fn runs(&mut self, names: &[&str]) {
        let begin = Instant::now();
        loop {
            let family = self.family();
            let runs = |name: &&str| family.iter().any(|(_, other)| other == name);
            if names.iter().all(runs) {
                return;
            }
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none(), "{ended:?} before {names:?} ran");
            if begin.elapsed() > BUILD {
                // Another cargo may hold the lock of the target directory.
                give_up(NotShown(format!("only {family:?} run after {BUILD:?}")));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Sends a signal; how the program ended.
    fn ends_by(&mut self, signal: Signal) -> ExitStatus {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
        eventually("the program's end", || self.child.try_wait().unwrap())
    }
}

impl Drop for Parent {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        for (id, _) in self.family() {
            let _ = Pid::from_raw(id).map(|pid| kill_process(pid, Signal::KILL));
        }
        // Clears away what was killed.
        for domain in self.domains() {
            let _ = Domain::join(&domain);
        }
    }
}

/// Files in shared memory with these prefixes.
fn segments(prefixes: &[String]) -> usize {
    let files = fs::read_dir("/dev/shm").unwrap().filter_map(Result::ok);
    let is_theirs = |name: &[u8]| prefixes.iter().any(|p| name.starts_with(p.as_bytes()));
    files
        .filter(|file| is_theirs(file.file_name().as_bytes()))
        .count()
}

/// Stops the demo by this signal while its pairs run: how long until it had ended, and its last
/// child, ms.
fn leaves_nothing(signal: Signal) -> [f64; 2] {
    let mut parent = Parent::start(DEMO[0], &[DEMO[1], "--no-progress"], None);
    parent.runs(&["vpcd", "hw-sim"]);
    std::thread::sleep(Duration::from_millis(300));
    let prefixes = eventually("the pair's shared memory", || {
        let domains = parent.domains();
        let prefixes = domains.iter().map(|domain| shared_memory_prefix(domain));
        let prefixes = prefixes.collect::<Result<Vec<_>, _>>().ok()?;
        (segments(&prefixes) > 0).then_some(prefixes)
    });
    let before = parent.family();
    let begin = Instant::now();
    let status = parent.ends_by(signal);
    let ended = begin.elapsed();
    assert_eq!(status.signal(), Some(signal.as_raw()), "{status}");
    if signal == Signal::KILL {
        // The guardian tells the children, who then leave by themselves.
        eventually("the end of children", || {
            parent.family().is_empty().then_some(())
        });
    } else {
        assert_eq!(parent.family(), [], "of {before:?}");
        assert_eq!(segments(&prefixes), 0, "{prefixes:?}");
        let left = fs::read_dir(parent.place.path("")).unwrap().flatten();
        let left: Vec<_> = left.map(|entry| entry.file_name()).collect();
        let is_ours = |name: &std::ffi::OsString| name.as_bytes().starts_with(b"vpc-");
        assert!(!left.iter().any(is_ours), "{left:?}");
    }
    [ended, begin.elapsed()].map(|time| time.as_secs_f64() * 1e3)
}

/// The signal's name.
fn name(signal: Signal) -> &'static str {
    match signal {
        Signal::INT => "SIGINT",
        Signal::TERM => "SIGTERM",
        Signal::HUP => "SIGHUP",
        Signal::ABORT => "SIGABRT",
        _ => "SIGKILL",
    }
}

/// Measures the demo.
pub fn measure_demo(sheet: &mut Sheet) {
    program("vpcd");
    for signal in [Signal::INT, Signal::TERM, Signal::HUP, Signal::KILL] {
        let what = format!("demo, {}", name(signal));
        let ended = sheet.round(&[Class::Ordinary], &what, || Ok(leaves_nothing(signal)));
        if let Some([ended, left]) = ended {
            sheet.figure(&format!("{what}: ended after"), ended, "ms");
            sheet.figure(&format!("{what}: children after"), left, "ms");
        }
    }
    let cases: [(&str, fn()); 2] = [
        ("a build ends with its compilers", build_ends),
        ("what outlives a terminal", outlives_a_terminal),
    ];
    for (what, case) in cases {
        sheet.round(&[Class::Ordinary], what, || {
            case();
            Ok(())
        });
    }
}

/// Measures a harness of tests, which has the children that tests have.
pub fn measure_harness(sheet: &mut Sheet) {
    for name in ["vpcd", "hw-sim"] {
        program(name);
    }
    for signal in [Signal::ABORT, Signal::KILL] {
        let what = format!("a harness, {}", name(signal));
        let left = sheet.round(&[Class::Ordinary], &what, || Ok(harness_leaves(signal)));
        if let Some(ms) = left {
            sheet.figure(&format!("{what}: children after"), ms, "ms");
        }
    }
}

fn build_ends() {
    let place = Place::new();
    // It does what cargo does while it compiles.
    let cargo = place.file("cargo", "#!/bin/sh\nsleep 600 &\nwait\n");
    fs::set_permissions(&cargo, fs::Permissions::from_mode(0o700)).unwrap();
    let mut parent = Parent::start(DEMO[0], &[DEMO[1]], Some(&cargo));
    parent.runs(&["cargo", "sleep"]);
    let status = parent.ends_by(Signal::TERM);
    assert_eq!(status.signal(), Some(Signal::TERM.as_raw()), "{status}");
    assert_eq!(parent.family(), []);
}

fn outlives_a_terminal() {
    let place = Place::new();
    let cargo = place.file("cargo", "#!/bin/sh\nsleep 600 &\nwait\n");
    fs::set_permissions(&cargo, fs::Permissions::from_mode(0o700)).unwrap();
    let mut parent = Parent::start("nohup", &DEMO, Some(&cargo));
    parent.runs(&["cargo", "sleep"]);
    kill_process(Pid::from_child(&parent.child), Signal::HUP).unwrap();
    // The next signal is not heard before the first one.
    std::thread::sleep(Duration::from_millis(100));
    let status = parent.ends_by(Signal::TERM);
    assert_eq!(status.signal(), Some(Signal::TERM.as_raw()), "{status}");
}

/// Lockstep daemons that a harness left behind once; they went on for an hour.
const DAEMONS: usize = 4;
/// Environment variable that the harness has.
const ROLE: &str = "VPC_TEST_ROLE";
/// File that tells the harness to abort.
const ABORT: &str = "abort";

/// Whether this process plays a harness.
pub fn is_harness() -> bool {
    std::env::var_os(ROLE).is_some()
}

/// The harness, which aborts or is killed.
pub fn play_a_harness() -> ! {
    let daemon = || {
        let place = Place::new();
        let mut vpcd = testkit::command(program("vpcd"));
        vpcd.arg("--scene").arg(scene_file());
        vpcd.args(["--arm", "--clock", "lockstep", "--strategy", "previous"]);
        vpcd.arg("--domain").arg(place.domain());
        (Running::start(vpcd), place)
    };
    // Threads that end before the harness does, as those of tests do.
    let threads = [0; DAEMONS].map(|_| std::thread::spawn(daemon));
    let _daemons = threads.map(|thread| thread.join().unwrap());
    let place = Place::new();
    let _camera = Running::start(place.hw_sim(0));
    // Has a child of its own, and does not obey SIGTERM.
    let mut shell = testkit::command("sh");
    shell.args(["-c", "trap '' TERM; sleep 600 & wait; sleep 600"]);
    let _shell = Running::start(shell);
    within(PATIENCE, || Path::new(ABORT).exists().then_some(()));
    std::process::abort();
}

/// Ends a harness by this signal: how long until none of its children was left, ms.
fn harness_leaves(signal: Signal) -> f64 {
    let this = std::env::current_exe().unwrap();
    let role = format!("{ROLE}=harness");
    let mut parent = Parent::start("env", &[&role, this.to_str().unwrap()], None);
    parent.runs(&["vpcd", "hw-sim", "sleep"]);
    eventually("all daemons", || {
        let family = parent.family();
        let daemons = family.iter().filter(|(_, name)| name == "vpcd").count();
        (daemons == DAEMONS).then_some(())
    });
    let begin = Instant::now();
    let status = match signal {
        Signal::KILL => parent.ends_by(signal),
        _ => {
            parent.place.file(ABORT, "");
            eventually("the abort", || parent.child.try_wait().unwrap())
        }
    };
    assert_eq!(status.signal(), Some(signal.as_raw()), "{status}");
    eventually("the end of its children", || {
        parent.family().is_empty().then_some(())
    });
    begin.elapsed().as_secs_f64() * 1e3
}
