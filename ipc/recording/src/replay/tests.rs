//! Runs that are recorded, cut anywhere, spoilt in places, and replayed.

use ipc::{Action, Reply};

use super::*;

/// One period of the scene's camera, ns.
const PERIOD: u64 = 33_333_333;
/// Frames between exposure and cycle, on the fixed clock.
const DELAY: u64 = 3;
const MEMORY: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../memory-blob/default/paper-sim.vpcmem"
);

/// A run on a camera that moves by itself.
struct Run {
    clock: ClockMode,
    strategy: StrategyCode,
    law: &'static str,
    armed: bool,
    /// What operators ask before which cycle, from 0.
    requests: &'static [(u64, Action)],
    /// How far the pattern is from the goal, px, in each cycle.
    offset: fn(u64) -> f64,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            clock: ClockMode::Lockstep,
            strategy: StrategyCode::Previous,
            law: "iterations = 20\n",
            armed: true,
            requests: &[],
            // There and back again.
            offset: |i| (120.0 - i as f64).abs() - 30.0,
        }
    }
}

impl Run {
    /// Its recording: a daemon's own pilot, cycle by cycle.
    fn flown(&self, cycles: u64) -> Recording {
        let Self { clock, law, .. } = self;
        let mut recording = Recording {
            scene: Some(Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()),
            scene_toml: Some(scene::PAPER_SIM.to_owned()),
            config_toml: Some(format!(
                "memory = '{MEMORY}'\n[law]\n{law}[cycle]\nclock = '{clock}'\n"
            )),
            ..Recording::default()
        };
        let state = match self.armed {
            true => TwistState::Moving,
            false => TwistState::Disarmed,
        };
        let blank = CycleRecord {
            clock: clock.code(),
            strategy: self.strategy.code(),
            np: 3,
            state: state.code(),
            ..CycleRecord::default()
        };
        let mut pilot = pilot(&recording, &Beside::default(), &blank).unwrap();
        let mut last = None;
        for i in 0..cycles {
            let now_ns = (100 + i) * PERIOD;
            let message = self.features(i, now_ns);
            let order = Order::after(last, &message.stamp);
            last = Some(message.stamp);
            for (_, action) in self.requests.iter().filter(|(cycle, _)| *cycle == i) {
                let mut request = Request::new(i, *action);
                request.stamp.published_ns = now_ns - 1000;
                let reply: Reply = pilot.request(&request);
                recording.requests.push(request);
                recording.replies.push(reply);
            }
            let mut record = CycleRecord {
                cycle: i + 1,
                ..blank
            };
            record.stamp.data_ns = now_ns;
            let inputs = Inputs {
                now_ns,
                features: Input::Message(Received { message, order }),
                robot: Input::Nothing,
                missed: 0,
                shutdown: false,
            };
            pilot.decide(&inputs, &mut record);
            recording.features.push(message);
            recording.cycles.push(record);
        }
        recording
    }

    fn features(&self, i: u64, now_ns: u64) -> Features {
        let offset = (self.offset)(i);
        let corners = [
            [312.0, 312.0],
            [712.0, 312.0],
            [712.0, 712.0],
            [312.0, 712.0],
        ];
        let points = corners.map(|[u, v]| [u + offset, v - 0.5 * offset]);
        let (exposed_ns, published_ns) = match self.clock {
            // Simulated time is another one, here it is faster.
            ClockMode::Lockstep => (3 * now_ns, 3 * now_ns),
            _ => (now_ns - DELAY * PERIOD - 2_000_000, now_ns - 1_000_000),
        };
        let mut message = Features::new(&points, exposed_ns);
        message.stamp.published_ns = published_ns;
        // The fifth frame is lost.
        message.stamp.sequence = if i < 5 { i + 1 } else { i + 2 };
        message
    }
}

fn flown(cycles: u64) -> Recording {
    Run::default().flown(cycles)
}

