//! The daemon at any rate, in real time where it may be, before a camera of this process; each
//! release that it missed is compared with how late a reference was in that time.

use std::fmt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use controller::clock::sleep_until;
use controller::report::Report;
use ipc::{Domain, Observer, now_ns};
use messages::CycleRecord;
use scene::Scene;
use testkit::{Place, Running, program, root};

use crate::camera::Camera;
use crate::load::EndOnDrop;
use crate::machine::{is_without, keep, processors, take_priority};
use crate::reference::{Class, Lateness, Reference};

/// SCHED_FIFO priority of the loop.
const PRIORITY: i32 = 80;
/// SCHED_FIFO priority of the camera, whose frames must be on time whatever else the machine does.
const CAMERA_PRIORITY: i32 = 70;
/// Time in which peers meet and steering begins, ns.
pub const START_UP_NS: u64 = 800_000_000;
/// Share of a period that a cycle's own work may take, beside what the reference was late, for a
/// missed release to be the machine's.
const OWN: f64 = 0.75;

/// A place, and the paper's scene at a rate.
pub struct Track {
    pub place: Place,
    pub scene_file: PathBuf,
    pub period_ns: u64,
    /// The class that the loop is to be in.
    pub class: Class,
    scene: Scene,
}

/// What a run left.
pub struct Laps {
    pub report: Report,
    /// The cycles after start-up whose records came through.
    records: Vec<CycleRecord>,
    seen: Lateness,
    class: Class,
    period_ns: u64,
}

/// Releases that a cycle missed.
#[derive(Clone, Copy)]
pub struct Missed {
    pub count: u64,
    /// How late the reference was from the cycle's release to the first that it kept again, ns.
    late_ns: u64,
    /// Whether it would have been in time had it not been as late as the reference.
    pub is_the_machines: bool,
}

impl fmt::Debug for Missed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let late = self.late_ns as f64 / 1e6;
        write!(f, "{} missed, the reference {late:.1} ms late", self.count)
    }
}

/// The processor of the loop in real time; the camera is on the first.
pub fn processor() -> usize {
    *processors().last().unwrap()
}

impl Track {
    pub fn new(rate_hz: u32) -> Self {
        let place = Place::new();
        let file = root().join("ipc/scene/scenes/paper-sim.toml");
        let text = std::fs::read_to_string(file).unwrap();
        let text = text.replace("rate_hz = 30.0", &format!("rate_hz = {rate_hz}.0"));
        let scene_file = place.file("scene.toml", &text);
        let scene = Scene::read(&scene_file).unwrap();
        assert_eq!(scene.camera.rate_hz, f64::from(rate_hz));
        let period_ns = 1_000_000_000 / u64::from(rate_hz);
        Self {
            place,
            scene_file,
            period_ns,
            class: Class::of_vpcd(),
            scene,
        }
    }

    /// Cycles of the start-up.
    pub fn start_up(&self) -> u64 {
        START_UP_NS.div_ceil(self.period_ns)
    }

    /// A daemon that ends by itself `cycles` cycles after the start-up.
    fn vpcd(&self, cycles: u64) -> Command {
        let realtime = match self.class == Class::Fifo && !is_without("realtime") {
            true => format!("[realtime]\npriority = {PRIORITY}\ncpu = {}\n", processor()),
            false => String::new(),
        };
        // An ordinary thread that thinks as well needs more than its share of a busy processor.
        let strategy = match self.class {
            Class::Fifo => "",
            Class::Ordinary => "[law]\nstrategy = 'previous'\n",
        };
        // The camera's losses are no matter here: what it sends may be old for a while.
        let text =
            format!("[cycle]\nstale_periods = 20.0\n[safety]\nlost_s = 10.0\n{strategy}{realtime}");
        let mut command = testkit::command(program("vpcd"));
        command
            .arg("--config")
            .arg(self.place.file("vpcd.toml", text));
        command.arg("--scene").arg(&self.scene_file);
        command
            .args(["--arm", "--cycles"])
            .arg((cycles + self.start_up()).to_string());
        command.arg("--domain").arg(self.place.domain());
        command.arg("--report").arg(self.place.path("report.json"));
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command
    }

