//! Robots that tell the truth, with noise, lags and other gains; and others.

use std::f64::consts::TAU;
use std::path::Path;

use arm::{Dampers, JointLimits, READY};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;

use super::*;
use crate::rules::Safety;

const S: u64 = 1_000_000_000;
const HZ: f64 = 30.0;
/// Time in which a robot takes up a twist at its limits, s.
const RAMP_S: f64 = 0.15;
const FAST: [f64; 6] = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
/// Those of the paper's robot.
const SLOW: [f64; 6] = [0.01, 0.01, 0.01, 0.03, 0.03, 0.03];

fn rules() -> Rules {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let safety = Safety::default();
    Rules::new(
        &scene,
        &vpc::Settings::default(),
        &safety,
        messages::ClockMode::Fixed,
    )
}

fn watch() -> JointWatch {
    JointWatch::new(&rules())
}

/// Arms with seven, six, five and four joints.
fn arms() -> Vec<Arm> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let shipped = ["panda", "fr3"].map(|name| {
        let text = format!("arm = '{name}.toml'\n{}", scene::PAPER_ROBOT);
        let path = root.join("ipc/scene/scenes/s.toml");
        Scene::parse(&text, path.to_str().unwrap()).unwrap()
    });
    let read = |name| Scene::read(&root.join("tests/scenes").join(name)).unwrap();
    let tests = ["ur5e.toml", "reach.toml", "five.toml", "scara.toml"].map(read);
    let all = shipped.into_iter().chain(tests);
    all.map(|scene| Arm::from(&scene.arm.unwrap())).collect()
}

fn panda() -> Arm {
    arms().remove(0)
}

/// A robot that moves its camera now here, now there.
struct Robot {
    arm: Arm,
    q: Joints,
    /// What it aims at now, and what it carries out as it reports it.
    aimed: [f64; 6],
    twist: [f64; 6],
    limits: [f64; 6],
    /// What it moves at next, and for how many more messages.
    target: ([f64; 6], f64),
    left: u32,
    /// Motion by the joints for each of the reported one.
    gain: f64,
    /// Joints and twist so far, one of each period.
    past: Vec<(Joints, [f64; 6])>,
}

impl Robot {
    fn new(arm: &Arm, limits: [f64; 6], gain: f64, random: &mut impl Rng) -> Self {
        let q = posture(arm, random);
        Self {
            arm: arm.clone(),
            q,
            aimed: [0.0; 6],
            twist: [0.0; 6],
            limits,
            target: ([0.0; 6], 0.0),
            left: 0,
            gain,
            past: vec![(q, [0.0; 6])],
        }
    }

    /// A period in which it goes on to what was drawn, as far as its joints allow.
    fn step(&mut self, random: &mut impl Rng) {
        if self.left == 0 {
            let share = [0.0, 0.1, 0.5, 1.0][random.random_range(0..4)];
            let twist = self
                .limits
                .map(|most| share * most * random.random_range(-1.0..1.0));
            let has_elbow = self.arm.chain.count() == JOINTS;
            let elbow = if has_elbow {
                random.random_range(-0.3..0.3)
            } else {
                0.0
            };
            self.target = (twist, elbow);
            self.left = random.random_range(10..60);
        }
        self.left -= 1;
        let (target, elbow) = self.target;
        self.go(&target, elbow);
    }

    /// A period on the way to this twist.
    fn go(&mut self, target: &[f64; 6], elbow: f64) {
        let dampers = Dampers::at(&self.arm, &self.q, &[f64::INFINITY; 6], 1.0 / HZ);
        let target = dampers.reached(target);
        let share = dampers.share(&target);
        for k in 0..6 {
            let change = self.limits[k] / RAMP_S / HZ;
            let wanted = share * target[k];
            self.aimed[k] += (wanted - self.aimed[k]).clamp(-change, change);
        }
        // However fast it was, it keeps to its joints.
        let share = dampers.share(&self.aimed);
        let joints = self.arm.limits.0.iter().zip(self.q.iter());
        let ends = joints.flat_map(|(joint, q)| joint.room(*q));
        let elbow = if ends.fold(f64::INFINITY, f64::min) > 0.1 {
            elbow
        } else {
            0.0
        };
        let part_s = 0.25 / HZ;
        for _ in 0..4 {
            let before = self.q;
            let twist = self.aimed.map(|v| self.gain * share * v);
            self.q = self.arm.moved(&self.q, &twist, elbow, part_s);
            // Near a singular posture it does less than it aims at.
            let way = self.q - before;
            let carried = self.arm.camera_twist(&(before + way * 0.5), &way);
            self.twist = carried.map(|v| v / part_s / self.gain);
        }
        self.past.push((self.q, self.twist));
    }

