//! The flight record: two runs and a replay are equal, and every changed decision is found.

use std::sync::atomic::AtomicU64;

use controller::arguments::Arguments;
use controller::config::Config;
use controller::flight::{About, Ring, file, queue};
use controller::loaded::Loaded;
use controller::replay::{Difference, ReplayError, Report, replay};
use decision::{ControlStep, Input, Inputs, Rules, snapshot};
use messages::{
    Action, CycleFlags, CycleRecord, DesiredTwist, Features, Hold, InputCode, RecallCode, Request,
    RobotState, Stamp, StrategyCode, TwistState,
};
use messages::{ValuesMut, Wire};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use recording::Recording;

use crate::fixture::{Place, scene_file, square, write_memory};

/// A minute at 30 Hz, in which each strategy has its turn.
const CYCLES: u64 = 1_800;
/// Periods that foresight simulates in a cycle: fewer than usual, as nothing here depends on what
/// it finds.
const PERIODS: u32 = 10;
const PERIOD_NS: u64 = 33_333_333;
const BEGIN_NS: u64 = 1_000_000_000;
/// In this cycle an operator stops it.
const STOP: u64 = 1_645;
/// In this cycle much is asked for.
const FLOOD: u64 = 777;

/// A control step with a memory, and what a file says about it.
struct Bench {
    loaded: Loaded,
    place: Place,
}

impl Bench {
    fn new() -> Self {
        Self::of(scene::PAPER_SIM, PERIODS)
    }

    /// For the text of a scene, and so many periods that foresight simulates.
    fn of(scene: &str, periods: u32) -> Self {
        let place = Place::new();
        let path = place.file("scene.toml", scene);
        let scene = scene::Scene::read(&path).unwrap();
        let memory = place.path("m.vpcmem");
        write_memory(&scene, &memory, &mut ChaCha8Rng::seed_from_u64(1));
        let settings = vpc::Settings {
            foresight_steps: periods,
            blind_s: 0.0,
            ..vpc::Settings::default()
        };
        let loaded = Loaded::open(&path, Some(&memory), settings).unwrap();
        Self { loaded, place }
    }

    fn control(&self) -> ControlStep<'_> {
        let rules = Rules {
            limits: self.loaded.scene().limits.velocity(),
            change: [f64::INFINITY; 6],
            valid_ns: Some(3 * PERIOD_NS),
            brake_ns: 150_000_000,
            ramp_ns: 150_000_000,
            lost_ns: Some(300_000_000),
            needs_robot: false,
            begins_armed: true,
            after_arrival: Default::default(),
        };
        self.loaded.control(rules).unwrap()
    }

    /// Flies for so many cycles and keeps the last `kept`. The last bit of a pixel in the cycle
    /// that is given is another.
    fn fly(&self, cycles: u64, kept: usize, flipped: Option<u64>) -> Ring {
        self.fly_from(BEGIN_NS, cycles, kept, flipped)
    }

    fn fly_from(&self, begin_ns: u64, cycles: u64, kept: usize, flipped: Option<u64>) -> Ring {
        let mut flight = Flight::new(self, begin_ns, kept);
        for _ in 0..cycles {
            flight.cycle(flipped);
            flight.take();
        }
        flight.ring
    }

    fn replay(&self, recording: &Recording) -> Result<Report, ReplayError> {
        replay(&mut self.control(), recording, None)
    }
}

/// The loop without ports, and the ordinary thread's part.
struct Flight<'m> {
    control: ControlStep<'m>,
    world: World,
    producer: queue::Producer,
    consumer: queue::Consumer,
    ring: Ring,
    cycle: u64,
}

impl<'m> Flight<'m> {
    fn new(bench: &'m Bench, begin_ns: u64, kept: usize) -> Self {
        let control = bench.control();
        let (mut producer, consumer) = queue::queue();
        producer.begin(&control, begin_ns);
        Self {
            world: World::new(bench.loaded.scene().clone(), begin_ns),
            control,
            producer,
            consumer,
            ring: Ring::new(kept),
            cycle: 0,
        }
    }