    /// Runs the daemon for `cycles` cycles after the start-up, and calls `beside` meanwhile.
    pub fn run<T>(&self, cycles: u64, beside: impl FnOnce() -> T) -> (Laps, T) {
        let patience = Duration::from_nanos((cycles + self.start_up()) * self.period_ns);
        let reference = Reference::start(&[self.class]);
        let done = AtomicBool::new(false);
        let (records, besides) = std::thread::scope(|threads| {
            let _done = EndOnDrop(&done);
            let camera = threads.spawn(|| self.film(&done));
            let daemon = Running::start(self.vpcd(cycles));
            let besides = beside();
            let ended = daemon.ended_within(3 * patience + Duration::from_secs(60));
            assert_eq!(ended.code, Some(0), "vpcd");
            done.store(true, Ordering::Relaxed);
            (camera.join().unwrap(), besides)
        });
        let seen = reference.end();
        let text = std::fs::read_to_string(self.place.path("report.json")).unwrap();
        let records = records
            .into_iter()
            .filter(|record| record.cycle > self.start_up());
        let laps = Laps {
            report: serde_json::from_str(&text).unwrap(),
            records: records.collect(),
            seen,
            class: self.class,
            period_ns: self.period_ns,
        };
        (laps, besides)
    }

    /// Shows, and obeys, at the rate; the records of all cycles.
    fn film(&self, done: &AtomicBool) -> Vec<CycleRecord> {
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
        let domain = Domain::join(&self.place.domain()).unwrap();
        let mut observer = Observer::open(&domain).unwrap();
        let mut camera = Camera::new(&self.scene, &starts, &self.place.domain()).nudged();
        if self.class == Class::Fifo {
            keep(None, processors()[0]);
            take_priority(CAMERA_PRIORITY);
        }
        let mut records = Vec::new();
        let mut release_ns = now_ns();
        while !done.load(Ordering::Relaxed) {
            camera.show();
            release_ns += self.period_ns;
            sleep_until(release_ns);
            if let Some(command) = camera.newest() {
                camera.obey(&command);
            }
            let all = std::iter::from_fn(|| observer.cycles.oldest().unwrap());
            records.extend(all.map(|record| record.message));
        }
        records
    }
}

/// When a cycle was to begin.
fn release_ns(record: &CycleRecord) -> u64 {
    record.stamp.data_ns - record.wake_latency_ns
}

impl Laps {
    /// Lateness of each wake-up beyond that of the reference in that time, ns, ascending.
    pub fn late_ns(&self) -> Vec<u64> {
        let late = |record: &CycleRecord| {
            let woken_ns = record.stamp.data_ns;
            let machine_ns = self.seen.between(self.class, release_ns(record), woken_ns);
            record.wake_latency_ns - machine_ns.min(record.wake_latency_ns)
        };
        let mut all: Vec<u64> = self.records.iter().map(late).collect();
        all.sort_unstable();
        all
    }

    /// Releases missed, cycle by cycle.
    pub fn missed(&self) -> Vec<Missed> {
        let missed = |pair: &[CycleRecord]| {
            let count = pair[1].overruns - pair[0].overruns;
            // The cycle ended after so many more releases.
            let from_ns = release_ns(&pair[1]);
            let to_ns = from_ns + (1 + count) * self.period_ns;
            let late_ns = self.seen.between(self.class, from_ns, to_ns);
            let own = (count as f64 - OWN) * self.period_ns as f64;
            let is_the_machines = late_ns as f64 > own;
            (count > 0).then_some(Missed {
                count,
                late_ns,
                is_the_machines,
            })
        };
        self.records.windows(2).filter_map(missed).collect()
    }

    /// Share of the cycles in which the reference was late by a quarter of the period.
    pub fn disturbed(&self) -> f64 {
        let late = |record: &&CycleRecord| {
            let from_ns = release_ns(record);
            let to_ns = from_ns + self.period_ns;
            4 * self.seen.between(self.class, from_ns, to_ns) > self.period_ns
        };
        self.records.iter().filter(late).count() as f64 / self.records.len().max(1) as f64
    }

    /// How many cycles are known of.
    pub fn count(&self) -> u64 {
        self.records.len() as u64
    }
}
