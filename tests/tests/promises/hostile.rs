//! Hostile input: messages of random bytes, floods, subscribers that never read, peers that come
//! and go. No panic, no command outside the limits, no more missed releases than without.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::ensure;
use ipc::{CameraPorts, Domain, Observer, OperatorPorts, RobotPorts, now_ns};
use messages::{Features, Request, RobotState, Stamp};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fixture::{
    EndOnDrop, Place, Running, Witness, assert_within_limits, repeats, tell, turn,
};
use crate::stall::fairly;

/// A number that is likely to cause a failure.
fn nasty(random: &mut impl Rng) -> f64 {
    match random.random_range(0..9) {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => f64::NEG_INFINITY,
        3 => f64::MAX,
        4 => f64::MIN_POSITIVE / 4.0,
        5 => -0.0,
        6 => f64::from_bits(random.random()),
        7 => random.random_range(-1e4..1e4),
        _ => random.random_range(0.0..1024.0),
    }
}

fn nasty_count(random: &mut impl Rng) -> u32 {
    match random.random_range(0..4) {
        0 => random.random(),
        1 => random.random_range(0..16),
        _ => 4,
    }
}

fn nasty_stamp(sequence: u64, random: &mut impl Rng) -> Stamp {
    let now = now_ns();
    let mut time = || match random.random_range(0..6) {
        0 => random.random(),
        1 => 0,
        2 => u64::MAX,
        _ => now,
    };
    Stamp {
        sequence,
        published_ns: time(),
        data_ns: time(),
    }
}

/// Corners in the order of the pattern, anywhere in the image.
fn quadrangle(random: &mut impl Rng) -> [[f64; 2]; 4] {
    let center: [f64; 2] = std::array::from_fn(|_| random.random_range(150.0..874.0));
    let turn = random.random_range(0.0..TAU);
    std::array::from_fn(|k| {
        let (sin, cos) = (turn + TAU / 4.0 * k as f64).sin_cos();
        let reach = random.random_range(20.0..150.0);
        [center[0] + reach * cos, center[1] + reach * sin]
    })
}

fn nasty_features(sequence: u64, random: &mut impl Rng) -> Features {
    // Half of them nearly good, so that the law is reached, too.
    let mut features = Features::new(&quadrangle(random), now_ns());
    features.stamp.sequence = sequence;
    features.stamp.published_ns = now_ns();
    if random.random_bool(0.5) {
        return features;
    }
    features.stamp = nasty_stamp(sequence, random);
    features.count = nasty_count(random);
    features.visible = nasty_count(random);
    features.exposure_ns = random.random();
    for _ in 0..random.random_range(0..5) {
        let k = random.random_range(0..features.points.len());
        features.points[k] = nasty(random);
    }
    features
}

fn nasty_state(sequence: u64, random: &mut impl Rng) -> RobotState {
    let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], now_ns());
    state.stamp = nasty_stamp(sequence, random);
    state.mode = nasty_count(random);
    // Real faults would disarm: the law is to be reached.
    state.faults = random.random::<u32>() & 0b11;
    state.joints = nasty_count(random);
    state.q[random.random_range(0..7)] = nasty(random);
    state.twist[random.random_range(0..6)] = nasty(random);
    state
}

fn nasty_request(id: u64, random: &mut impl Rng) -> Request {
    let mut request = Request::new(id, messages::Action::Status);
    request.stamp = nasty_stamp(id + 1, random);
    request.action = match nasty_count(random) {
        // Neither stop nor disarm: the law is to be reached.
        2 | 3 => 1,
        other => other,
    };
    request.strategy = nasty_count(random);
    request.neighbours = nasty_count(random);
    request
}