    fn cycle(&mut self, flipped: Option<u64>) {
        self.cycle += 1;
        let cycle = self.cycle;
        let mut record = CycleRecord {
            cycle,
            ..CycleRecord::default()
        };
        for request in self.world.requests(cycle, self.control.veto()) {
            let mut reply = self.control.request(&request, cycle);
            reply.stamp.published_ns = self.world.now_ns + 1;
            self.producer.reply(&reply);
            record.requests += 1;
        }
        let mut inputs = self.world.inputs(cycle);
        if let Input::Message(message) = &mut inputs.features
            && flipped == Some(cycle)
        {
            let pixel = &mut message.points[3];
            *pixel = f64::from_bits(pixel.to_bits() ^ 1);
        }
        record.stamp.data_ns = inputs.now_ns - 1000;
        record.receive_ns = 1000;
        self.control.decide(&inputs, &mut record);
        record.step_ns = cycle % 7 * 1_000_000;
        self.control.sent_at(inputs.now_ns + record.step_ns);
        if cycle.is_multiple_of(97) {
            self.control.unsent();
        } else {
            record.flags |= CycleFlags::SENT.0;
        }
        self.control.think();
        self.producer.cycle(&record, &inputs, &self.control);
    }

    /// Takes what is in the queues.
    fn take(&mut self) {
        while let Ok(cycle) = self.consumer.cycles.pop() {
            self.ring.push(cycle);
        }
        while let Ok(before) = self.consumer.states.pop() {
            let mut snapshot = snapshot::encode(before.cycle, &before.state).unwrap();
            snapshot.stamp.data_ns = before.taken_ns;
            self.ring.push_snapshot(snapshot);
        }
        while let Ok(reply) = self.consumer.replies.pop() {
            self.ring.push_reply(reply);
        }
    }
}

/// What a file of these cycles holds.
fn recording(ring: &Ring) -> Recording {
    Recording {
        features: ring.cycles().filter_map(|c| c.features).collect(),
        robot: ring.cycles().filter_map(|c| c.robot).collect(),
        desired: ring.cycles().filter_map(|c| c.desired).collect(),
        cycles: ring.cycles().map(|c| c.record).collect(),
        replies: ring.replies().copied().collect(),
        snapshots: ring.snapshots().copied().collect(),
        ..Recording::default()
    }
}

/// All that was decided, as bits.
fn bits(recording: &Recording) -> String {
    let snapshots = recording.snapshots.iter().map(|s| (s.cycle, s.bytes()));
    let snapshots: Vec<_> = snapshots.collect();
    format!("{:?}{:?}{snapshots:?}", recording.cycles, recording.replies)
}

fn difference(outcome: Result<Report, ReplayError>) -> Box<Difference> {
    match outcome {
        Err(ReplayError::Difference(difference)) => difference,
        other => panic!("{other:?}"),
    }
}

/// A camera, a robot and an operator with all their faults, the same ones in each run.
struct World {
    scene: scene::Scene,
    random: ChaCha8Rng,
    points: Vec<[f64; 2]>,
    sequence: u64,
    now_ns: u64,
}

impl World {
    fn new(scene: scene::Scene, now_ns: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let points = square(&scene, &mut random);
        Self {
            scene,
            random,
            points,
            sequence: 0,
            now_ns,
        }
    }

    /// Of operators who have seen the veto that stands.
    fn requests(&mut self, cycle: u64, veto: u32) -> Vec<Request> {
        let strategies = [
            (StrategyCode::Previous, 0),
            (StrategyCode::Knn, 5),
            (StrategyCode::Gpr, 0),
            (StrategyCode::Ibvs, 0),
            (StrategyCode::Foresight, 0),
            (StrategyCode::Follow, 0),
            // Refused.
            (StrategyCode::Knn, 0),
        ];
        let mut requests = Vec::new();
        if cycle.is_multiple_of(50) {
            requests.push(Request::arm(cycle, veto));
        }
        if cycle.is_multiple_of(200) {
            let (strategy, neighbours) = strategies[(cycle / 200) as usize % strategies.len()];
            requests.push(Request::strategy(cycle, strategy, neighbours));
            requests.push(Request::new(cycle, Action::Status));
        }
        match cycle {
            FLOOD => requests.extend([Request::new(cycle, Action::Arm); 9]),
            1234 => requests.push(Request::new(cycle, Action::Disarm)),
            STOP => requests.push(Request::new(cycle, Action::Stop)),
            _ => (),
        }
        requests
    }