    /// What was so many seconds ago; between two periods in proportion.
    fn before(&self, seconds: f64) -> (Joints, [f64; 6]) {
        let at = ((self.past.len() - 1) as f64 - seconds * HZ).max(0.0);
        let (from, to) = (self.past[at as usize], self.past[at.ceil() as usize]);
        let share = at.fract();
        let q = from.0 + (to.0 - from.0) * share;
        let twist = std::array::from_fn(|k| from.1[k] + (to.1[k] - from.1[k]) * share);
        (q, twist)
    }

    /// The newest message, with these joints.
    fn message(&self, q: &Joints, twist: [f64; 6]) -> RobotState {
        let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], self.now_ns());
        state.mode = RobotMode::Moving.code();
        state.joints = self.arm.chain.count() as u32;
        state.q = (*q).into();
        state.twist = twist;
        state
    }

    fn now_ns(&self) -> u64 {
        S + (self.past.len() as f64 / HZ * 1e9) as u64
    }
}

/// A posture within the ranges: of twenty, that from which the camera moves most freely.
fn posture(arm: &Arm, random: &mut impl Rng) -> Joints {
    let mut drawn = || {
        Joints::from_fn(|k, _| match arm.limits.0[k].range {
            _ if k >= arm.chain.count() => 0.0,
            _ if arm.limits.0[k].is_endless() => random.random_range(-TAU..TAU),
            [least, most] => {
                let margin = 0.2 * (most - least).min(TAU);
                random.random_range(least + margin..most - margin)
            }
        })
    };
    let all: Vec<Joints> = (0..20).map(|_| drawn()).collect();
    let freedom = |q: &Joints| {
        let dampers = Dampers::at(arm, q, &[f64::INFINITY; 6], 1.0 / HZ);
        let shares = (0..6).map(|k| {
            let mut twist = [0.0; 6];
            twist[k] = FAST[k];
            dampers.share(&dampers.reached(&twist))
        });
        shares.fold(1.0, f64::min)
    };
    let best = all.iter().max_by(|a, b| freedom(a).total_cmp(&freedom(b)));
    *best.unwrap()
}

/// A robot that tells the truth as well as it can.
#[derive(Clone, Copy, Debug)]
struct Honest {
    limits: [f64; 6],
    /// What its joints carry out of the twist that it reports.
    gain: f64,
    /// Encoder steps, rad or m.
    step: f64,
    /// By how much joints and twist are late, s.
    late_s: [f64; 2],
    /// Each n-th period has a message.
    every: usize,
    /// Noise of the reported twist, share of its limits.
    noise: f64,
}

const PLAIN: Honest = Honest {
    limits: FAST,
    gain: 1.0,
    step: 1e-4,
    late_s: [0.0; 2],
    every: 1,
    noise: 0.0,
};

fn honest() -> Vec<Honest> {
    let mut all = Vec::new();
    for limits in [FAST, SLOW] {
        let plain = Honest { limits, ..PLAIN };
        all.extend([
            plain,
            Honest { gain: 0.9, ..plain },
            Honest { gain: 1.1, ..plain },
            Honest {
                step: 1.5e-3,
                ..plain
            },
            Honest {
                late_s: [0.2; 2],
                ..plain
            },
            Honest {
                late_s: [0.1, 0.0],
                gain: 0.9,
                ..plain
            },
            Honest {
                late_s: [0.0, 0.1],
                gain: 1.1,
                step: 1.5e-3,
                ..plain
            },
            Honest {
                late_s: [0.2, 0.0],
                ..plain
            },
            Honest { every: 3, ..plain },
            Honest {
                every: 3,
                gain: 0.9,
                ..plain
            },
            Honest {
                noise: 0.05,
                ..plain
            },
        ]);
    }
    all
}

