//! The strategy `follow`: whatever another program wants, no point is lost and no limit passed;
//! silence brakes; and a replay repeats it bit for bit.

use std::process::Stdio;
use std::time::Duration;

use ipc::{Domain, now_ns};
use messages::{Action, DesiredTwist, Hold, Outcome, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::fixture::{
    LIMITS, Place, Running, Witness, assert_within_limits, ended, eventually, is_still, program,
    repeats, speed, turn,
};

/// A policy of 10 Hz. Each twist counts for two of its periods.
const EVERY: Duration = Duration::from_millis(100);
const VALID_NS: u64 = 200_000_000;
/// Twists of a run.
const TWISTS: u32 = 100;
/// The deepest that a point may be in an occlusion or outside the image, px: a hair for the law,
/// the rest for a machine that wakes up late.
const DEEPEST_PX: f64 = 3.0;

/// What the policy wants: to the limits and beyond them, and seldom something else.
fn next(random: &mut ChaCha8Rng, before: [f64; 6]) -> [f64; 6] {
    match random.random_range(0..8) {
        0 | 1 => LIMITS.map(|most| most * random.random_range(-3.0..3.0)),
        2 => LIMITS.map(|most| 0.1 * most * random.random_range(-1.0..1.0)),
        _ => before,
    }
}

#[test]
fn whatever_a_policy_wants_no_point_is_lost_and_silence_brakes() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(36);
    let runs = repeats("guarded runs", 3, 100) as usize;
    for start in 0..runs {
        let place = Place::new();
        let mut witness = Witness::new(&place);
        let flight = "law.strategy = 'follow'\n[flight]\ndirectory = 'records'\nat_exit = true\n";
        let daemon = Running::start(place.vpcd(flight));
        let mut camera = place.hw_sim(start);
        camera.args(["--time-limit", "12"]).stdout(Stdio::piped());
        let camera = Running::start(camera);
        let domain = Domain::join(&place.domain()).unwrap();
        let mut policy = domain.publisher::<DesiredTwist>().unwrap();
        eventually("arming", || {
            (witness.ask(Action::Arm) == Outcome::Done).then_some(())
        });
        // It waits, armed.
        eventually("a hold", || {
            let waits = |record: &messages::CycleRecord| {
                (record.hold(), record.state) == (Some(Hold::Unwanted), TwistState::Holding.code())
            };
            witness.records().iter().any(waits).then_some(())
        });
        let mut wanted = LIMITS;
        for _ in 0..TWISTS {
            wanted = next(&mut random, wanted);
            let desired = DesiredTwist::until(wanted, now_ns() + VALID_NS);
            policy.publish(&desired).unwrap();
            std::thread::sleep(EVERY);
        }
        let silent_ns = now_ns();
        witness.commands().iter().for_each(assert_within_limits);
        let records = witness.records();
        let fastest = records.iter().map(|record| speed(&record.twist));
        assert!(fastest.fold(0.0, f64::max) <= 1.0 + 1e-9, "start {start}");
        let moved = records.iter().filter(|record| speed(&record.twist) > 0.0);
        let (moved, cycles) = (moved.count(), records.len());
        assert!(moved > 200, "start {start}: {moved} of {cycles} cycles");
        let last = witness.until("a twist of zero", is_still);
        let stood_ns = last.last().unwrap().stamp.published_ns - silent_ns;
        // The last twist counts for 0.1 s yet; then it brakes.
        assert!(stood_ns < 500_000_000, "it stands after {stood_ns} ns");
        let judged = camera.ended();
        let verdict: Value = serde_json::from_str(&judged.stdout).unwrap();
        let deep_px = |key: &str| -verdict[key].as_f64().unwrap();
        let deepest_px = deep_px("least_between_px").max(deep_px("least_clearance_px"));
        assert!(deepest_px < DEEPEST_PX, "start {start}: {verdict}");
        assert_eq!(
            verdict["violation"],
            Value::Null,
            "start {start}: {verdict}"
        );
        assert_eq!(verdict["limited"], 0, "start {start}: {verdict}");
        let flown = daemon.terminated();
        assert_eq!(flown.code, Some(0), "{flown:?}");
        let mut records = std::fs::read_dir(place.path("records")).unwrap();
        let record = records.next().unwrap().unwrap().path();
        let mut replay = testkit::command(program("vpcd"));
        replay.arg("replay").arg(record);
        let replayed = ended(replay);
        assert_eq!(replayed.code, Some(0), "{replayed:?}");
    }
}