    fn inputs(&mut self, cycle: u64) -> Inputs {
        let random = &mut self.random;
        self.now_ns += PERIOD_NS + random.random_range(0..20_000);
        for point in self.points.as_flattened_mut() {
            *point += random.random_range(-1.0..1.0);
        }
        if cycle.is_multiple_of(300) {
            self.points = square(&self.scene, random);
        }
        // The next one, one after a gap, or the first of a camera that started again.
        self.sequence = match random.random_range(0..100) {
            0 => self.sequence + 3,
            1 => 1,
            _ => self.sequence + 1,
        };
        let mut message = Features::new(&self.points, self.now_ns - 20_000_000);
        message.stamp.sequence = self.sequence;
        message.stamp.published_ns = self.now_ns - 1_000_000;
        let stamp = message.stamp;
        match random.random_range(0..200) {
            0 => message.visible = 0b0111,
            1 => message.points[4] = -900.0,
            2 => message.stamp.published_ns = self.now_ns + 1_000_000_000,
            _ => (),
        }
        let features = match random.random_range(0..100) {
            0..4 => Input::Nothing,
            4 => Input::Refused(Stamp {
                published_ns: 7,
                ..stamp
            }),
            5 => Input::Failed,
            // Long enough to come to rest, and every now and then to be disarmed.
            _ if cycle % 500 < 8 || (1_720..1_740).contains(&cycle) => Input::Nothing,
            _ => Input::Message(message),
        };
        let mut state = RobotState::free_camera([0.0, 0.1, 0.5], [0.0, 0.2, 3.0], self.now_ns);
        state.stamp.sequence = cycle;
        state.stamp.published_ns = self.now_ns;
        let twist = [0.2, -0.1, 0.3, 0.1, -0.4, 0.5].map(|v| v * random.random_range(-1.0..1.0));
        let mut wish = DesiredTwist::until(twist, self.now_ns + 100_000_000);
        (wish.stamp.sequence, wish.stamp.published_ns) = (cycle, self.now_ns);
        let desired = match random.random_range(0..10) {
            0..5 => Input::Nothing,
            5 => Input::Refused(wish.stamp),
            _ => Input::Message(wish),
        };
        Inputs {
            now_ns: self.now_ns,
            features,
            robot: match random.random_range(0..50) {
                0 => Input::Nothing,
                _ => Input::Message(state),
            },
            desired,
            missed: u32::from(random.random_range(0..100) == 0),
            suspended: false,
            shutdown: cycle == CYCLES,
        }
    }
}

#[test]
fn run_a_is_run_b_is_the_replay_of_a_byte_by_byte() {
    let bench = Bench::new();
    let ring = bench.fly(CYCLES, CYCLES as usize, None);
    let a = recording(&ring);
    assert_eq!(a.cycles.len() as u64, CYCLES);
    // Everything happened that can: equality is not for want of life.
    let count = |is: &dyn Fn(&CycleRecord) -> bool| a.cycles.iter().filter(|r| is(r)).count();
    for state in [
        TwistState::Moving,
        TwistState::Holding,
        TwistState::Braking,
        TwistState::Disarmed,
    ] {
        assert!(count(&|r| r.state == state.code()) > 10, "{state}");
    }
    for hold in [Hold::Hidden, Hold::OffImage, Hold::Clock, Hold::Operator] {
        assert!(count(&|r| r.hold == hold.code()) > 0, "{hold}");
    }
    assert!(count(&|r| r.recalled == RecallCode::Followed.code()) > 100);

    let b = recording(&bench.fly(CYCLES, CYCLES as usize, None));
    assert!(bits(&b) == bits(&a));

    let path = bench.place.file("a.mcap", "");
    let text = Config::print(&Arguments {
        scene: Some(scene_file()),
        ..Arguments::default()
    });
    let about = About::new(text.unwrap(), &bench.loaded);
    file::write(&path, &about, "request", &ring, &AtomicU64::new(0)).unwrap();
    let read = Recording::read(&path).unwrap();
    assert!(read.cut.is_none() && bits(&read) == bits(&a));
    assert_eq!(read.scene_toml(), Some(scene::PAPER_SIM));
    for recording in [&a, &read] {
        let report = bench.replay(recording).unwrap();
        assert_eq!((report.cycles, report.skipped), (CYCLES, 0));
        assert_eq!((report.first, report.last), (1, CYCLES));
        assert_eq!(report.snapshots_restored, 1);
        assert_eq!(report.snapshots_compared, (CYCLES - 1) / snapshot::EVERY);
    }
}

