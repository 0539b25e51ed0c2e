//! The clocks `phase` and `fixed` with real processes and a camera whose rate is half a per cent
//! off, so that the fixed clock drifts through a whole period in seven seconds. When the frames
//! stop, the clock `phase` runs free again.
//!
//! The clock learns how late frames come. On a machine that stands still again and again they come
//! late again and again, and it waits for them: where that is so before one answer in twenty, a
//! miss of the bars shows nothing.

use std::process::Stdio;
use std::time::{Duration, Instant};

use ipc::{Domain, Observer};
use messages::PhaseCode;
use rustix::process::Signal;

use crate::fixture::{PERIOD_NS, Place, Running, WAKE_NS, eventually, program, root, tell, turn};
use crate::machine::{may_be_real_time, on_time, processors};
use crate::watch::{Standstills, Watch};

/// The camera's rate, Hz; the daemon's is 30.
const RATE: f64 = 29.85;
/// Time given to lock, and time watched after that: more than the drift needs for a period.
const LOCKING: Duration = Duration::from_secs(3);
const WATCHED: Duration = Duration::from_secs(8);
/// A start at which `previous` stays in front of an occlusion for good.
const START: &str = "82";

/// Between two looks at the clock, and lateness of one from which on the machine stood still, ns.
const TICK_NS: u64 = 1_000_000;
const LATE_NS: u64 = WAKE_NS;
/// Runs at most, until the machine does not stand still too often.
const RUNS: usize = 3;
/// Most of the answers before which the machine may stand still for a miss to count.
const UNFIT: f64 = 0.05;

/// An answer: when its features and its command were published, ns.
type Answer = [u64; 2];

/// Answers to features, and the grid's relation to the camera at the end. Without a camera the grid
/// must be free.
fn answers(clock: &str) -> (Vec<Answer>, PhaseCode) {
    let place = Place::new();
    let scenes = root().join("ipc/scene/scenes");
    let text = std::fs::read_to_string(scenes.join("paper-sim.toml")).unwrap();
    let other = text.replace("rate_hz = 30.0", &format!("rate_hz = {RATE}"));
    assert_ne!(text, other);
    let camera_scene = place.file("camera.toml", &other);
    let realtime = match may_be_real_time() {
        true => "[realtime]\npriority = 80",
        false => "",
    };
    let config = place.file("vpcd.toml", realtime);

    let mut daemon = testkit::command(program("vpcd"));
    daemon.arg("--config").arg(config);
    daemon.arg("--scene").arg(scenes.join("paper-sim.toml"));
    daemon
        .args(["--arm", "--strategy", "previous", "--clock", clock])
        .arg("--domain")
        .arg(place.domain());
    let daemon = Running::start(daemon.stderr(Stdio::null()));
    // The camera is an instrument here: its frames are to be on time whatever else the machine
    // does.
    let mut camera = on_time(testkit::command(program("hw-sim")), 70);
    camera.arg("--scene").arg(camera_scene);
    camera
        .arg("--starts")
        .arg(scenes.join("paper-sim-starts.csv"));
    camera.args(["--start", START, "--clock", "fixed", "--time-limit", "600"]);
    camera.arg("--domain").arg(place.domain());
    let camera = Running::start(camera.stdout(Stdio::null()));

    let domain = Domain::join(&place.domain()).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let start = Instant::now();
    let mut found = Vec::new();
    let mut answered = 0;
    while start.elapsed() < LOCKING + WATCHED {
        while let Some(twist) = observer.twist.oldest().unwrap() {
            let is_new = twist.features_sequence != answered;
            answered = twist.features_sequence;
            if is_new && answered != 0 && start.elapsed() > LOCKING {
                found.push([twist.features_published_ns, twist.stamp.published_ns]);
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let mut standing = || {
        let newest = observer.cycles.latest().unwrap()?;
        PhaseCode::from_code(newest.message.phase)
    };
    let with_camera = eventually("a record", &mut standing);
    drop(camera);
    eventually("a free grid without frames", || {
        (standing()? == PhaseCode::Free).then_some(())
    });
    drop(observer);
    drop(domain);
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    (found, with_camera)
}

fn share(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

#[test]
#[ignore = "half a minute: CI runs it in a line of its own"]
fn latency_is_small_and_constant_where_a_fixed_grid_drifts() {
    let _turn = turn();
    if !(0..RUNS).any(|_| compare()) {
        tell("phase: NOT SHOWN on this machine, which stood still too often");
    }
}

/// Latencies of the answers before which the machine did not stand still, ms, ascending; and the
/// share of the others.
fn latencies(answers: &[Answer], seen: &Standstills) -> (Vec<f64>, f64) {
    let is_quiet = |[from_ns, to_ns]: &&Answer| seen.between(from_ns - PERIOD_NS, *to_ns) == 0;
    let quiet = answers.iter().filter(is_quiet);
    let mut all: Vec<f64> = quiet.map(|[from, to]| (to - from) as f64 / 1e6).collect();
    all.sort_by(f64::total_cmp);
    let disturbed = 1.0 - all.len() as f64 / answers.len() as f64;
    (all, disturbed)
}

/// Compares the two clocks; whether that showed the promise. Panics where it is broken and the
/// machine was fit.
fn compare() -> bool {
    let (mut spreads, mut worst) = (Vec::new(), 0.0_f64);
    for clock in ["fixed", "phase"] {
        let watch = Watch::start(&processors(), TICK_NS, LATE_NS);
        let (answers, with_camera) = answers(clock);
        let (found, disturbed) = latencies(&answers, &watch.end());
        worst = worst.max(disturbed);
        if found.is_empty() {
            return false;
        }
        let (p1, p50, p99) = (share(&found, 0.01), share(&found, 0.5), share(&found, 0.99));
        tell(format!(
            "phase: clock {clock}: features to command p1 {p1:.2}, p50 {p50:.2}, p99 {p99:.2} ms over {} answers; the machine stood still before {:.1} %",
            answers.len(),
            100.0 * disturbed
        ));
        assert!(answers.len() > 200, "{clock}: {} answers", answers.len());
        spreads.push((p99 - p1, p99, with_camera));
    }
    let [(fixed, _, free), (phase, latest, following)] = spreads[..] else {
        unreachable!("two clocks")
    };
    assert_eq!(free, PhaseCode::Free);
    assert_ne!(following, PhaseCode::Free, "a free grid with frames");
    // Seen with ten builds beside: 32 ms against 0.7 ms.
    let is_kept = fixed > 20.0 && phase < 4.0 && latest < 6.0;
    assert!(is_kept || worst > UNFIT, "{fixed}, {phase}, {latest} ms");
    is_kept
}
