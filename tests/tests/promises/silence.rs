//! A camera that freezes, with old stamps or new ones or a little noise, shows another object after
//! a gap, goes silent, pauses, is late, or dies: the
//! daemon brakes within three periods of the last good features, stands within 300 ms, and stays
//! so, also before good features, until somebody arms it again.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::ensure;
use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain, now_ns};
use messages::{Action, Features, Outcome, TwistCommand, TwistState};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;
use scene::{Pose, Scene};

use crate::fixture::{
    CAMERA_PRIORITY, EndOnDrop, PERIOD_NS, Place, Running, Stage, WAKE_NS, Witness,
    assert_within_limits, eventually, is_still, repeats, some_time, tell, turn,
};
use crate::machine::take_priority;
use crate::stall::{fairly, in_time};

const BRAKING_NS: u64 = 3 * PERIOD_NS;
const ZERO_NS: u64 = 300_000_000;
/// Periods after which the law has forgotten its commands: it remembers 32. This camera does not
/// move as it is commanded: after a fault its points may be taken for others (`Hold::Mixed`) so
/// long.
const FORGOTTEN: u64 = 36;

/// Time in which it notices that an image does not follow, ns.
const NOTICED_NS: u64 = 1_500_000_000;

/// Longest time for which it goes on while points are hidden, ns: `safety.blind_s`.
const BLIND_NS: u64 = 1_000_000_000;

/// Where the object is at first, far from the goal.
const START: Pose = Pose {
    translation: [0.25, 0.1, 0.9],
    rotation: [0.1, -0.2, 0.4],
};
/// Where another one is.
const OTHER: Pose = Pose {
    translation: [-0.3, -0.2, 0.8],
    rotation: [-0.2, 0.3, 0.4],
};

/// What goes wrong with a camera.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// It sends one exposure again and again.
    Freeze,
    /// It sends one image again and again, each time as a new one.
    Image,
    /// It sends one image again and again, each time with so much noise, px.
    Noise(f64),
    /// It loses sight of one point, or starts again; from then on it sees another object.
    OtherAfterHidden,
    OtherAfterRestart,
    /// It sends nothing more.
    Silence,
    /// It pauses for 0.4 s and goes on.
    Pause,
    /// It sends exposures each of which is older than the one before.
    Older,
    /// It loses sight of one point.
    Hidden,
    /// It finds nothing, and says that all points are in a corner.
    Zeros,
    /// It finds the pattern's edge, and puts all points there.
    Line,
    /// Its messages take 0.4 s from now on.
    Late,
}

/// Checks what must follow the last good features: how long until it braked and stood, ns.
fn check_stop(
    commands: &[TwistCommand],
    last_good_ns: u64,
    noticed_ns: u64,
) -> anyhow::Result<[u64; 2]> {
    let after = |twist: &&TwistCommand| twist.stamp.published_ns > last_good_ns;
    let since = |twist: &TwistCommand| twist.stamp.published_ns - last_good_ns;
    let moves = |twist: &TwistCommand| {
        matches!(
            twist.state(),
            Some(TwistState::Moving | TwistState::Arrived)
        )
    };
    commands.iter().for_each(assert_within_limits);
    let last_of_the_law = commands
        .iter()
        .filter(after)
        .filter(|twist| moves(twist))
        .map(since)
        .max();
    // The last command of the law stands until the next one replaces it.
    let braking = commands
        .iter()
        .filter(after)
        .find(|twist| !moves(twist))
        .map(since);
    let braking = braking.unwrap_or_else(|| panic!("it never brakes: {commands:?}"));
    for brakes in [braking, last_of_the_law.unwrap_or(0)] {
        in_time(
            "it brakes",
            last_good_ns,
            last_good_ns + brakes,
            noticed_ns + BRAKING_NS + WAKE_NS,
        )?;
    }
    let zero = commands
        .iter()
        .filter(after)
        .find(|twist| is_still(twist))
        .map(since);
    let zero = zero.unwrap_or_else(|| panic!("it never stands: {commands:?}"));
    in_time(
        "it stands",
        last_good_ns,
        last_good_ns + zero,
        noticed_ns + ZERO_NS + WAKE_NS,
    )?;
    let moves_again = |twist: &TwistCommand| since(twist) > zero && !is_still(twist);
    assert!(
        !commands.iter().filter(after).any(moves_again),
        "it moves again: {commands:?}"
    );
    Ok([braking, zero])
}

