//! Random messages to the daemon: no panic, and no command outside the limits. Floods are measured
//! (`tests/measure`).

use std::f64::consts::TAU;
use std::time::{Duration, Instant};

use ipc::{CameraPorts, Domain, OperatorPorts, RobotPorts, now_ns};
use messages::{Features, Request, RobotState, Stamp, TwistCommand};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fixture::{PATIENCE, Place, Running, assert_within_limits, eventually, repeats, tell};

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

fn nasty_features(sequence: u64, corners: &mut [[f64; 2]; 4], random: &mut impl Rng) -> Features {
    // Most of them are nearly good, and where the last ones were, so that the law is reached, too.
    if random.random_ratio(1, 32) {
        *corners = quadrangle(random);
    }
    corners
        .as_flattened_mut()
        .iter_mut()
        .for_each(|x| *x += random.random_range(-0.5..0.5));
    let mut features = Features::new(corners, now_ns());
    features.stamp.sequence = sequence;
    features.stamp.published_ns = now_ns();
    if random.random_bool(0.75) {
        return features;
    }
    features.stamp = nasty_stamp(sequence, random);
    features.count = nasty_count(random);
    if random.random_ratio(1, 4) {
        // Seldom: hidden time is a budget.
        features.visible = nasty_count(random);
    }
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

/// Half of them arm as they should.
fn nasty_request(id: u64, veto: u32, random: &mut impl Rng) -> Request {
    let mut request = Request::new(id, messages::Action::Status);
    let is_good = random.random();
    request.veto = if is_good { veto } else { nasty_count(random) };
    request.stamp = nasty_stamp(id + 1, random);
    request.action = match nasty_count(random) {
        // Neither stop nor disarm: the law is to be reached.
        2 | 3 => 1,
        _ if is_good => 1,
        other => other,
    };
    request.strategy = nasty_count(random);
    request.neighbours = nasty_count(random);
    request
}

#[test]
fn random_messages_never_move_beyond_the_limits() {
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
    let mut sequence = 0;
    eventually("the first answer", || {
        sequence += 1;
        let mut features = Features::new(&quadrangle(&mut random), now_ns());
        features.stamp.sequence = sequence;
        features.stamp.published_ns = now_ns();
        camera.features.publish_verbatim(&features).unwrap();
        camera.features.refresh().unwrap();
        std::thread::sleep(Duration::from_millis(10));
        camera.twist.latest().unwrap()
    });
    let (mut moving, mut veto) = (0_u64, 0);
    let mut corners = quadrangle(&mut random);
    let messages = repeats("fuzzed messages", 2_000, 1_000_000) as u64;
    for sequence in sequence + 1..=sequence + messages {
        let features = nasty_features(sequence, &mut corners, &mut random);
        camera.features.publish_verbatim(&features).unwrap();
        if sequence % 4 == 0 {
            let state = nasty_state(sequence, &mut random);
            robot.robot.publish_verbatim(&state).unwrap();
            let request = nasty_request(sequence, veto, &mut random);
            operator.requests.publish_verbatim(&request).unwrap();
            while let Ok(Some(reply)) = operator.replies.oldest() {
                veto = reply.veto;
            }
        }
        // In lockstep each message has one answer.
        let twist = answer(&mut camera);
        assert_within_limits(&twist);
        assert!(twist.twist.iter().all(|v| v.is_finite()), "{twist:?}");
        moving += u64::from(twist.twist != [0.0; 6]);
    }
    assert!(daemon.is_running());
    tell(format!("{messages} messages: {moving} answers move"));
    // Not for want of work. One in five moves or so: the others are answered disarmed, until
    // somebody arms again.
    assert!(moving > messages / 20, "{moving}");
    daemon.signal(rustix::process::Signal::TERM);
    let ended = daemon.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(!ended.stderr.contains("panicked"), "{ended:?}");
}

/// Waits for the answer to the last message.
fn answer(camera: &mut CameraPorts) -> TwistCommand {
    let begin = Instant::now();
    loop {
        camera.features.refresh().unwrap();
        if let Some(twist) = camera.twist.oldest().unwrap() {
            return twist.message;
        }
        assert!(begin.elapsed() < PATIENCE, "no answer");
        std::hint::spin_loop();
    }
}

/// `ulimit -f`: a write beyond it fails, and no program dies of it.
#[test]
fn a_limit_on_the_size_of_files_ends_no_program() {
    let place = Place::new();
    for name in ["vpcd", "vpcctl", "hw-sim", "vpc-memory"] {
        let mut shell = testkit::command("sh");
        shell.args(["-c", "ulimit -f 0; exec \"$@\" > out", "sh"]);
        shell.arg(testkit::program(name)).arg("--help");
        let ended = testkit::ended(shell.current_dir(place.directory()));
        assert_eq!(
            (ended.code, ended.signal),
            (Some(0), None),
            "{name}: {ended:?}"
        );
    }
}