/// How far apart both motions came at most, as a share of what is allowed; infinite where a joint
/// leaps.
fn apart(arm: &Arm, honest: &Honest, seconds: f64, random: &mut impl Rng) -> f64 {
    let mut robot = Robot::new(arm, honest.limits, honest.gain, random);
    let (mut watch, mut most) = (watch(), 0.0_f64);
    for k in 0..(seconds * HZ) as usize {
        robot.step(random);
        let (q, _) = robot.before(honest.late_s[0]);
        let (_, mut twist) = robot.before(honest.late_s[1]);
        let q = q.map(|q| (q / honest.step).round() * honest.step);
        for (v, limit) in twist.iter_mut().zip(honest.limits) {
            *v += honest.noise * limit * random.random_range(-1.0..1.0);
        }
        if k % honest.every == 0 {
            let message = robot.message(&q, twist);
            assert!(watch.look(arm, &message, robot.now_ns()).is_some());
            watch.sent(&robot.aimed);
            let shares = watch.distances().map(|[found, allowed]| found / allowed);
            most = most.max(shares[0]).max(shares[1]);
            if watch.hold().is_some() {
                let fault = watch.fault(None).unwrap();
                return if fault.code == JointFaultCode::Leap {
                    f64::INFINITY
                } else {
                    most
                };
            }
        }
    }
    most
}

fn is_long() -> bool {
    std::env::var_os("VPC_LONG").is_some_and(|value| value == "1")
}

#[test]
fn joints_of_an_honest_robot_are_never_accused() {
    let runs = if is_long() { 20 } else { 1 };
    for honest in honest() {
        let mut worst: Vec<f64> = Vec::new();
        for (a, arm) in arms().iter().enumerate() {
            for run in 0..runs {
                let mut random = ChaCha8Rng::seed_from_u64(1000 * a as u64 + run);
                worst.push(apart(arm, &honest, 20.0, &mut random));
            }
        }
        worst.sort_by(f64::total_cmp);
        let (count, most) = (worst.len(), worst[worst.len() - 1]);
        println!(
            "{honest:?}: {count} runs, median {:.2}, most {most:.2}",
            worst[count / 2]
        );
        assert!(most < 1.0, "{honest:?}");
    }
}

/// From what was and is to the joints that are told, so many periods after the lie began.
type Lie = Box<dyn Fn(&Robot, usize) -> Joints>;

/// The time of motion after which a lie that begins at `at_s` is found, s, and by what; `None`
/// where it is not found in 10 s. Motion counts from a fifth of the limits on.
fn found(
    robot: &mut Robot,
    at_s: f64,
    lie: &Lie,
    mut go: impl FnMut(&mut Robot),
) -> Option<(f64, JointFault)> {
    let (mut watch, mut moved_s) = (watch(), 0.0);
    let begin = (at_s * HZ) as usize;
    for k in 0..begin + (10.0 * HZ) as usize {
        go(robot);
        let q = match k.checked_sub(begin) {
            Some(since) => lie(robot, since),
            None => robot.q,
        };
        let message = robot.message(&q, robot.twist);
        watch.look(&robot.arm, &message, robot.now_ns());
        watch.sent(&robot.aimed);
        let fault = watch.fault(None);
        if let Some(fault) = fault {
            assert!(k >= begin, "{fault:?} before the lie");
            return Some((moved_s, fault));
        }
        let pairs = robot.twist.iter().zip(robot.limits);
        let share = pairs.map(|(v, most)| v.abs() / most).fold(0.0, f64::max);
        if k >= begin && share >= 0.2 {
            moved_s += 1.0 / HZ;
        }
    }
    None
}

/// The joints as they were when it began.
fn frozen() -> Lie {
    Box::new(|robot, since| robot.past[robot.past.len() - 1 - since].0)
}

fn late(seconds: f64) -> Lie {
    Box::new(move |robot, _| robot.before(seconds).0)
}

fn at_half_speed() -> Lie {
    Box::new(|robot, since| {
        let from = robot.past[robot.past.len() - 1 - since].0;
        from + (robot.q - from) * 0.5
    })
}

