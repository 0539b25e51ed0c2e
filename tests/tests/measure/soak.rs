//! Soak: daemon, emulator, recorder, page and metrics for an hour, with faults at random: peers
//! that are killed or hang, floods, a loaded machine, stops, hands on the stop file, loops of arm,
//! files of other users, kills and hangs of the daemon itself.
//! No command passes the limits, the robot stands whenever the daemon is gone, and nothing grows:
//! memory of the daemon, descriptors, segments.
//!
//! `VPC_SECONDS` chooses another time, `VPC_SEED` other faults (1).

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ipc::{Domain, OperatorPorts, now_ns};
use messages::{Action, Request, TwistState};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{
    CAMERA_PRIORITY, Place, Running, WAKE_NS, Witness, assert_within_limits, eventually, is_still,
    on_time,
};
use crate::judge::in_time;
use crate::load;
use crate::load::EndOnDrop;
use crate::reference::{Class, Reference};
use crate::sheet::Sheet;

/// Longest time from the end of the daemon to standstill, ns.
const STANDS_NS: u64 = 100_000_000 + WAKE_NS;
/// How long a fault that passes lasts.
const PASSING: Duration = Duration::from_secs(1);
/// Time in which dead peers are cleared away.
const CLEARED: Duration = Duration::from_millis(2500);
/// Share of the faults that end or halt the daemon itself: in an hour, and in a short run.
const RARE: [f64; 2] = [0.02, 0.2];
/// Time in which the daemon's flight record fills; it is then written.
const FULL: Duration = Duration::from_secs(30);
/// Time in which its memory has settled: after that.
const SETTLED: Duration = Duration::from_secs(60);
/// Growth of the daemon's memory after that, in one of its lives, that is no leak, KiB: of its own,
/// and of what it maps.
const GROWTH_KIB: u64 = 1024;
/// More descriptors, and segments, than at first that are no leak: peers come and go.
const MORE: usize = 4;

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    CameraKilled,
    CameraHangs,
    RecorderKilled,
    PageKilled,
    MetricsKilled,
    Stopped,
    /// A hand on the stop file.
    Touched,
    /// Somebody arms in a loop, and has not seen the stop.
    ArmedInALoop,
    /// Another user's file in shared memory, with the domain's prefix.
    Squatted,
    Flooded,
    Loaded,
    DaemonKilled,
    DaemonHangs,
    DaemonTerminated,
    /// The stop file is moved; only another daemon has one again.
    StopFileMoved,
}

/// Those of others, each as often as it stands here.
const FAULTS: [Fault; 21] = {
    use Fault::*;
    [
        CameraKilled,
        CameraKilled,
        CameraKilled,
        CameraHangs,
        CameraHangs,
        RecorderKilled,
        RecorderKilled,
        PageKilled,
        PageKilled,
        MetricsKilled,
        MetricsKilled,
        Stopped,
        Stopped,
        Touched,
        Touched,
        ArmedInALoop,
        Squatted,
        Flooded,
        Flooded,
        Loaded,
        Loaded,
    ]
};
/// Those of the daemon.
const GRAVE: [Fault; 4] = [
    Fault::DaemonKilled,
    Fault::DaemonHangs,
    Fault::DaemonTerminated,
    Fault::StopFileMoved,
];
/// What a hand does to the stop file.
const HANDS: [&str; 5] = [
    "date +%s%N > stop",
    "echo stop > stop",
    ": > stop",
    "touch stop",
    "echo >> stop",
];

/// Who takes part.
struct Cast {
    place: Place,
    witness: Witness,
    daemon: Running,
    camera: Running,
    recorder: Running,
    page: Running,
    metrics: Running,
    /// Starts of the camera, and recordings, so far.
    starts: usize,
    recordings: usize,
    /// The veto that stands, as the last cycle told.
    veto: u32,
}