/// The latest braking and standing of some, ns.
#[derive(Default)]
struct Worst([u64; 2]);

impl Worst {
    fn add(&mut self, took: [u64; 2]) {
        self.0 = std::array::from_fn(|k| self.0[k].max(took[k]));
    }

    fn tell(&self, what: &str) {
        let [braking, zero] = self.0.map(|ns| ns / 1_000_000);
        tell(format!(
            "{what}: brakes after {braking} ms, stands after {zero} ms, at most"
        ));
    }
}

/// A camera that moves as commanded until the flag makes it fail, and works again after `over`.
/// While it fails, it stands.
fn film(place: &Path, fault: Fault, fail: &AtomicBool, over: &AtomicBool, end: &AtomicBool) -> u64 {
    let domain = Domain::join(place).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    // Where it is permitted: whatever else the machine does, its frames come in time.
    take_priority(CAMERA_PRIORITY);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let mut eye = FreeCamera::new(&scene, &START);
    let (mut command, mut since_ns) = (TwistCommand::default(), now_ns());
    let mut image = [0.0; 2 * messages::MAX_POINTS];
    let (mut last_good_ns, mut exposure_ns, mut sequence) = (0, 0, 0);
    let (mut paused, mut is_other, mut older_ns) = (false, false, 0);
    while !end.load(Ordering::Relaxed) {
        let is_failing = fail.load(Ordering::Relaxed) && !over.load(Ordering::Relaxed);
        let at_ns = now_ns();
        if !is_failing {
            eye.advance(&command.in_force(at_ns), (at_ns - since_ns) as f64 * 1e-9);
        }
        since_ns = at_ns;
        if let Some(newest) = camera.twist.latest().unwrap() {
            command = newest.message;
        }
        let mut noisy = |points: &mut [f64], px: f64| {
            let each = points.iter_mut();
            each.for_each(|x| *x += random.random_range(-px..=px));
        };
        let mut features = Features::new(&eye.features().unwrap(), at_ns);
        let numbers = 2 * features.count as usize;
        noisy(&mut features.points[..numbers], 0.1);
        match fault {
            Fault::Image if is_failing => features.points = image,
            Fault::Noise(px) if is_failing => {
                features.points = image;
                noisy(&mut features.points[..numbers], px);
            }
            Fault::OtherAfterHidden | Fault::OtherAfterRestart if is_failing && !is_other => {
                (is_other, eye) = (true, FreeCamera::new(&scene, &OTHER));
                if matches!(fault, Fault::OtherAfterHidden) {
                    features.visible = 0b1011;
                } else {
                    drop(camera);
                    camera = CameraPorts::open(&domain).unwrap();
                    continue;
                }
            }
            Fault::Freeze if is_failing => features.stamp.data_ns = exposure_ns,
            Fault::Older if is_failing => {
                older_ns += PERIOD_NS;
                features.stamp.data_ns = exposure_ns - older_ns;
            }
            Fault::Hidden if is_failing => features.visible = 0b1011,
            Fault::Zeros if is_failing => features.points.iter_mut().for_each(|x| *x *= 1e-3),
            Fault::Line if is_failing => {
                let v = features.points[1];
                let heights = features.points[..numbers].iter_mut().skip(1).step_by(2);
                heights.for_each(|x| *x = v);
            }
            Fault::Pause if is_failing && !paused => {
                std::thread::sleep(Duration::from_millis(400));
                paused = true;
                features.stamp.data_ns = now_ns();
            }
            _ => (),
        }
        if is_failing && matches!(fault, Fault::Late) {
            let late_ns = now_ns() - 400_000_000;
            if late_ns > exposure_ns {
                sequence += 1;
                camera.features.skip();
                features.stamp.data_ns = late_ns;
                features.stamp.sequence = sequence;
                features.stamp.published_ns = late_ns + 1_000_000;
                camera.features.publish_verbatim(&features).unwrap();
            }
        } else if !(is_failing && matches!(fault, Fault::Silence)) {
            let sent = camera.features.publish(&features).unwrap();
            sequence = sent.sequence;
            if !fail.load(Ordering::Relaxed) {
                (last_good_ns, exposure_ns) = (sent.published_ns, features.stamp.data_ns);
                image = features.points;
            }
        }
        std::thread::sleep(Duration::from_nanos(PERIOD_NS));
    }
    last_good_ns
}