#[test]
fn frozen_late_and_slow_joints_are_found_within_a_second_of_motion() {
    let arm = panda();
    let forward = [0.0, 0.0, 0.0, 0.0, 0.0, 0.5];
    let aside = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
    // From rest, and on a steady way: s of motion.
    for (twist, lie, longest, what) in [
        (forward, frozen(), [0.4, 0.75], "frozen"),
        (aside, frozen(), [0.45, 0.8], "frozen"),
        (forward, late(0.4), [0.5, f64::NAN], "late"),
        (forward, at_half_speed(), [1.0, 2.0], "half"),
    ] {
        for (k, at_s) in [0.0, 1.5].into_iter().enumerate() {
            if longest[k].is_nan() {
                continue;
            }
            let mut random = ChaCha8Rng::seed_from_u64(1);
            let mut robot = Robot::new(&arm, FAST, 1.0, &mut random);
            robot.q = Joints::from(READY);
            robot.q[6] = -1.0;
            let found = found(&mut robot, at_s, &lie, |robot| robot.go(&twist, 0.0));
            let found = found.map_or(f64::INFINITY, |(seconds, _)| seconds);
            assert!(found <= longest[k], "{what}, {at_s} s, {twist:?}: {found}");
        }
    }
}

/// A robot at rest, and a watch that has seen it twice.
fn at_rest(arm: &Arm, q: &Joints) -> (Robot, JointWatch) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut robot = Robot::new(arm, FAST, 1.0, &mut random);
    robot.q = *q;
    let mut watch = watch();
    for _ in 0..2 {
        assert_eq!(told(&mut robot, &mut watch, |_| ()), None);
    }
    (robot, watch)
}

/// What is wrong with the next message of a robot at rest, changed so; the joint counts from 0.
fn told(
    robot: &mut Robot,
    watch: &mut JointWatch,
    change: impl FnOnce(&mut RobotState),
) -> Option<(JointFaultCode, u32)> {
    robot.go(&[0.0; 6], 0.0);
    let mut message = robot.message(&robot.q, robot.twist);
    change(&mut message);
    let at_ns = watch.look(&robot.arm, &message, robot.now_ns());
    let fault = watch.fault(None);
    let refused = [JointFaultCode::Future, JointFaultCode::Range];
    let is_refused = fault.is_some_and(|fault| refused.contains(&fault.code));
    assert_eq!(
        (at_ns.is_none(), watch.hold().is_none()),
        (is_refused, fault.is_none() || is_refused)
    );
    fault.map(|fault| (fault.code, fault.joint))
}

#[test]
fn joints_that_leap_are_found_at_once_and_believed_when_they_stay() {
    let (mut robot, mut watch) = at_rest(&panda(), &READY.into());
    let leap = Some((JointFaultCode::Leap, 6));
    for change in [-2.0, 0.0, -2.0] {
        assert_eq!(
            told(&mut robot, &mut watch, |state| state.q[6] += change),
            leap
        );
    }
    assert_eq!(
        told(&mut robot, &mut watch, |state| state.q[6] -= 2.0),
        None
    );
    // What was wrong is told for as long as the camera is held for it.
    let held = watch.fault(Some(Hold::JointsNotFollowing)).unwrap();
    assert_eq!(held.code, JointFaultCode::Leap);
    assert!((held.found + 2.0).abs() < 1e-9, "{held:?}");
}

#[test]
fn a_joint_with_a_range_leaps_by_a_whole_turn_and_one_without_does_not() {
    let mut arm = arms().remove(2);
    let q = arm::joints(&[0.0, -1.6, 1.6, -1.6, -1.6, 3.1]);
    let turned = |arm: &Arm| {
        let (mut robot, mut watch) = at_rest(arm, &q);
        [0, 1].map(|_| told(&mut robot, &mut watch, |state| state.q[5] -= TAU))
    };
    assert_eq!(turned(&arm), [Some((JointFaultCode::Leap, 5)), None]);
    arm.limits.0[5].range = JointLimits::NONE.range;
    assert_eq!(turned(&arm), [None; 2]);
    // It goes on over the end of a turn, wherever that is.
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut robot = Robot::new(&arm, FAST, 1.0, &mut random);
    robot.q = q;
    let wrapped: Lie = Box::new(|robot, _| robot.q.map(|q| q - TAU * (q / TAU).round()));
    let rolling = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    assert_eq!(
        found(&mut robot, 0.0, &wrapped, |robot| robot.go(&rolling, 0.0)),
        None
    );
    assert!(robot.q[5].abs() > 6.0, "{}", robot.q);
}