/// What was seen.
#[derive(Default)]
struct Tally {
    faults: BTreeMap<Fault, u32>,
    restarts: u32,
    cycles: u64,
    missed: u64,
    /// Of the present daemon.
    overruns: u64,
    stands_ns: u64,
    /// Ends of the daemon after which the robot stood late, as the reference was.
    disturbed: u32,
    stop: Duration,
    growth_kib: [u64; 2],
    moving: u64,
}

impl Cast {
    fn new() -> Self {
        let place = Place::new();
        let witness = Witness::new(&place);
        Self {
            daemon: daemon(&place),
            camera: camera(&place, 0),
            recorder: recorder(&place, 0),
            page: server(&place, "serve"),
            metrics: server(&place, "metrics"),
            place,
            witness,
            starts: 1,
            recordings: 1,
            veto: 0,
        }
    }

    /// Starts who has ended; runs of the camera end by themselves.
    fn revive(&mut self, tally: &mut Tally) {
        if !self.daemon.is_running() {
            self.daemon = daemon(&self.place);
            (tally.restarts, tally.overruns) = (tally.restarts + 1, 0);
        }
        if !self.camera.is_running() {
            self.camera = camera(&self.place, self.starts);
            self.starts += 1;
        }
        if !self.recorder.is_running() {
            let _ = std::fs::remove_file(recording(&self.place, self.recordings - 1));
            self.recorder = recorder(&self.place, self.recordings);
            self.recordings += 1;
            tally.restarts += 1;
        }
        for (server_of, name) in [(&mut self.page, "serve"), (&mut self.metrics, "metrics")] {
            if !server_of.is_running() {
                *server_of = server(&self.place, name);
                tally.restarts += 1;
            }
        }
    }

    /// Takes what came, and arms whenever it is disarmed.
    fn tend(&mut self, tally: &mut Tally) {
        let commands = self.witness.commands();
        commands.iter().for_each(assert_within_limits);
        let moving = |twist: &&messages::TwistCommand| twist.state() == Some(TwistState::Moving);
        tally.moving += commands.iter().filter(moving).count() as u64;
        for record in self.witness.records() {
            tally.cycles += 1;
            self.veto = record.veto;
            tally.missed += record.overruns.saturating_sub(tally.overruns);
            tally.overruns = record.overruns;
        }
        if commands.last().and_then(|twist| twist.state()) == Some(TwistState::Disarmed) {
            let id = ChaCha8Rng::seed_from_u64(now_ns()).random();
            self.witness.say(&Request::arm(id, self.veto));
        }
    }