#[test]
fn a_recording_tells_the_size_of_markers() {
    let bench = Bench::of(scene::TAGS_ROBOT, PERIODS);
    let ring = bench.fly(500, 500, None);
    let path = bench.place.file("a.mcap", "");
    let about = About::new(String::new(), &bench.loaded);
    file::write(&path, &about, "request", &ring, &AtomicU64::new(0)).unwrap();
    let read = Recording::read(&path).unwrap();
    assert_eq!(read.scene_toml(), Some(scene::TAGS_ROBOT));
    assert_eq!(bench.replay(&read).unwrap().cycles, 500);
    let points = scene::TAGS_ROBOT.replace("marker_size = 0.03", "marker_size = 0.0");
    let points = Bench::of(&points, PERIODS);
    assert!(difference(points.replay(&read)).cycle < 100);
}

#[test]
fn a_run_with_one_pixel_one_bit_away_is_another() {
    let bench = Bench::new();
    let a = recording(&bench.fly(300, 300, None));
    let is_step =
        |r: &&CycleRecord| r.features_input == InputCode::Message.code() && r.iterations > 0;
    let moving = a.cycles[100..].iter().find(is_step).unwrap();
    let b = recording(&bench.fly(300, 300, Some(moving.cycle)));
    let pairs = a.cycles.iter().zip(&b.cycles);
    let first = pairs.map(|(a, b)| (a.cycle, format!("{a:?}") != format!("{b:?}")));
    assert_eq!(
        first.clone().find(|(_, differs)| *differs).unwrap().0,
        moving.cycle
    );
    // As if b had been recorded with the pixels of a.
    let forged = Recording {
        features: a.features.clone(),
        ..b
    };
    assert_eq!(difference(bench.replay(&forged)).cycle, moving.cycle);
}

/// Fields that say what was measured, not what was decided: a replay has nothing to compare them
/// with. Damage of a file is seen by its checksums.
const MEASURED: [&str; 14] = [
    "clock",
    "wake_latency_ns",
    "send_ns",
    "overruns",
    "features_age_ns",
    "lost_records",
    "realtime",
    "phase",
    "phase_error_ns",
    "minor_faults",
    "major_faults",
    "blocked",
    "allocations",
    "missed",
];

/// Fields that say what was received: changed, they show in a later cycle at the latest, or nothing
/// is found by them.
const RECEIVED: [&str; 12] = [
    "stamp",
    "features_input",
    "robot_input",
    "desired_input",
    "receive_ns",
    "step_ns",
    "features_seen",
    "robot_seen",
    "desired_seen",
    "requests",
    "flags",
    "cycle",
];

/// The record with the last bit of the number at `index`, over all fields, changed; its field.
fn changed(record: &CycleRecord, index: usize) -> Option<(CycleRecord, &'static str)> {
    let mut changed = *record;
    let mut left = index;
    let mut name = None;
    for (field, values) in changed.fields_mut() {
        if left >= field.count {
            left -= field.count;
            continue;
        }
        match values {
            ValuesMut::U8(numbers) => numbers[left] ^= 1,
            ValuesMut::U32(numbers) => numbers[left] ^= 1,
            ValuesMut::U64(numbers) => numbers[left] ^= 1,
            ValuesMut::I64(numbers) => numbers[left] ^= 1,
            // No bit of a NaN counts, but that it is one.
            ValuesMut::F64(numbers) if numbers[left].is_nan() => numbers[left] = 0.0,
            ValuesMut::F64(numbers) => {
                numbers[left] = f64::from_bits(numbers[left].to_bits() ^ 1);
            }
            ValuesMut::Stamp(stamp) => stamp.data_ns ^= 1,
        }
        name = Some(field.name);
        break;
    }
    name.map(|name| (changed, name))
}