#[test]
fn joints_out_of_range_or_from_the_future_are_refused_and_named() {
    let (mut robot, mut watch) = at_rest(&panda(), &READY.into());
    let mut told = |change: &dyn Fn(&mut RobotState)| told(&mut robot, &mut watch, change);
    let range = |joint| Some((JointFaultCode::Range, joint));
    let end = 2.8973;
    for q in [
        5.0,
        -5.0,
        1e300,
        -1e300,
        f64::NAN,
        f64::INFINITY,
        end + 0.051,
    ] {
        assert_eq!(told(&|state| state.q[6] = q), range(6), "{q}");
    }
    assert_eq!(
        told(&|state| state.q = state.q.map(f64::to_degrees)),
        range(1)
    );
    assert_eq!(told(&|state| state.q = [0.0; 7]), range(3));
    assert_eq!(told(&|state| state.q.reverse()), range(5));
    let future = Some((JointFaultCode::Future, 0));
    assert_eq!(told(&|state| state.stamp.data_ns += FUTURE_NS), None);
    assert_eq!(told(&|state| state.stamp.data_ns += FUTURE_NS + 1), future);
    assert_eq!(told(&|state| state.stamp.data_ns = u64::MAX), future);
    // Without an instant of its own, that of the publication counts.
    let late = |state: &mut RobotState| {
        (state.stamp.published_ns, state.stamp.data_ns) = (u64::MAX, 0);
    };
    assert_eq!(told(&late), future);
    assert_eq!(told(&|_| ()), None);
}

#[test]
fn joints_a_little_beyond_their_range_are_used() {
    let mut q = Joints::from(READY);
    q[6] = 2.8973 + 0.049;
    at_rest(&panda(), &q);
}

#[test]
fn another_number_of_joints_is_of_no_use_and_compared_with_nothing() {
    let (mut robot, mut watch) = at_rest(&panda(), &READY.into());
    for joints in [0, 6, 8, u32::MAX] {
        robot.go(&[0.0; 6], 0.0);
        let mut message = robot.message(&robot.q, robot.twist);
        message.joints = joints;
        assert_eq!(watch.look(&robot.arm, &message, robot.now_ns()), None);
        assert_eq!((watch.fault(None), watch.hold()), (None, None));
    }
    assert_eq!(told(&mut robot, &mut watch, |_| ()), None);
}

#[test]
fn a_robot_that_is_idle_is_moved_by_hand_and_one_of_lockstep_by_no_time() {
    let (mut robot, mut watch) = at_rest(&panda(), &READY.into());
    let idle = |state: &mut RobotState| {
        state.mode = RobotMode::Idle.code();
        state.q[6] -= 2.0;
    };
    assert_eq!(told(&mut robot, &mut watch, idle), None);
    let leap = Some((JointFaultCode::Leap, 6));
    assert_eq!(told(&mut robot, &mut watch, |_| ()), leap);
    let lockstep = Rules {
        valid_ns: None,
        ..rules()
    };
    let mut watch = JointWatch::new(&lockstep);
    for change in [0.0, -2.0] {
        let elsewhere = |state: &mut RobotState| {
            state.stamp.data_ns = u64::MAX;
            state.q[6] += change;
        };
        assert_eq!(told(&mut robot, &mut watch, elsewhere), None);
    }
}