    /// Tends for so long.
    fn go_on(&mut self, time: Duration, tally: &mut Tally) {
        let begin = Instant::now();
        while begin.elapsed() < time {
            self.revive(tally);
            self.tend(tally);
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn commit(&mut self, fault: Fault, tally: &mut Tally, random: &mut impl Rng) {
        *tally.faults.entry(fault).or_default() += 1;
        match fault {
            Fault::CameraKilled => self.camera.signal(Signal::KILL),
            Fault::RecorderKilled => self.recorder.signal(Signal::KILL),
            Fault::PageKilled => self.page.signal(Signal::KILL),
            Fault::MetricsKilled => self.metrics.signal(Signal::KILL),
            Fault::CameraHangs => {
                self.camera.signal(Signal::STOP);
                self.go_on(PASSING, tally);
                self.camera.signal(Signal::CONT);
            }
            Fault::Stopped => {
                let took = ipc::stop(&self.place.domain(), Duration::from_secs(2));
                tally.stop = tally.stop.max(took.expect("a stop that is obeyed"));
            }
            Fault::Touched => {
                self.shell(HANDS[random.random_range(0..HANDS.len())]);
                self.stands(tally);
            }
            Fault::ArmedInALoop => {
                let took = ipc::stop(&self.place.domain(), Duration::from_secs(2));
                tally.stop = tally.stop.max(took.expect("a stop that is obeyed"));
                std::thread::sleep(Duration::from_millis(150));
                self.witness.commands();
                let newest = self.witness.records().last().map(|record| record.veto);
                let other = newest.expect("cycles") ^ 2;
                let begin = Instant::now();
                while begin.elapsed() < PASSING {
                    self.witness.say(&Request::arm(random.random(), 0));
                    self.witness.say(&Request::arm(random.random(), other));
                    std::thread::sleep(Duration::from_millis(20));
                    let commands = self.witness.commands();
                    assert!(
                        commands.iter().all(is_still),
                        "armed by who has not seen it"
                    );
                }
            }
            Fault::Squatted => {
                let prefix = ipc::shared_memory_prefix(&self.place.domain()).unwrap();
                let theirs = PathBuf::from(format!("/dev/shm/{prefix}theirs"));
                std::fs::write(&theirs, "").unwrap();
                // Only root can: else it is a file of ours that nobody knows.
                let _ = std::os::unix::fs::chown(&theirs, Some(65534), Some(65534));
                self.go_on(PASSING, tally);
                let status = vpcctl(&self.place).arg("status").status();
                assert!(matches!(status.unwrap().code(), Some(0 | 1 | 5)));
                let _ = std::fs::remove_file(&theirs);
            }
            Fault::Flooded => self.flooded(tally, random),
            Fault::Loaded => {
                let (done, directory) = (AtomicBool::new(false), self.place.path(""));
                std::thread::scope(|threads| {
                    let _done = EndOnDrop(&done);
                    load::work(threads, &directory, &done);
                    self.go_on(PASSING, tally);
                });
            }
            Fault::DaemonTerminated => self.daemon.signal(Signal::TERM),
            Fault::StopFileMoved => {
                self.shell("mv stop elsewhere");
                self.stands(tally);
                self.daemon.signal(Signal::TERM);
            }
            Fault::DaemonKilled | Fault::DaemonHangs => {
                self.tend(tally);
                let reference = Reference::start(&[Class::of_vpcd()]);
                let signal = match fault {
                    Fault::DaemonKilled => Signal::KILL,
                    _ => Signal::STOP,
                };
                self.daemon.halt(signal);
                let gone_ns = now_ns();
                let stands_ns = self.until_it_stands(gone_ns);
                let seen = reference.end();
                if let Some(stands_ns) = stands_ns {
                    let class = Class::of_vpcd();
                    let stood = in_time("it stands", class, gone_ns, stands_ns, STANDS_NS);
                    match stood {
                        Ok(took_ns) => tally.stands_ns = tally.stands_ns.max(took_ns),
                        Err(miss) if miss.is_the_machines(&seen) => tally.disturbed += 1,
                        Err(miss) => panic!("{miss}"),
                    }
                }
                self.daemon.signal(Signal::CONT);
            }
        }
    }

    /// When the robot said after this instant that it stands, ns; `None` if its run was decided
    /// before.
    fn until_it_stands(&mut self, after_ns: u64) -> Option<u64> {
        eventually("a robot that stands", || {
            let went = !self.camera.is_running();
            while let Some(state) = self.witness.observer.robot.oldest().unwrap() {
                if state.twist == [0.0; 6] && state.stamp.published_ns > after_ns {
                    return Some(Some(state.stamp.published_ns));
                }
            }
            went.then_some(None)
        })
    }

    /// A line of the shell in the domain's directory.
    fn shell(&self, line: &str) {
        let mut shell = testkit::command("/bin/sh");
        shell.args(["-c", line]).current_dir(self.place.domain());
        assert!(shell.status().unwrap().success(), "{line}");
    }

    /// Waits until the camera stands, and stays so, after a stop that nobody acknowledges.
    fn stands(&mut self, tally: &mut Tally) {
        let begin = Instant::now();
        self.witness.until("a zero twist", is_still);
        tally.stop = tally.stop.max(begin.elapsed());
        std::thread::sleep(Duration::from_millis(150));
        assert!(self.witness.commands().iter().all(is_still), "it moves on");
    }

    /// Operators who ask without a pause.
    fn flooded(&mut self, tally: &mut Tally, random: &mut impl Rng) {
        let done = AtomicBool::new(false);
        let directory = self.place.domain();
        let first: u64 = random.random();
        std::thread::scope(|threads| {
            let _done = EndOnDrop(&done);
            threads.spawn(|| {
                let domain = Domain::join(&directory).unwrap();
                let mut operator = OperatorPorts::open(&domain).unwrap();
                let ids = (0..).map(|k| first.wrapping_add(k));
                for id in ids.take_while(|_| !done.load(Ordering::Relaxed)) {
                    let request = Request::new(id, Action::Status);
                    operator.requests.publish(&request).unwrap();
                    std::thread::sleep(Duration::from_micros(100));
                }
            });
            self.go_on(PASSING, tally);
        });
    }
}

fn daemon(place: &Place) -> Running {
    Running::start(place.vpcd("[flight]\ndirectory = 'records'\nkeep = 3\nminutes = 0.2"))
}

fn camera(place: &Place, start: usize) -> Running {
    Running::start(on_time(place.hw_sim(start % 100), CAMERA_PRIORITY))
}

fn recording(place: &Place, number: usize) -> PathBuf {
    place.path(&format!("{number}.mcap"))
}

fn vpcctl(place: &Place) -> Command {
    let mut command = place.vpcctl();
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn recorder(place: &Place, number: usize) -> Running {
    let mut command = vpcctl(place);
    command.arg("record").arg(recording(place, number));
    Running::start(command)
}

/// The page, or the metrics, at a port of its own.
fn server(place: &Place, name: &str) -> Running {
    let mut command = vpcctl(place);
    command.args([name, "--listen", &address(name)]);
    Running::start(command)
}

/// Addresses of their own, on the loopback network of this process.
fn address(name: &str) -> String {
    let own = 1 + std::process::id() % 250;
    match name {
        "serve" => format!("127.39.{own}.1:39470"),
        _ => format!("127.39.{own}.1:39469"),
    }
}

/// Reads a page again and again; counts the bytes.
fn read(name: &str, path: &str, done: &AtomicBool, bytes: &AtomicU64) {
    while !done.load(Ordering::Relaxed) {
        let visit = || -> std::io::Result<()> {
            let mut stream = TcpStream::connect(address(name))?;
            stream.set_read_timeout(Some(Duration::from_secs(1)))?;
            let host = address(name);
            write!(
                stream,
                "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
            )?;
            let mut part = [0; 4096];
            while !done.load(Ordering::Relaxed) {
                match stream.read(&mut part)? {
                    0 => break,
                    count => _ = bytes.fetch_add(count as u64, Ordering::Relaxed),
                }
            }
            Ok(())
        };
        // Its server was killed, or is not there yet.
        let _ = visit();
        std::thread::sleep(Duration::from_millis(500));
    }
}

/// Memory of a process, KiB: what is its own, and what it shares by files and segments.
fn memory_kib(process: u32) -> Option<[u64; 2]> {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let part = |name| {
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().trim_end_matches(" kB").parse::<u64>().ok()
    };
    Some([part("RssAnon:")?, part("RssFile:")? + part("RssShmem:")?])
}

/// One run of the daemon.
struct Life {
    daemon: u32,
    begin: Instant,
    is_recorded: bool,
    /// Memory when it had settled.
    settled: Option<[u64; 2]>,
}

impl Life {
    fn of(daemon: &Running) -> Self {
        Self {
            daemon: daemon.id(),
            begin: Instant::now(),
            is_recorded: false,
            settled: None,
        }
    }

    /// Counts how its memory grows.
    fn observe(&mut self, daemon: &mut Running, tally: &mut Tally) {
        if self.daemon != daemon.id() {
            *self = Self::of(daemon);
        }
        let age = self.begin.elapsed();
        if age > FULL && !self.is_recorded {
            daemon.signal(Signal::USR1);
            self.is_recorded = true;
        }
        if age > SETTLED
            && let Some(memory) = memory_kib(self.daemon)
        {
            let settled = *self.settled.get_or_insert(memory);
            for ((growth, now), then) in tally.growth_kib.iter_mut().zip(memory).zip(settled) {
                *growth = (*growth).max(now.saturating_sub(then));
            }
        }
    }
}

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    let given = |name| {
        std::env::var(name)
            .ok()
            .map(|text| text.parse().expect(name))
    };
    let seconds = given("VPC_SECONDS");
    let seconds = seconds.unwrap_or_else(|| sheet.repeats(30, 3600) as u64);
    let (time, seed) = (Duration::from_secs(seconds), given("VPC_SEED").unwrap_or(1));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut cast, mut tally) = (Cast::new(), Tally::default());
    let (done, bytes) = (AtomicBool::new(false), AtomicU64::new(0));
    // Descriptors of the daemon and segments of the domain, with everybody there.
    let state = |cast: &Cast| {
        let descriptors = std::fs::read_dir(format!("/proc/{}/fd", cast.daemon.id()));
        let segments = Domain::segments(&cast.place.domain()).unwrap();
        [descriptors.map_or(0, Iterator::count), segments]
    };
    let [first, last] = std::thread::scope(|threads| {
        let _done = EndOnDrop(&done);
        threads.spawn(|| read("serve", "/events", &done, &bytes));
        threads.spawn(|| read("metrics", "/metrics", &done, &bytes));
        cast.go_on(2 * CLEARED, &mut tally);
        let first = state(&cast);
        let begin = Instant::now();
        let rare = RARE[usize::from(time < Duration::from_secs(600))];
        let mut life = Life::of(&cast.daemon);
        while begin.elapsed() < time {
            let pause = Duration::from_millis(random.random_range(300..4000));
            cast.go_on(pause, &mut tally);
            life.observe(&mut cast.daemon, &mut tally);
            let fault = match random.random_bool(rare) {
                true => GRAVE[random.random_range(0..GRAVE.len())],
                false => FAULTS[random.random_range(0..FAULTS.len())],
            };
            cast.commit(fault, &mut tally, &mut random);
        }
        cast.go_on(2 * CLEARED, &mut tally);
        [first, state(&cast)]
    });
    let faults: u32 = tally.faults.values().sum();
    let kib = bytes.load(Ordering::Relaxed) / 1024;
    sheet.figure("seed", seed as f64, "");
    sheet.figure("cycles", tally.cycles as f64, "");
    sheet.figure("with the law", tally.moving as f64, "");
    sheet.figure("releases missed", tally.missed as f64, "");
    sheet.figure("faults", f64::from(faults), "");
    sheet.figure("restarts", f64::from(tally.restarts), "");
    sheet.figure("runs of the camera", cast.starts as f64, "");
    sheet.figure("read of page and metrics", kib as f64, "KiB");
    sheet.longest("the robot stands after", tally.stands_ns, STANDS_NS);
    sheet.figure("those disturbed", f64::from(tally.disturbed), "");
    sheet.figure("a stop is back after", tally.stop.as_secs_f64() * 1e3, "ms");
    let [own, mapped] = tally.growth_kib;
    sheet.bar("own memory grew by", own as f64, "KiB", GROWTH_KIB as f64);
    sheet.bar(
        "mapped memory grew by",
        mapped as f64,
        "KiB",
        GROWTH_KIB as f64,
    );
    sheet.bar("descriptors", last[0] as f64, "", (first[0] + MORE) as f64);
    sheet.bar("segments", last[1] as f64, "", (first[1] + MORE) as f64);
    sheet.check(own.max(mapped) <= GROWTH_KIB, || {
        format!("memory grew by {own} and {mapped} KiB")
    });
    let is_level = std::iter::zip(first, last).all(|(then, now)| now <= then + MORE);
    sheet.check(is_level, || format!("left behind: {first:?} -> {last:?}"));
    sheet.check(kib > time.as_secs(), || "nothing was read".to_owned());
    // A late machine disarms again and again.
    if tally.moving <= 10 * time.as_secs() {
        sheet.lacks("it hardly moved");
    }
}
