//! The loop never touches the heap: the real one, in its thread, with a counting allocator.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use controller::cycle::{Cycle, Pace};
use controller::flight::{DumpRequest, Recorder, queue};
use controller::machine::Machine;
use controller::reload::Reload;
use controller::service::Notifier;
use controller::shutdown::Stop;
use controller::telemetry::Telemetry;
use decision::{ControlStep, Rules};
use ipc::{CameraPorts, ControllerPorts, Domain, StopFile};
use memory_blob::MemoryFile;
use messages::{ClockMode, Features};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vpc::{Settings, Strategy};

use crate::fixture::{Place, scene_file, square, write_memory};

/// Cycles counted.
const CYCLES: u64 = 300;
/// Cycles before: connections are made with the first messages, and that allocates.
const WARM_UP: u64 = 100;

/// Periods that foresight simulates in a cycle: fewer than usual, so that the test is quick.
const PERIODS: u32 = 15;

#[global_allocator]
static ALLOCATOR: heap_meter::Meter = heap_meter::Meter;

/// The result of a run of the loop.
#[derive(Debug, Default)]
struct Tally {
    allocations: u64,
    stepped: u64,
    recalled: u64,
    recorded: u64,
}

/// Runs the loop for [`CYCLES`] cycles. In lockstep a camera in another thread shows random
/// features; on the other clocks the loop's own thread shows one before each cycle, however late
/// that is.
fn run(strategy: Strategy, clock: ClockMode) -> Tally {
    let place = Place::new();
    let scene = scene::Scene::read(&scene_file()).unwrap();
    let memory = place.path("m.vpcmem");
    write_memory(&scene, &memory, &mut ChaCha8Rng::seed_from_u64(1));
    let settings = Settings {
        strategy,
        foresight_steps: PERIODS,
        ..Settings::default()
    };
    let memory = MemoryFile::open(&memory, None).unwrap();
    let is_lockstep = clock == ClockMode::Lockstep;
    let rules = Rules {
        limits: [0.5, 0.5, 0.5, 1.0, 1.0, 1.0],
        change: [f64::INFINITY; 6],
        // Stale a period of the scene before.
        valid_ns: (!is_lockstep).then_some(38_333_333),
        brake_ns: 150_000_000,
        ramp_ns: 150_000_000,
        lost_ns: None,
        needs_robot: false,
        begins_armed: true,
        after_arrival: Default::default(),
    };
    let control = ControlStep::new(&scene, settings, Some(memory.view()), rules).unwrap();
    let pace = Pace {
        clock,
        period_ns: 1_000_000,
        margin_ns: 10_000,
        realtime: messages::RealTime::default(),
    };

    let domain = Domain::join(&place.domain()).unwrap();
    let ports = ControllerPorts::open(&domain).unwrap();
    let (producer, consumer) = queue::queue();
    let dump = DumpRequest::default();
    let telemetry = Telemetry {
        consumer,
        dump: dump.clone(),
        flight: Recorder::nowhere(1000),
        notifier: Notifier::default(),
        reload: Reload::default(),
        arm: None,
    };
    let recorder = telemetry.start(&place.domain()).unwrap();
    let stop_file = StopFile::open(domain.directory()).unwrap();
    let world = Machine::new(ports, stop_file, producer, dump, &control);
    let mut cycle = Cycle::new(pace, world, control);
    let (mut tally, never) = (Tally::default(), Stop::default());
    let mut count = |cycle: &mut Cycle<Machine>| {
        let before = heap_meter::calls();
        let record = cycle.run(&never).unwrap();
        let allocations = heap_meter::calls() - before;
        if let (true, Some(record)) = (cycle.count() > WARM_UP, record) {
            tally.allocations += allocations;
            tally.stepped += u64::from(record.status != 0);
            // Foresight asks for samples in its simulations.
            let is_followed = record.recalled == messages::RecallCode::Followed.code();
            tally.recalled += u64::from(is_followed || record.candidates > 0);
        }
    };
    if is_lockstep {
        let done = AtomicBool::new(false);
        std::thread::scope(|threads| {
            threads.spawn(|| show(&place.domain(), &scene, &done));
            // The camera ends also where the loop panics.
            let _end = SetOnDrop(&done);
            while cycle.count() < WARM_UP + CYCLES {
                count(&mut cycle);
            }
        });
    } else {
        let mut camera = CameraPorts::open(&domain).unwrap();
        for number in 0..WARM_UP + CYCLES {
            let features = Features::new(&round_the_image(number), ipc::now_ns());
            camera.features.publish(&features).unwrap();
            count(&mut cycle);
        }
    }
    cycle.stop().unwrap();
    drop(cycle);
    tally.recorded = recorder.join().unwrap().cycles();
    tally
}

struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Shows random features, each when the one before was answered.
fn show(domain: &Path, scene: &scene::Scene, done: &AtomicBool) {
    let domain = Domain::join(domain).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    while !done.load(Ordering::Relaxed) {
        let features = Features::new(&square(scene, &mut random), ipc::now_ns());
        let sent = camera.features.publish(&features).unwrap();
        // The loop ends without an answer to the last message.
        let patience = Duration::from_millis(200);
        let _ = camera.wait_for_answer(&sent, patience).unwrap();
    }
}

/// A square on its way around the image: features that jump would be refused.
fn round_the_image(number: u64) -> Vec<[f64; 2]> {
    let angle = number as f64 * 3e-3;
    let [u, v] = [angle.cos(), angle.sin()].map(|x| 512.0 + 330.0 * x);
    let corners = [[-60.0, -60.0], [60.0, -60.0], [60.0, 60.0], [-60.0, 60.0]];
    corners.map(|[x, y]| [u + x, v + y]).to_vec()
}

fn check(strategy: Strategy, clock: ClockMode) {
    let tally = run(strategy, clock);
    assert_eq!(tally.allocations, 0, "{strategy} {clock}: {tally:?}");
    // No record waits for longer than the queue holds them.
    assert_eq!(tally.recorded, WARM_UP + CYCLES, "{tally:?}");
    if clock != ClockMode::Lockstep {
        // How often the law steps there depends on what a busy machine misses; it is rehearsed in
        // any case.
        return;
    }
    // The law ran, and the memory was asked: zero is not for want of work.
    assert_eq!(tally.stepped, CYCLES, "{strategy}: {tally:?}");
    let is_recalled = tally.recalled > CYCLES / 20;
    assert_eq!(is_recalled, strategy.uses_memory(), "{strategy}: {tally:?}");
}

#[test]
fn the_counter_counts() {
    let before = heap_meter::calls();
    drop(std::hint::black_box(Box::new(1)));
    assert_eq!(heap_meter::calls() - before, 2);
}

#[test]
fn lockstep_never_allocates() {
    for strategy in [
        Strategy::Previous,
        Strategy::Knn { k: 5 },
        Strategy::Gpr,
        Strategy::Ibvs,
        Strategy::Foresight,
    ] {
        check(strategy, ClockMode::Lockstep);
    }
}

#[test]
fn the_clocks_of_live_robots_never_allocate() {
    for strategy in [Strategy::Gpr, Strategy::Foresight] {
        check(strategy, ClockMode::Fixed);
    }
    check(Strategy::Previous, ClockMode::Phase);
}