#[test]
fn random_messages_never_panic_and_never_move_beyond_the_limits() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut robot = RobotPorts::open(&domain).unwrap();
    let mut operator = OperatorPorts::open(&domain).unwrap();
    // Foresight thinks, but briefly: who fuzzes waits for each answer.
    let mut command =
        place.vpcd("[law]\nforesight_steps = 5\n[cycle]\nclock = 'lockstep'\n[log]\nlevel = 'off'");
    command.stderr(std::process::Stdio::piped());
    let mut daemon = Running::start(command);
    let (mut answered, mut moving) = (0_u64, 0_u64);
    let messages = repeats("fuzzed messages", 10_000, 1_000_000) as u64;
    for sequence in 1..=messages {
        let features = nasty_features(sequence, &mut random);
        camera.features.publish_verbatim(&features).unwrap();
        if sequence % 4 == 0 {
            let state = nasty_state(sequence, &mut random);
            robot.robot.publish_verbatim(&state).unwrap();
            let request = nasty_request(sequence, &mut random);
            operator.requests.publish_verbatim(&request).unwrap();
            while let Ok(Some(_)) = operator.replies.oldest() {}
        }
        // An answer, soon; what looks like a repetition gets none.
        let patience = now_ns()
            + if sequence < 100 {
                3_000_000_000
            } else {
                300_000
            };
        while now_ns() < patience {
            camera.features.refresh().unwrap();
            let Some(twist) = camera.twist.oldest().unwrap() else {
                std::hint::spin_loop();
                continue;
            };
            assert_within_limits(&twist);
            assert!(twist.twist.iter().all(|v| v.is_finite()), "{twist:?}");
            answered += 1;
            moving += u64::from(twist.twist != [0.0; 6]);
            break;
        }
    }
    assert!(daemon.is_running());
    tell(format!(
        "{messages} messages: {answered} answers, {moving} of them moving"
    ));
    // Not for want of work. One in ten moves or so: the others are answered disarmed, until
    // somebody arms again.
    assert!(
        answered > messages / 2 && moving > messages / 20,
        "{answered} {moving}"
    );
    daemon.signal(rustix::process::Signal::TERM);
    let ended = daemon.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(!ended.stderr.contains("panicked"), "{ended:?}");
}

/// A camera at its rate, for a daemon on the fixed clock.
fn film(place: &Path, rate_hz: f64, end: &AtomicBool) {
    let domain = Domain::join(place).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let far = [
        [250.0, 250.0],
        [420.0, 260.0],
        [410.0, 430.0],
        [240.0, 420.0],
    ];
    let mut random = ChaCha8Rng::seed_from_u64(4);
    while !end.load(Ordering::Relaxed) {
        // Real images are never the same.
        let points = far.map(|point| point.map(|x| x + random.random_range(-0.1..0.1)));
        camera
            .features
            .publish(&Features::new(&points, now_ns()))
            .unwrap();
        std::thread::sleep(Duration::from_secs_f64(1.0 / rate_hz));
    }
}

/// Operators who ask without a pause.
fn flood(place: &Path, end: &AtomicBool) {
    let domain = Domain::join(place).unwrap();
    let mut operator = OperatorPorts::open(&domain).unwrap();
    let mut id = 0;
    while !end.load(Ordering::Relaxed) {
        id += 1;
        let request = Request::new(id, messages::Action::Status);
        operator.requests.publish(&request).unwrap();
        // A processor of its own it does not get.
        if id % 64 == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Peers that come and go.
fn churn(place: &Path, end: &AtomicBool) {
    while !end.load(Ordering::Relaxed) {
        let domain = Domain::join(place).unwrap();
        // Where all places are taken it is refused: as good as a visit.
        let _ = Observer::open(&domain);
    }
}

/// Releases missed in some seconds, with or without an attack.
fn misses(is_attacked: bool, seconds: u64) -> (u64, u64) {
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let daemon =
        Running::start(place.vpcd("[law]\nstrategy = 'previous'\n[safety]\nrobot = 'optional'"));
    let end = AtomicBool::new(false);
    let domain = place.domain();
    let counts = std::thread::scope(|threads| {
        let _end = EndOnDrop(&end);
        let (domain, end) = (&domain, &end);
        threads.spawn(move || film(domain, 30.0, end));
        witness.set_in_motion();
        // Never read: hoards whatever is sent.
        let hoarders: Vec<_> = if is_attacked {
            threads.spawn(move || flood(domain, end));
            threads.spawn(move || churn(domain, end));
            let domain = Domain::join(domain).unwrap();
            (0..3).map_while(|_| Observer::open(&domain).ok()).collect()
        } else {
            Vec::new()
        };
        witness.records();
        let mut records = Vec::new();
        for _ in 0..seconds {
            // Half a minute of records waits at most.
            std::thread::sleep(Duration::from_secs(1));
            records.extend(witness.records());
        }
        drop(hoarders);
        let (first, last) = (records.first().unwrap(), records.last().unwrap());
        (last.cycle - first.cycle, last.overruns - first.overruns)
    });
    daemon.kill();
    counts
}

#[test]
fn floods_hoarders_and_churn_cost_no_release() {
    let _turn = turn();
    let seconds = repeats("seconds of flood", 2, 60) as u64;
    fairly("floods", || {
        let (cycles, baseline) = misses(false, seconds);
        let (cycles_attacked, attacked) = misses(true, seconds);
        tell(format!(
            "missed releases: {baseline} of {cycles} in peace, {attacked} of {cycles_attacked} under attack"
        ));
        ensure!(cycles_attacked as f64 > 0.9 * 30.0 * seconds as f64);
        ensure!(attacked <= baseline, "{attacked} > {baseline}");
        Ok(())
    });
}
