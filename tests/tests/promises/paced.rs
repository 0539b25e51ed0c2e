//! The daemon in real time on a processor of its own, at any rate, before a camera of this process;
//! each of its cycles is compared with what the machine did in that time.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use controller::clock::sleep_until;
use controller::report::Report;
use ipc::{Domain, Observer, now_ns};
use messages::CycleRecord;
use scene::Scene;

use crate::camera::Camera;
use crate::fixture::{EndOnDrop, Place, Running, program, root};
use crate::machine::{is_without, keep, take_priority};
use crate::watch::{Standstills, Watch};

/// Processor of the daemon's loop; the camera stays on the other.
pub const PROCESSOR: usize = 1;
/// SCHED_FIFO priority of the loop.
pub const PRIORITY: i32 = 80;
/// SCHED_FIFO priority of the camera, whose frames must be on time whatever else the machine does.
const CAMERA_PRIORITY: i32 = 70;
/// Time in which peers meet and steering begins, ns.
pub const START_UP_NS: u64 = 800_000_000;
/// Between two looks at the clock on a processor, ns.
const TICK_NS: u64 = 200_000;
/// Lateness of such a look from which on the processor stood still, ns.
const LATE_NS: u64 = 50_000;

/// A place, and the paper's scene at a rate.
pub struct Track {
    pub place: Place,
    pub scene_file: PathBuf,
    pub period_ns: u64,
    scene: Scene,
}

/// What a run left.
pub struct Laps {
    pub report: Report,
    /// The cycles after start-up whose records came through.
    records: Vec<CycleRecord>,
    /// Of the loop's processor.
    pub standstills: Standstills,
    period_ns: u64,
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
            scene,
        }
    }

    /// Cycles of the start-up.
    pub fn start_up(&self) -> u64 {
        START_UP_NS.div_ceil(self.period_ns)
    }

    /// A daemon that ends by itself after so many cycles, the start-up not counted.
    fn vpcd(&self, cycles: u64) -> Command {
        // The camera's losses are no matter here: what it sends may be old for a while.
        let realtime = match is_without("realtime") {
            true => String::new(),
            false => format!("[realtime]\npriority = {PRIORITY}\ncpu = {PROCESSOR}"),
        };
        let text = format!("[cycle]\nstale_periods = 20.0\n[safety]\nlost_s = 10.0\n{realtime}");
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

    /// Runs the daemon for so many cycles, the start-up not counted, and calls `beside` meanwhile.
    pub fn run<T>(&self, cycles: u64, beside: impl FnOnce() -> T) -> (Laps, T) {
        let patience = Duration::from_nanos((cycles + self.start_up()) * self.period_ns);
        let watch = watch(PROCESSOR);
        let done = AtomicBool::new(false);
        let (records, besides) = std::thread::scope(|threads| {
            let _done = EndOnDrop(&done);
            let camera = threads.spawn(|| self.film(&done));
            let daemon = Running::start(self.vpcd(cycles));
            let besides = beside();
            let ended = daemon.ended_within(patience + Duration::from_secs(30));
            assert_eq!(ended.code, Some(0), "vpcd");
            done.store(true, Ordering::Relaxed);
            (camera.join().unwrap(), besides)
        });
        let standstills = watch.end();
        let text = std::fs::read_to_string(self.place.path("report.json")).unwrap();
        let report: Report = serde_json::from_str(&text).unwrap();
        // The machine has no part in these.
        let faults = [report.minor_faults, report.major_faults];
        assert_eq!(
            (faults, report.blocked, report.allocations),
            ([0; 2], 0, 0),
            "{report:#?}"
        );
        let records = records
            .into_iter()
            .filter(|record| record.cycle > self.start_up());
        let laps = Laps {
            report,
            records: records.collect(),
            standstills,
            period_ns: self.period_ns,
        };
        // Deadlines missed in a row disarm the daemon, which then has no work to do.
        let had_work = laps.report.armed >= cycles * 9 / 10;
        assert!(had_work || laps.report.overruns > 0, "{:#?}", laps.report);
        (laps, besides)
    }

    /// Shows, and obeys, at the rate; the records of all cycles.
    fn film(&self, done: &AtomicBool) -> Vec<CycleRecord> {
        let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
        let domain = Domain::join(&self.place.domain()).unwrap();
        let mut observer = Observer::open(&domain).unwrap();
        let mut camera = Camera::new(&self.scene, &starts, &self.place.domain()).nudged();
        keep(None, 0);
        take_priority(CAMERA_PRIORITY);
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

/// Watches a processor so closely that a cycle's standstills are known.
fn watch(processor: usize) -> Watch {
    Watch::start(&[processor], TICK_NS, LATE_NS)
}

/// When a cycle was to begin.
fn release_ns(record: &CycleRecord) -> u64 {
    record.stamp.data_ns - record.wake_latency_ns
}

impl Laps {
    /// Lateness of each wake-up, without the time in which the processor stood still, ns,
    /// ascending.
    pub fn late_ns(&self) -> Vec<u64> {
        let late = |record: &CycleRecord| {
            let woken_ns = record.stamp.data_ns;
            let stood_ns = self.standstills.between(release_ns(record), woken_ns);
            record.wake_latency_ns - stood_ns
        };
        let mut all: Vec<u64> = self.records.iter().map(late).collect();
        all.sort_unstable();
        all
    }

    /// Releases missed, without those that the cycle would not have missed had the processor not
    /// stood still.
    pub fn missed(&self) -> u64 {
        let excused = |pair: &[CycleRecord]| {
            let missed = pair[1].overruns - pair[0].overruns;
            // The cycle ended after this release plus `missed` periods.
            let from_ns = release_ns(&pair[1]);
            let until_ns = from_ns + (1 + missed) * self.period_ns;
            // Its own work and slack take less than three quarters of a period.
            let stood_ns = self.standstills.between(from_ns, until_ns);
            match 4 * (stood_ns + self.period_ns) > (4 * missed + 1) * self.period_ns {
                true => missed,
                false => 0,
            }
        };
        let excused: u64 = self.records.windows(2).map(excused).sum();
        let in_start_up = self.records.first().map_or(0, |record| record.overruns);
        self.report.overruns - in_start_up - excused
    }

    /// Share of the cycles during which the processor stood still.
    pub fn disturbed(&self) -> f64 {
        let stood = |record: &&CycleRecord| {
            let from_ns = release_ns(record);
            let stood_ns = self.standstills.between(from_ns, from_ns + self.period_ns);
            4 * stood_ns > self.period_ns
        };
        self.records.iter().filter(stood).count() as f64 / self.records.len().max(1) as f64
    }
}