/// Records of all kinds: with a message, without, refused, held, asked for things.
fn telling(cycles: &[CycleRecord]) -> Vec<usize> {
    let find =
        |is: &dyn Fn(&CycleRecord) -> bool| cycles.iter().skip(40).position(is).unwrap() + 40;
    let input = |code: InputCode| move |r: &CycleRecord| r.features_input == code.code();
    vec![
        find(&|r| r.recalled == 1 && input(InputCode::Message)(r)),
        find(&input(InputCode::Nothing)),
        find(&input(InputCode::Refused)),
        find(&|r| r.hold == Hold::Hidden.code()),
        find(&|r| r.requests == 3),
        find(&|r| r.state == TwistState::Braking.code()),
    ]
}

#[test]
fn the_last_bit_of_any_number_that_was_decided_is_missed() {
    let bench = Bench::new();
    let whole = recording(&bench.fly(1000, 1000, None));
    let mut control = bench.control();
    let mut tried = 0;
    // Every fifth number of a record, by kind another one.
    let apart = if testkit::is_long() { 1 } else { 5 };
    for (kind, at) in telling(&whole.cycles).into_iter().enumerate() {
        // From the snapshot before it to the one after it.
        let cycle = whole.cycles[at].cycle;
        let mut before = whole.snapshots.iter().rev().map(|s| s.cycle);
        let from = before.find(|s| *s <= cycle).unwrap() - whole.cycles[0].cycle;
        let (from, to) = (from as usize, (at + 34).min(1000));
        let mut forged = Recording {
            cycles: whole.cycles[from..to].to_vec(),
            ..whole.clone()
        };
        for index in 0.. {
            let record = &whole.cycles[at];
            let Some((changed, field)) = changed(record, index) else {
                break;
            };
            if index % apart != kind % apart || MEASURED.contains(&field) {
                continue;
            }
            tried += 1;
            forged.cycles[at - from] = changed;
            let outcome = replay(&mut control, &forged, None);
            if RECEIVED.contains(&field) {
                let skips = |report: &Report| report.skipped > skipped_at_begin(&whole, from);
                let is_seen = outcome.as_ref().map_or(true, skips);
                // Nobody looks at the exposure, or at a wish, of a message that was refused.
                let is_refused = |code: u32| code == InputCode::Refused.code();
                let is_moot = match field {
                    "features_seen" => is_refused(record.features_input),
                    "desired_seen" => is_refused(record.desired_input),
                    _ => false,
                };
                assert!(is_seen || is_moot, "{field}: {outcome:?}");
            } else {
                assert_eq!(difference(outcome).cycle, record.cycle, "{field}");
            }
        }
    }
    assert!(tried * apart > 300, "{tried}");
}

/// Cycles before the first snapshot.
fn skipped_at_begin(recording: &Recording, from: usize) -> u64 {
    let first = recording.cycles[from].cycle;
    let mut snapshots = recording.snapshots.iter().map(|s| s.cycle);
    snapshots.find(|cycle| *cycle >= first).unwrap() - first
}

#[test]
fn the_last_bit_of_any_byte_of_a_snapshot_is_missed() {
    let bench = Bench::new();
    let whole = recording(&bench.fly(400, 400, None));
    let mut control = bench.control();
    let (before, at) = (whole.snapshots[7], whole.snapshots[8]);
    let around = before.cycle as usize - 1..at.cycle as usize;
    let length = at.length as usize;
    let bytes = testkit::repeats("bytes of a snapshot", length / 97, length);
    for index in (0..bytes).map(|k| k * length / bytes) {
        let mut changed = at;
        changed.state[index] ^= 1;
        let forged = Recording {
            snapshots: vec![before, changed],
            cycles: whole.cycles[around.clone()].to_vec(),
            ..whole.clone()
        };
        match replay(&mut control, &forged, None) {
            Err(ReplayError::Difference(difference)) => assert_eq!(difference.cycle, at.cycle),
            Err(ReplayError::Snapshot(error)) => assert_eq!(error.cycle, at.cycle),
            Ok(report) => panic!("byte {index}: {report:?}"),
        }
    }
}