#[test]
fn an_instant_that_comes_again_or_goes_back_is_no_motion() {
    let (mut robot, mut watch) = at_rest(&panda(), &READY.into());
    let aside = [0.3, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut last = robot.message(&robot.q, robot.twist);
    for _ in 0..30 {
        robot.go(&aside, 0.0);
        // The same joints with a newer twist; then older ones; then new ones.
        let again = RobotState {
            twist: robot.twist,
            ..last
        };
        let mut older = last;
        older.stamp.data_ns -= 1_000_000;
        let new = robot.message(&robot.q, robot.twist);
        for message in [again, older, new] {
            assert!(watch.look(&robot.arm, &message, robot.now_ns()).is_some());
            assert_eq!(watch.fault(None), None);
        }
        last = new;
    }
    // Nor may older ones leap.
    let mut older = last;
    older.stamp.data_ns -= 1_000_000;
    older.q[6] -= 1.0;
    watch.look(&robot.arm, &older, robot.now_ns());
    assert_eq!(
        watch.fault(None).map(|fault| fault.code),
        Some(JointFaultCode::Leap)
    );
}

/// Another posture that moves by as much: by this much more in one joint, or in all.
fn shifted(joint: Option<usize>, by: f64) -> Lie {
    Box::new(move |robot, _| {
        let count = robot.arm.chain.count();
        let shift = |k: usize| match joint {
            Some(joint) => f64::from(u8::from(k == joint)),
            None => {
                if k.is_multiple_of(2) {
                    1.0
                } else {
                    -1.0
                }
            }
        };
        Joints::from_fn(|k, _| {
            if k < count {
                robot.q[k] + by * shift(k)
            } else {
                0.0
            }
        })
    })
}

fn one_frozen(joint: usize) -> Lie {
    Box::new(move |robot, since| {
        let mut q = robot.q;
        q[joint] = robot.past[robot.past.len() - 1 - since].0[joint];
        q
    })
}

/// A table: how often a lie is found, and after what time of motion, where the robot goes now here,
/// now there.
#[test]
#[ignore = "long: figures of what is found"]
fn what_is_found_of_each_lie() {
    let scale = |by: f64| -> Lie {
        Box::new(move |robot, since| {
            let from = robot.past[robot.past.len() - 1 - since].0;
            from + (robot.q - from) * by
        })
    };
    let swapped: Lie = Box::new(|robot, since| {
        let from = robot.past[robot.past.len() - 1 - since].0;
        let way = robot.q - from;
        let last = robot.arm.chain.count() - 1;
        Joints::from_fn(|k, _| from[k] + if k <= last { way[last - k] } else { 0.0 })
    });
    let lies: Vec<(String, Lie)> = [
        ("frozen".to_owned(), frozen()),
        ("scaled by 0".to_owned(), scale(0.0)),
        ("scaled by 0.5".to_owned(), scale(0.5)),
        ("scaled by 0.7".to_owned(), scale(0.7)),
        ("scaled by 1.5".to_owned(), scale(1.5)),
        ("scaled by 3".to_owned(), scale(3.0)),
        ("reversed sign".to_owned(), scale(-1.0)),
        ("other order".to_owned(), swapped),
    ]
    .into_iter()
    .chain([0.2, 0.3, 0.35, 0.4, 0.5, 0.6, 1.0].map(|s| (format!("late {s} s"), late(s))))
    .chain([0.1, 0.2, 0.3, 0.5, 1.0].map(|by| (format!("all off by {by}"), shifted(None, by))))
    .chain((0..7).map(|k| (format!("joint {} off by 0.5", k + 1), shifted(Some(k), 0.5))))
    .chain((0..7).map(|k| (format!("joint {} frozen", k + 1), one_frozen(k))))
    .collect();
    let seeds = if is_long() { 20 } else { 5 };
    for (limits, name) in [(FAST, "fast"), (SLOW, "slow")] {
        for (what, lie) in &lies {
            let (mut times, mut count) = (Vec::new(), 0);
            // A joint that the arm does not have tells no lie; postures are wrong from the start.
            let joint = what.strip_prefix("joint ").and_then(|name| name.get(..1));
            let joint = joint.map_or(0, |digit| digit.parse().unwrap());
            let at_s = if what.contains("off") { 0.0 } else { 2.0 };
            for arm in arms().into_iter().filter(|arm| joint <= arm.chain.count()) {
                for seed in 0..seeds {
                    let mut random = ChaCha8Rng::seed_from_u64(seed);
                    let mut robot = Robot::new(&arm, limits, 1.0, &mut random);
                    let go = |robot: &mut Robot| robot.step(&mut random);
                    // Ranges are another matter.
                    robot
                        .arm
                        .limits
                        .0
                        .iter_mut()
                        .for_each(|joint| joint.range = [-100.0, 100.0]);
                    count += 1;
                    times.extend(found(&mut robot, at_s, lie, go).map(|(seconds, _)| seconds));
                }
            }
            times.sort_by(f64::total_cmp);
            let rank = |share: f64| {
                let rank = (share * (times.len().max(1) - 1) as f64) as usize;
                times.get(rank).copied().unwrap_or(f64::NAN)
            };
            println!(
                "{name} {what}: {} of {count}; median {:.2} s, 95 % {:.2} s",
                times.len(),
                rank(0.5),
                rank(0.95)
            );
        }
    }
}