#[test]
fn a_failing_camera_is_met_with_brakes_and_disarming() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for fault in [
        Fault::Freeze,
        Fault::Image,
        Fault::Noise(1e-9),
        Fault::Noise(1e-3),
        Fault::Noise(0.5),
        Fault::OtherAfterHidden,
        Fault::OtherAfterRestart,
        Fault::Silence,
        Fault::Pause,
        Fault::Older,
        Fault::Hidden,
        Fault::Zeros,
        Fault::Line,
        Fault::Late,
    ] {
        let mut worst = Worst::default();
        for round in 0..repeats(&format!("{fault:?}"), 1, 20) {
            worst.add(fairly(&format!("{fault:?} {round}"), || {
                fail(fault, &mut random)
            }));
        }
        worst.tell(&format!("{fault:?}"));
    }
}

/// One fault at a random phase of the cycle, and the end of it.
fn fail(fault: Fault, random: &mut impl Rng) -> anyhow::Result<[u64; 2]> {
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let _daemon = Running::start(place.vpcd("[safety]\nrobot = 'optional'"));
    let (fail, over, end) = Default::default();
    let (commands, last_good_ns) = std::thread::scope(|threads| {
        let _end = EndOnDrop(&end);
        let camera = threads.spawn(|| film(&place.domain(), fault, &fail, &over, &end));
        witness.set_in_motion();
        some_time(6, random);
        fail.store(true, Ordering::Relaxed);
        let mut commands = witness.until("a controller that gave up", |twist| {
            twist.state() == Some(TwistState::Disarmed)
        });
        over.store(true, Ordering::Relaxed);
        // Good features alone do not set it in motion; late ones would have come by then.
        std::thread::sleep(Duration::from_nanos(FORGOTTEN * PERIOD_NS));
        commands.extend(witness.commands());
        ensure!(commands.len() > 6, "{commands:?}");
        let outcome = witness.ask(Action::Arm);
        ensure!(outcome == Outcome::Done, "arming: {outcome:?}");
        witness.set_in_motion();
        end.store(true, Ordering::Relaxed);
        Ok((commands, camera.join().unwrap()))
    })?;
    let noticed_ns = match fault {
        Fault::Noise(_) => NOTICED_NS,
        // It goes on by the other points.
        Fault::Hidden => BLIND_NS,
        _ => 0,
    };
    check_stop(&commands, last_good_ns, noticed_ns)
}

#[test]
fn a_camera_that_dies_or_hangs_is_met_with_brakes() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut worst = Worst::default();
    for round in 0..repeats("kill -9 and SIGSTOP of the camera", 6, 200) {
        worst.add(fairly(&format!("camera {round}"), || {
            end(round, &mut random)
        }));
    }
    worst.tell("camera killed or stopped");
}

/// One camera that ends at a random phase of the cycle, by SIGKILL or SIGSTOP in turn, and one that
/// comes after it.
fn end(round: usize, random: &mut impl Rng) -> anyhow::Result<[u64; 2]> {
    let Stage {
        place,
        mut witness,
        daemon: _daemon,
        camera,
    } = Stage::in_motion(round);
    some_time(6, random);
    // Who never took a message of a camera may find none when it is gone.
    let before_ns = witness.newest_features_ns();
    camera.halt(if round.is_multiple_of(2) {
        Signal::KILL
    } else {
        Signal::STOP
    });
    let last_good_ns = before_ns.max(witness.newest_features_ns());
    assert_ne!(last_good_ns, 0, "no features");
    let mut commands = witness.until("a controller that gave up", |twist| {
        twist.state() == Some(TwistState::Disarmed)
    });
    // A camera that comes back does not set it in motion.
    camera.kill();
    let _camera = Running::start(place.hw_sim(round % 100));
    eventually("new features", || {
        (witness.newest_features_ns() > last_good_ns).then_some(())
    });
    std::thread::sleep(Duration::from_nanos(4 * PERIOD_NS));
    commands.extend(witness.commands());
    let took = check_stop(&commands, last_good_ns, 0)?;
    witness.set_in_motion();
    Ok(took)
}