#[test]
fn a_replay_begins_at_any_snapshot_and_goes_on_after_a_gap() {
    let bench = Bench::new();
    let ring = bench.fly(1000, 200, None);
    let late = recording(&ring);
    let first = late.snapshots[0].cycle;
    let early = first - late.cycles[0].cycle;
    assert!(early < 32, "{early}");
    let report = bench.replay(&late).unwrap();
    assert_eq!((report.snapshots_restored, report.skipped), (1, early));
    assert_eq!(report.cycles, late.cycles.len() as u64 - early);
    let whole = recording(&bench.fly(1000, 1000, None));
    let same = whole.cycles[800..].iter().zip(&late.cycles);
    assert!(
        same.map(|(a, b)| (format!("{a:?}"), format!("{b:?}")))
            .all(|(a, b)| a == b)
    );

    // In mid-run, as a recorder that came late.
    let mut torn = whole.clone();
    torn.cycles.drain(100..103);
    let report = bench.replay(&torn).unwrap();
    assert!((1..32).contains(&report.skipped), "{report:?}");
    assert_eq!(report.cycles + report.skipped, 997);
    assert_eq!(report.snapshots_restored, 2);

    // A message that a cycle saw is missing.
    let seen = whole.cycles[500..].iter();
    let mut seen = seen.filter(|r| r.features_input == InputCode::Message.code());
    let seen = *seen.next().unwrap();
    let mut torn = whole.clone();
    torn.features
        .retain(|message| message.stamp != seen.features_seen);
    let report = bench.replay(&torn).unwrap();
    assert!((1..=32).contains(&report.skipped), "{report:?}");
    assert_eq!(report.snapshots_restored, 2);

    let report = replay(&mut bench.control(), &whole, Some(600)).unwrap();
    assert_eq!((report.last, report.snapshots_restored), (600, 1));
    assert!(report.first > 600 - 32 && report.cycles <= 32);
}

#[test]
fn successive_daemons_are_replayed_each_from_its_start() {
    let bench = Bench::new();
    let mut both = recording(&bench.fly(200, 200, None));
    let second = recording(&bench.fly_from(3600 * BEGIN_NS, 300, 300, None));
    both.features.extend(second.features);
    both.robot.extend(second.robot);
    both.desired.extend(second.desired);
    both.cycles.extend(second.cycles);
    both.snapshots.extend(second.snapshots);
    both.replies.extend(second.replies);
    let report = bench.replay(&both).unwrap();
    assert_eq!((report.cycles, report.skipped), (500, 0));
    assert_eq!((report.snapshots_restored, report.last), (2, 300));
}

#[test]
fn lost_records_are_counted_and_the_next_snapshot_comes_at_once() {
    // Nothing here depends on what is foreseen.
    let bench = Bench::of(scene::PAPER_SIM, 1);
    let most = queue::CAPACITY as u64;
    let mut flight = Flight::new(&bench, BEGIN_NS, 20_000);
    for _ in 0..most {
        flight.cycle(None);
        assert_eq!(flight.producer.lost(), 0);
    }
    flight.cycle(None);
    assert_eq!(flight.producer.lost(), 1);
    flight.take();
    flight.cycle(None);
    flight.take();
    let report = bench.replay(&recording(&flight.ring)).unwrap();
    assert_eq!((report.cycles, report.skipped), (most + 1, 0));
    assert_eq!((report.snapshots_restored, report.last), (2, most + 2));
}

#[test]
fn a_damaged_file_is_seen_to_be() {
    let bench = Bench::new();
    let ring = bench.fly(64, 64, None);
    let about = About::new("[law]\n".to_owned(), &bench.loaded);
    let path = bench.place.file("f.mcap", "");
    file::write(&path, &about, "request", &ring, &AtomicU64::new(0)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let is_seen = |bytes: &[u8]| {
        let path = bench.place.file("damaged.mcap", bytes);
        Recording::read(&path).map_or(true, |recording| recording.cut.is_some())
    };
    assert!(!is_seen(&bytes));
    // The closing magic says nothing.
    let whole = bytes.len() - 8;
    for at in (0..whole).step_by(if cfg!(debug_assertions) { 997 } else { 101 }) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1;
        assert!(is_seen(&damaged), "byte {at} of {whole}");
    }
    for length in [0, 7, 8, 15, 64, 1000, whole / 2, whole - 100] {
        assert!(is_seen(&bytes[..length]), "{length} bytes");
    }
}

#[test]
fn another_law_is_found() {
    let bench = Bench::new();
    let flown = recording(&bench.fly(700, 700, None));
    let mut other = Bench::new();
    other.loaded.settings.lambda *= 1.0 + f64::EPSILON;
    let found = difference(other.replay(&flown));
    // The gain of IBVS, which is the strategy from cycle 600 on.
    assert!((600..700).contains(&found.cycle), "{found}");
}