fn outcome(recording: &Recording) -> Outcome {
    replay(recording, &Beside::default(), 0.0).unwrap()
}

/// The same, recorded from after this many cycles on. The camera's last message waits for who comes late.
fn begun_after(recording: &Recording, cycles: usize) -> Recording {
    let mut late = recording.clone();
    late.cycles.drain(..cycles);
    late.features.drain(..cycles.saturating_sub(1));
    let begin_ns = late.cycles[0].stamp.data_ns;
    late.requests
        .retain(|request| request.stamp.published_ns > begin_ns);
    late
}

fn flip_a_bit(recording: &mut Recording, cycle: u64) {
    let mut cycles = recording.cycles.iter_mut();
    let twist = &mut cycles.find(|c| c.cycle == cycle).unwrap().twist;
    twist[2] = f64::from_bits(twist[2].to_bits() ^ 1);
}

#[test]
fn the_same_law_gives_the_same_bits() {
    let outcome = outcome(&flown(40));
    assert_eq!((outcome.cycles, outcome.steps, outcome.equal), (40, 40, 40));
    assert_eq!((outcome.largest, outcome.first), (0.0, None));
    assert_eq!((outcome.begins_at, outcome.taken_over.len()), (1, 0));
}

#[test]
fn another_law_is_told_from_the_recorded_one_and_so_is_one_bit() {
    let mut recording = flown(40);
    flip_a_bit(&mut recording, 18);
    let found = outcome(&recording);
    assert_eq!((found.equal, found.different), (39, 1));
    assert_eq!(found.first.unwrap().cycle, 18);
    let tolerant = replay(&recording, &Beside::default(), 1e-9).unwrap();
    assert_eq!((tolerant.equal, tolerant.different), (39, 0));

    recording.config_toml = Some("[law]\nmodel = \"target-depth\"\n".to_owned());
    let outcome = replay(&recording, &Beside::default(), 1e-9).unwrap();
    assert!(
        outcome.different > 20 && outcome.largest > 1e-6,
        "{outcome:?}"
    );
}

#[test]
fn from_where_its_state_is_known_a_recording_begun_in_mid_run_gives_the_same_bits() {
    let (previous, gpr, ibvs) = (
        StrategyCode::Previous,
        StrategyCode::Gpr,
        StrategyCode::Ibvs,
    );
    for (clock, strategy) in [
        (ClockMode::Lockstep, previous),
        (ClockMode::Lockstep, gpr),
        (ClockMode::Fixed, previous),
        (ClockMode::Fixed, gpr),
        (ClockMode::Fixed, ibvs),
    ] {
        let run = Run {
            clock,
            strategy,
            ..Run::default()
        };
        let whole = run.flown(240);
        assert_eq!(outcome(&whole).equal, 240);
        for cycles in (1..190).step_by(9) {
            let found = outcome(&begun_after(&whole, cycles));
            let name = format!("{clock}, {strategy}, {cycles}: {found:?}");
            assert_eq!(found.different, 0, "{name}");
            assert_eq!(found.begins_at, cycles as u64 + 1, "{name}");
            assert!(found.judged + 45 > found.cycles, "{name}");
            assert_eq!(found.equal, found.judged, "{name}");
        }
    }
}

#[test]
fn in_a_recording_begun_in_mid_run_one_bit_and_another_law_are_found() {
    for clock in [ClockMode::Lockstep, ClockMode::Fixed] {
        let run = Run {
            clock,
            ..Run::default()
        };
        let late = begun_after(&run.flown(150), 30);
        let judged_from = outcome(&late).taken_over[0].last + 1;
        for cycle in [judged_from, 100] {
            let mut changed = late.clone();
            flip_a_bit(&mut changed, cycle);
            let found = outcome(&changed);
            assert_eq!(found.different, 1, "{found:?}");
            assert_eq!(found.first.unwrap().cycle, cycle);
        }

        let mut other = late.clone();
        let text = other.config_toml.unwrap();
        other.config_toml = Some(text.replace("[law]", "[law]\nmodel = 'target-depth'"));
        let found = replay(&other, &Beside::default(), 1e-9).unwrap();
        assert!(found.different > 20, "{found:?}");
    }
}

