//! The flight record: two runs are one, a replay is the run, and no bit changes unseen.

use controller::arguments::Arguments;
use controller::config::Config;
use controller::flight::tap::tap;
use controller::flight::words::{fill, words_of};
use controller::flight::{
    About, Difference, Flight, FlightRecord, Key, Report, Ring, Wish, replay, replay::repeat,
};
use controller::gate::Input;
use controller::law::Law;
use controller::pilot::{Inputs, Pilot};
use controller::supervisor::Rules;
use ipc::{
    Action, CycleRecord, Features, Hold, Order, Received, Request, RobotState, Stamp, StrategyCode,
    TwistState,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fixture::{Place, scene_file, square, write_memory};

/// Ten minutes at 30 Hz.
const CYCLES: u64 = 18_000;
const PERIOD_NS: u64 = 33_333_333;
/// In this cycle more is asked for than a record tells.
const FLOOD: u64 = 777;

/// Laws with a memory, and what a file says about them.
struct Bench {
    config: Config,
    place: Place,
}

impl Bench {
    fn new() -> Self {
        let place = Place::new();
        let scene = scene::Scene::read(&scene_file()).unwrap();
        let memory = place.path("m.vpcmem");
        write_memory(&scene, &memory, &mut ChaCha8Rng::seed_from_u64(1));
        let arguments = Arguments {
            scene: Some(scene_file()),
            memory: Some(memory),
            ..Arguments::default()
        };
        let config = Config::read(&arguments).unwrap();
        Self { config, place }
    }

    fn law(&self) -> Law {
        let config = &self.config;
        Law::open(&config.scene, config.memory.as_deref(), config.settings).unwrap()
    }

    fn pilot(&self) -> Pilot {
        let mut law = self.law();
        law.go_live(100_000_000);
        let limits = law.scene().limits;
        let (v, w) = (limits.linear, limits.angular);
        let rules = Rules {
            limits: [v, v, v, w, w, w],
            brake_ns: 150_000_000,
            lost_ns: Some(300_000_000),
            armed: true,
        };
        Pilot::new(law, Some(2 * PERIOD_NS), rules)
    }

    /// Flies for so many cycles and keeps the last `kept`. The last bit of the pixel that is given, counted over all
    /// cycles, is another.
    fn fly(&self, cycles: u64, kept: usize, flipped: Option<u64>) -> Flight {
        let mut pilot = self.pilot();
        let about = About::new(&self.config, pilot.law());
        let mut world = World::new(pilot.law().scene().clone());
        let (mut tap, mut tail) = tap(Wish::default());
        let mut ring = Ring::new(kept);
        tap.begin(&pilot);
        for cycle in 1..=cycles {
            for request in world.requests(cycle) {
                let mut reply = pilot.request(&request);
                tap.ask(&request, &mut reply);
            }
            let mut inputs = world.inputs(cycle);
            if let Input::Message(received) = &mut inputs.features
                && flipped == Some(cycle)
            {
                let pixel = &mut received.message.points[3];
                *pixel = f64::from_bits(pixel.to_bits() ^ 1);
            }
            let mut told = CycleRecord {
                cycle,
                ..CycleRecord::default()
            };
            let answer = pilot.decide(&inputs, &mut told);
            let sent = !cycle.is_multiple_of(97);
            if !sent {
                pilot.unsent();
            }
            tap.cycle(inputs, answer, sent, &told, &pilot);
            while let Some(record) = tail.pop() {
                ring.push(record);
            }
            while let Some(key) = tail.pop_key() {
                ring.push_key(key);
            }
        }
        let (keys, records) = ring.copy();
        Flight {
            about,
            keys,
            records,
        }
        .whole()
    }

    fn replay(&self, flight: &Flight) -> Result<Report, Box<Difference>> {
        replay(&mut self.pilot(), flight, None)
    }
}

trait Whole {
    fn whole(self) -> Self;
}

impl Whole for Flight {
    /// As it is after writing and reading.
    fn whole(mut self) -> Self {
        (self.about.keys, self.about.records) = (self.keys.len(), self.records.len());
        self
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
    fn new(scene: scene::Scene) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let points = square(&scene, &mut random);
        Self {
            scene,
            random,
            points,
            sequence: 0,
            now_ns: 1_000_000_000,
        }
    }

    fn requests(&mut self, cycle: u64) -> Vec<Request> {
        let strategies = [
            (StrategyCode::Previous, 0),
            (StrategyCode::Knn, 5),
            (StrategyCode::Gpr, 0),
            (StrategyCode::Ibvs, 0),
            // Refused.
            (StrategyCode::Knn, 0),
        ];
        let mut requests = Vec::new();
        if cycle.is_multiple_of(50) {
            requests.push(Request::new(cycle, Action::Arm));
        }
        if cycle.is_multiple_of(200) {
            let (strategy, neighbours) = strategies[(cycle / 200) as usize % strategies.len()];
            requests.push(Request::strategy(cycle, strategy, neighbours));
            requests.push(Request::new(cycle, Action::Status));
        }
        match cycle {
            FLOOD => requests.extend([Request::new(cycle, Action::Arm); 9]),
            1234 => requests.push(Request::new(cycle, Action::Disarm)),
            2345 => requests.push(Request::new(cycle, Action::Stop)),
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
        self.sequence += 1;
        let mut message = Features::new(&self.points, self.now_ns - 20_000_000);
        message.stamp.sequence = self.sequence;
        message.stamp.published_ns = self.now_ns - 1_000_000;
        let stamp = message.stamp;
        let order = match random.random_range(0..100) {
            0 => Order::Gap { missed: 2 },
            1 => Order::Restarted,
            _ if cycle == 1 => Order::First,
            _ => Order::Next,
        };
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
            _ if cycle % 500 < 8 || (3000..3020).contains(&cycle) => Input::Nothing,
            _ => Input::Message(Received { message, order }),
        };
        let mut state = RobotState::free_camera([0.0, 0.1, 0.5], [0.0, 0.2, 3.0], self.now_ns);
        state.stamp.published_ns = self.now_ns;
        Inputs {
            now_ns: self.now_ns,
            features,
            robot: match random.random_range(0..50) {
                0 => Input::Nothing,
                _ => Input::Message(Received {
                    message: state,
                    order: Order::Next,
                }),
            },
            missed: u64::from(random.random_range(0..100) == 0),
            shutdown: cycle == CYCLES,
        }
    }
}

#[test]
fn run_a_is_run_b_is_the_replay_of_a_byte_by_byte() {
    let bench = Bench::new();
    let a = bench.fly(CYCLES, CYCLES as usize, None);
    let bytes = a.to_bytes();
    assert_eq!(a.records.len() as u64, CYCLES);
    // Everything happened that can: equality is not for want of life.
    for state in [
        TwistState::Moving,
        TwistState::Holding,
        TwistState::Braking,
        TwistState::Disarmed,
    ] {
        let count = a.records.iter().filter(|r| r.told.state == state.code());
        assert!(count.count() > 10, "{state}");
    }
    for hold in [Hold::Hidden, Hold::OffImage, Hold::Clock, Hold::Operator] {
        assert!(
            a.records.iter().any(|r| r.told.hold == hold.code()),
            "{hold}"
        );
    }
    let recalled = a.records.iter().filter(|r| r.told.recalled == 1);
    assert!(recalled.count() > 500);

    assert!(bench.fly(CYCLES, CYCLES as usize, None).to_bytes() == bytes);

    let report = bench.replay(&a).unwrap();
    assert_eq!((report.cycles, report.skipped), (CYCLES - 1, 1));
    assert_eq!((report.first, report.last), (1, CYCLES));
    // The start, and after the flood of requests.
    assert_eq!(report.keys_restored, 2);
    assert!(report.keys_compared > CYCLES / 40);

    let mut again = a.clone();
    let mut pilot = bench.pilot();
    for (record, recorded) in again.records.iter_mut().zip(&a.records) {
        if recorded.cycle() == FLOOD + 1 {
            let key = a.keys.iter().find(|key| key.cycle == FLOOD + 1);
            pilot.restore(&key.unwrap().state);
        }
        if recorded.cycle() != FLOOD {
            *record = repeat(&mut pilot, recorded);
        }
    }
    assert!(again.to_bytes() == bytes);
    assert!(Flight::parse(&bytes, "a").unwrap() == a);
}

#[test]
fn a_run_with_one_pixel_one_bit_away_is_another() {
    let bench = Bench::new();
    let a = bench.fly(300, 300, None);
    let moving = a.records[100..]
        .iter()
        .find(|r| matches!(r.inputs.features, Input::Message(_)) && r.told.iterations > 0)
        .unwrap();
    let cycle = moving.cycle();
    let b = bench.fly(300, 300, Some(cycle));
    let first = a.records.iter().zip(&b.records).find(|(a, b)| a != b);
    assert_eq!(first.unwrap().0.cycle(), cycle);
    // As if b had been recorded with the pixel of a.
    let mut forged = b.clone();
    forged.records[cycle as usize - 1].inputs = moving.inputs;
    let difference = bench.replay(&forged).unwrap_err();
    assert_eq!(difference.cycle, cycle);
}

/// Records of all kinds: with a message, without, refused, held, asked for things.
fn telling(flight: &Flight) -> Vec<usize> {
    let find = |is: &dyn Fn(&FlightRecord) -> bool| {
        let records = flight.records.iter();
        records.skip(40).position(is).unwrap() + 40
    };
    vec![
        find(&|r| r.told.recalled == 1 && matches!(r.inputs.features, Input::Message(_))),
        find(&|r| r.inputs.features == Input::Nothing),
        find(&|r| matches!(r.inputs.features, Input::Refused(_))),
        find(&|r| r.told.hold == Hold::Hidden.code()),
        find(&|r| r.asked.count == 2),
        find(&|r| r.told.state == TwistState::Braking.code()),
    ]
}

#[test]
fn the_last_bit_of_any_word_of_a_record_or_key_is_missed() {
    let bench = Bench::new();
    let flight = bench.fly(1000, 1000, None);
    let mut pilot = bench.pilot();
    let layout = FlightRecord::layout();
    let mut tried = 0;
    for at in telling(&flight) {
        let words = words_of(&mut flight.records[at].clone());
        for index in 0..words.len() {
            let mut changed = words.clone();
            changed[index] ^= 1;
            let Ok(mut record) = fill(FlightRecord::blank(), &changed) else {
                continue;
            };
            // A word of a message that did not come stands in files only, which are refused.
            if words_of(&mut record) == words {
                continue;
            }
            tried += 1;
            let mut forged = flight.clone();
            let cycle = forged.records[at].cycle();
            forged.records[at] = record;
            let name = layout.word(index).unwrap().0;
            if name == "told.cycle" {
                // Another cycle altogether: files with it are refused.
                continue;
            }
            let difference = replay(&mut pilot, &forged, Some(cycle));
            assert_eq!(difference.expect_err(&name).cycle, cycle, "{name}");
        }
    }
    assert!(tried > 600, "{tried}");

    let key = flight.keys[8];
    let words = words_of(&mut key.clone());
    for index in 0..words.len() {
        let mut changed = words.clone();
        changed[index] ^= 1;
        let Ok(changed) = fill(Key::blank(), &changed) else {
            continue;
        };
        let name = Key::layout().word(index).unwrap().0;
        if changed.cycle != key.cycle || words_of(&mut changed.clone()) == words {
            continue;
        }
        // Met on the way, and as the beginning.
        for keys in [vec![flight.keys[7], changed], vec![changed, flight.keys[9]]] {
            let forged = Flight {
                keys,
                ..flight.clone()
            };
            let outcome = bench_replay_from(&mut pilot, forged, key.cycle);
            assert_eq!(outcome.expect_err(&name).cycle, key.cycle, "{name}");
        }
    }
}

/// Replays two keys' worth of records about a cycle.
fn bench_replay_from(
    pilot: &mut Pilot,
    mut flight: Flight,
    cycle: u64,
) -> Result<Report, Box<Difference>> {
    let first = flight.keys[0].cycle;
    let about = first..=cycle + 1;
    flight
        .records
        .retain(|record| about.contains(&record.cycle()));
    // A seal that is wrong in itself is seen without a replay; the replay sees it too.
    replay(pilot, &flight, None)
}

#[test]
fn a_replay_begins_at_any_key_and_goes_on_after_a_gap() {
    let bench = Bench::new();
    let whole = bench.fly(3000, 3000, None);
    let late = bench.fly(3000, 500, None);
    assert!(
        (469..=500).contains(&late.records.len()),
        "{}",
        late.records.len()
    );
    assert_eq!(late.records[0].cycle(), late.keys[0].cycle);
    let report = bench.replay(&late).unwrap();
    assert_eq!((report.keys_restored, report.skipped), (1, 0));
    assert_eq!(report.cycles, late.records.len() as u64);
    let from = whole.records.len() - late.records.len();
    assert!(whole.records[from..] == late.records);

    let mut torn = whole.clone();
    torn.records.drain(100..103);
    let report = bench.replay(&torn).unwrap();
    assert!((1..32).contains(&(report.skipped - 1)), "{report:?}");
    assert_eq!(report.cycles + report.skipped, 2997);

    let report = replay(&mut bench.pilot(), &whole, Some(1500)).unwrap();
    assert_eq!((report.last, report.keys_restored), (1500, 1));
    assert!(report.first > 1500 - 32 && report.cycles <= 32);
}

#[test]
fn lost_records_are_counted_and_the_next_key_comes_at_once() {
    let bench = Bench::new();
    let mut pilot = bench.pilot();
    let mut world = World::new(pilot.law().scene().clone());
    let (mut tap, mut tail) = tap(Wish::default());
    tap.begin(&pilot);
    let most = controller::flight::tap::QUEUE as u64;
    let mut fly = |cycle, pilot: &mut Pilot| {
        let inputs = world.inputs(cycle);
        let mut told = CycleRecord {
            cycle,
            ..CycleRecord::default()
        };
        let answer = pilot.decide(&inputs, &mut told);
        tap.cycle(inputs, answer, true, &told, pilot);
        tap.lost()
    };
    for cycle in 1..=most {
        assert_eq!(fly(cycle, &mut pilot), 0);
    }
    assert_eq!(fly(most + 1, &mut pilot), 1);
    let mut ring = Ring::new(20_000);
    while let Some(record) = tail.pop() {
        ring.push(record);
    }
    fly(most + 2, &mut pilot);
    while let Some(record) = tail.pop() {
        ring.push(record);
    }
    while let Some(key) = tail.pop_key() {
        ring.push_key(key);
    }
    let (keys, records) = ring.copy();
    let flight = Flight {
        about: About::new(&bench.config, pilot.law()),
        keys,
        records,
    };
    let report = bench.replay(&flight).unwrap();
    assert_eq!((report.cycles, report.skipped), (most + 1, 0));
    assert_eq!((report.keys_restored, report.last), (2, most + 2));
}

#[test]
fn a_damaged_file_is_refused_with_the_place() {
    let bench = Bench::new();
    let flight = bench.fly(200, 200, None);
    let bytes = flight.to_bytes();
    let refused = |bytes: &[u8]| Flight::parse(bytes, "f").unwrap_err().to_string();
    let record_size = 8 * FlightRecord::layout().count();
    let key_size = 8 * Key::layout().count();
    let records = bytes.len() - flight.records.len() * record_size;
    let keys = records - flight.keys.len() * key_size;
    // Every byte of the head, every word of a few records and of a key.
    let some = [0, 3, 77, 199].map(|k| records + k * record_size);
    let words = some
        .into_iter()
        .map(|start| (start, record_size))
        .chain([(keys + key_size, key_size)])
        .flat_map(|(start, size)| (start..start + size).step_by(8));
    let head = (0..keys).step_by(if cfg!(debug_assertions) { 7 } else { 1 });
    for at in (0..64).chain(head).chain(words) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1;
        let message = refused(&damaged);
        assert!(message.starts_with("f: byte "), "{at}: {message}");
        assert!(message.contains("; allowed: "), "{at}: {message}");
        if at >= keys {
            let (start, size) = match at.checked_sub(records) {
                Some(into) => (at - into % record_size, record_size),
                None => (at - (at - keys) % key_size, key_size),
            };
            let offset: usize = message["f: byte ".len()..]
                .split(':')
                .next()
                .unwrap()
                .parse()
                .unwrap();
            // The next one may be the first to show that the order is broken.
            assert!((start..=start + size).contains(&offset), "{at}: {message}");
        }
    }
    for length in [
        0,
        7,
        8,
        15,
        16,
        63,
        64,
        1000,
        keys,
        records,
        bytes.len() - 1,
    ] {
        let message = refused(&bytes[..length]);
        assert!(message.starts_with("f: byte "), "{length}: {message}");
    }
    let message = refused(&bytes[..bytes.len() - 8]);
    assert!(
        message.contains(&format!("{} bytes (", bytes.len())),
        "{message}"
    );
    let mut long = bytes.clone();
    long.push(0);
    assert!(refused(&long).contains("the end of the file"));
    let mut other = flight.clone();
    other.about.record_fields[2].name = "inputs.then_ns".to_owned();
    let message = refused(&other.to_bytes());
    assert!(message.contains("another version of vpcd"), "{message}");
    assert!(
        message.contains("record_fields[2] = inputs.then_ns"),
        "{message}"
    );
}

#[test]
fn settings_and_place_survive_the_file() {
    let bench = Bench::new();
    let flight = bench.fly(10, 10, None);
    let path = bench.place.file("f.flight", flight.to_bytes());
    let back = Flight::read(&path).unwrap();
    assert!(back == flight);
    assert_eq!(
        back.about.settings.settings().unwrap(),
        bench.config.settings
    );
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..100 {
        let mut settings = bench.config.settings;
        settings.lambda = random.random_range(1e-6..100.0);
        settings.trigger_px = f64::from_bits(random.next_u64() >> 12 | 0x4000_0000_0000_0000);
        settings.solver.tolerance = random.random_range(1e-15..1.0);
        let about: controller::flight::about::SettingsAbout = (&settings).into();
        let text = serde_json::to_string(&about).unwrap();
        let back: controller::flight::about::SettingsAbout = serde_json::from_str(&text).unwrap();
        assert_eq!(back.settings().unwrap(), settings);
    }
}