#[test]
fn what_the_records_never_tell_is_not_compared_and_comes_close() {
    let run = Run {
        clock: ClockMode::Fixed,
        law: "nc = 3\n",
        ..Run::default()
    };
    let found = outcome(&begun_after(&run.flown(150), 20));
    assert_eq!((found.judged, found.different), (0, 0));
    let [stretch] = found.taken_over[..] else {
        panic!("{found:?}");
    };
    assert_eq!((stretch.first, stretch.last), (21, 150));
    assert!(
        stretch.largest_late < 1e-3 && stretch.largest_late < stretch.largest,
        "{stretch:?}"
    );
    assert!(found.to_string().contains("nothing was compared"));
}

#[test]
fn mode_and_requests_are_taken_over() {
    let run = Run {
        clock: ClockMode::Fixed,
        armed: false,
        requests: &[
            (60, Action::Arm),
            (100, Action::Disarm),
            (120, Action::Arm),
            (180, Action::Stop),
            (190, Action::Arm),
        ],
        ..Run::default()
    };
    let whole = run.flown(230);
    for cycles in [10, 59, 60, 62, 99, 101, 110, 150] {
        let found = outcome(&begun_after(&whole, cycles));
        assert_eq!(found.different, 0, "{cycles}: {found:?}");
        assert!(found.judged >= 10, "{cycles}: {found:?}");
    }
    // The second request to arm was lost, with the cycles about it.
    let mut deaf = whole.clone();
    deaf.requests.retain(|request| request.id != 120);
    deaf.cycles.drain(115..122);
    deaf.cycles.truncate(170 - 7);
    let found = outcome(&deaf);
    assert_eq!(found.different, 0, "{found:?}");
    assert!(found.equal > 170 - 7 - 45, "{found:?}");
    // Of a disarmed camera there is nothing to tell.
    let mut still = whole;
    still.cycles.truncate(60);
    assert_eq!(outcome(&begun_after(&still, 5)).judged, 0);
}

#[test]
fn a_detour_whose_number_is_not_known_is_taken_over() {
    let run = Run {
        strategy: StrategyCode::Gpr,
        // Stuck, but for noise.
        offset: |i| 150.0 + 0.1 * (i as f64).sin(),
        ..Run::default()
    };
    let whole = run.flown(400);
    let away = |cycle: &&CycleRecord| cycle.recalled == ipc::RecallCode::Detour.code();
    assert!(whole.cycles.iter().filter(away).count() > 50);
    for cycles in 1..150 {
        let found = outcome(&begun_after(&whole, cycles));
        assert_eq!(found.different, 0, "{cycles}: {found:?}");
        assert!(found.judged + 100 > found.cycles, "{cycles}: {found:?}");
    }
    let found = outcome(&begun_after(&whole, 100));
    assert!(found.taken_over.len() > 1, "{found:?}");
}

#[test]
fn features_that_were_not_recorded_are_counted_and_are_no_difference() {
    let mut recording = flown(20);
    recording.features.remove(6);
    let found = outcome(&recording);
    assert_eq!((found.missing_features, found.different), (1, 0));
    let [stretch] = found.taken_over[..] else {
        panic!("{found:?}");
    };
    assert_eq!((stretch.first, found.equal), (7, 20 - 3));
}

#[test]
fn cycles_that_were_not_recorded_are_counted_and_are_no_difference() {
    let mut recording = flown(120);
    recording.cycles.drain(40..45);
    let found = outcome(&recording);
    assert_eq!((found.missing_cycles, found.different), (5, 0));
    let [stretch] = found.taken_over[..] else {
        panic!("{found:?}");
    };
    assert_eq!(stretch.first, 46);
    assert!(stretch.last < 90, "{found:?}");
}
