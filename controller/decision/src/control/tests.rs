//! The whole decision with any inputs; and the law's part of it.

use messages::{DesiredTwist, RobotState, SolverStatus};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vpc::Strategy;

use super::*;
use crate::rules::Safety;

const MS: u64 = 1_000_000;
const PERIOD: u64 = 33 * MS;
const LIMITS: [f64; 6] = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
/// Features far from the goal: the law always wants to move.
const FAR: [[f64; 2]; 4] = [
    [250.0, 250.0],
    [420.0, 260.0],
    [410.0, 430.0],
    [240.0, 420.0],
];

fn nasty_instant(now_ns: u64, random: &mut impl Rng) -> u64 {
    match random.random_range(0..6) {
        0 => random.random(),
        1 => [0, 1, 1 << 63, u64::MAX - 1, u64::MAX][random.random_range(0..5)],
        _ => now_ns.saturating_add(PERIOD) - random.random_range(0..20 * PERIOD),
    }
}

fn nasty_stamp(now_ns: u64, random: &mut impl Rng) -> Stamp {
    Stamp {
        sequence: nasty_instant(now_ns, random),
        published_ns: nasty_instant(now_ns, random),
        data_ns: nasty_instant(now_ns, random),
    }
}

/// A number that makes a message any of: the first, the next, one after a gap, a repeated one,
/// a restarted one.
fn any_number(random: &mut impl Rng) -> u64 {
    [1, 7, 8, 9, random.random()][random.random_range(0..5)]
}

/// What a camera sends: good features mostly, so that the law has a say; anything else now and
/// then.
fn features(now_ns: u64, number: u64, random: &mut impl Rng) -> Input<Features> {
    let points = FAR.map(|point| point.map(|x| x + random.random_range(-0.1..0.1)));
    let mut message = Features::new(&points, now_ns - 20 * MS);
    (message.stamp.sequence, message.stamp.published_ns) = (number, now_ns - MS);
    match random.random_range(0..40) {
        0 => message.stamp = nasty_stamp(now_ns, random),
        1 => message.stamp.sequence = any_number(random),
        2 => message.points = message.points.map(|x| x * random.random_range(-1e9..1e9)),
        3 => message.points[random.random_range(0..8)] = f64::NAN,
        4 => message.count = random.random(),
        5 => message.visible = random.random(),
        6 => return Input::Nothing,
        7 => return Input::Refused(nasty_stamp(now_ns, random)),
        8 => return Input::Failed,
        _ => (),
    }
    Input::Message(message)
}

fn robot(now_ns: u64, random: &mut impl Rng) -> Input<RobotState> {
    let mut message = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns);
    message.stamp.published_ns = now_ns;
    match random.random_range(0..40) {
        0 => message.stamp = nasty_stamp(now_ns, random),
        1 => message.mode = random.random(),
        2 => message.faults = random.random(),
        3..20 => return Input::Nothing,
        _ => (),
    }
    Input::Message(message)
}

/// What a policy wants: something all the time, in part nonsense.
fn desired(now_ns: u64, random: &mut impl Rng) -> Input<DesiredTwist> {
    let twist = LIMITS.map(|most| most * random.random_range(-2.0..2.0));
    let mut message = DesiredTwist::until(twist, now_ns + 10 * PERIOD);
    message.stamp.published_ns = now_ns;
    match random.random_range(0..40) {
        0 => message.stamp = nasty_stamp(now_ns, random),
        1 => message.valid_until_ns = nasty_instant(now_ns, random),
        2 => message.twist[random.random_range(0..6)] = f64::NAN,
        3 => {
            message.twist = message
                .twist
                .map(|v| v * random.random_range(-1e300..1e300))
        }
        4 => return Input::Refused(nasty_stamp(now_ns, random)),
        5 => return Input::Failed,
        6..20 => return Input::Nothing,
        _ => (),
    }
    Input::Message(message)
}

fn control_with(settings: Settings, rules: Rules) -> ControlStep<'static> {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    ControlStep::new(&scene, settings, None, rules).unwrap()
}

/// Real time.
fn rules() -> Rules {
    Rules {
        valid_ns: Some(3 * PERIOD),
        limits: LIMITS,
        change: [f64::INFINITY; 6],
        brake_ns: 150 * MS,
        ramp_ns: 150 * MS,
        lost_ns: Some(300 * MS),
        needs_robot: false,
        begins_armed: true,
        after_arrival: Default::default(),
    }
}

/// In real time, at rest.
fn control() -> ControlStep<'static> {
    control_with(Settings::default(), rules())
}

#[test]
fn in_real_time_no_input_whatsoever_panics_or_passes_the_limits() {
    bear_inputs(3_000);
}

#[test]
#[ignore = "long: 60,000 inputs"]
fn in_real_time_no_input_of_very_many_panics_or_passes_the_limits() {
    bear_inputs(30_000);
}

fn bear_inputs(cycles: u64) {
    for strategy in [Strategy::Foresight, Strategy::Follow] {
        let settings = Settings {
            strategy,
            ..Settings::default()
        };
        bear_any_input(control_with(settings, rules()), cycles);
    }
}

fn bear_any_input(mut control: ControlStep, cycles: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut now_ns = 1 << 40;
    let (mut moving, mut still) = (0, 0);
    for cycle in 0..cycles {
        now_ns += match random.random_range(0..200) {
            0 => random.random_range(0..3000 * MS),
            1 => 0,
            _ => PERIOD,
        };
        // No clock should.
        now_ns -= if random.random_bool(0.005) { 2 * MS } else { 0 };
        if random.random_bool(0.3) {
            let action = if random.random_bool(0.9) {
                Action::Arm.code()
            } else {
                random.random_range(0..7)
            };
            let mut request = Request::new(cycle, Action::Status);
            (request.action, request.neighbours) = (action, random.random());
            // Who arms has seen the last stop, or not.
            let named = [control.veto(), random.random()];
            request.veto = named[usize::from(random.random_bool(0.5))];
            control.request(&request, cycle);
        }
        let inputs = Inputs {
            now_ns,
            features: features(now_ns, cycle + 1, &mut random),
            robot: robot(now_ns, &mut random),
            desired: desired(now_ns, &mut random),
            missed: match random.random_range(0..20) {
                0 => random.random(),
                _ => 0,
            },
            suspended: random.random_bool(0.002),
            shutdown: false,
        };
        let Answer { decision, .. } = control.decide(&inputs, &mut CycleRecord::default());
        let mut shares = decision.twist.iter().zip(LIMITS);
        // A NaN is not within.
        let is_within = shares.all(|(v, limit)| v.abs() <= limit * (1.0 + 1e-9));
        assert!(is_within, "{decision:?} after {inputs:?}");
        match decision.twist == [0.0; 6] {
            true => still += 1,
            false => moving += 1,
        }
    }
    // There was work, and there were faults.
    let least = cycles / 10;
    assert!(moving > least && still > least, "{moving} and {still}");
}

#[test]
fn a_rehearsal_runs_the_law_and_changes_nothing() {
    rehearse(500);
}

#[test]
#[ignore = "long: 3,000 cycles"]
fn no_rehearsal_of_many_changes_anything() {
    rehearse(3_000);
}

fn rehearse(cycles: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let (mut plain, mut rehearsing) = (control(), control());
    let mut by_the_law = 0;
    for cycle in 0..cycles {
        let now_ns = (1 << 40) + cycle * PERIOD;
        if random.random_bool(0.3) {
            for control in [&mut plain, &mut rehearsing] {
                control.request(&Request::new(cycle, Action::Arm), cycle);
            }
        }
        let instant = match random.random_range(0..10) {
            0 => nasty_instant(now_ns, &mut random),
            _ => now_ns,
        };
        let rehearsed = rehearsing.rehearse(instant);
        by_the_law += u64::from(rehearsed.is_some_and(|answer| answer.decision.hold.is_none()));
        let inputs = Inputs {
            now_ns,
            features: features(now_ns, cycle + 1, &mut random),
            robot: robot(now_ns, &mut random),
            desired: Input::Nothing,
            missed: 0,
            suspended: false,
            shutdown: false,
        };
        let told = [&mut plain, &mut rehearsing].map(|control| {
            let mut record = CycleRecord::default();
            control.decide(&inputs, &mut record);
            control.think();
            // As text: a NaN is no other than itself.
            format!("{record:?} {:?}", control.state())
        });
        assert!(told[0] == told[1], "cycle {cycle}: {inputs:?}");
    }
    assert!(by_the_law > cycles / 30, "{by_the_law}");
}

/// Simulated time, in which the law alone decides.
fn law() -> ControlStep<'static> {
    law_with(Settings::default())
}

fn law_with(settings: Settings) -> ControlStep<'static> {
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let safety = Safety::default();
    let rules = Rules::new(&scene, &settings, &safety, messages::ClockMode::Lockstep);
    control_with(settings, rules)
}

fn displaced(law: &ControlStep, offset: f64) -> Features {
    let goal = law.law.task().goal.clone();
    let points: Vec<_> = goal.iter().map(|p| [p[0] + offset, p[1]]).collect();
    Features::new(&points, 0)
}

#[test]
fn on_the_way_it_moves_and_at_the_goal_it_has_arrived() {
    let mut law = law();
    let mut record = CycleRecord::default();
    let (far, near) = (displaced(&law, 60.0), displaced(&law, 0.0));
    let decision = law.run_law(&far, 0, Link::New, false, &mut record);
    assert_eq!((decision.state, decision.hold), (TwistState::Moving, None));
    assert!(decision.twist.iter().any(|v| v.abs() > 1e-3));
    assert!((record.error_px - 60.0).abs() < 1e-6 && record.cost > 0.0);
    let decision = law.run_law(&near, 0, Link::New, false, &mut record);
    assert_eq!(decision.state, TwistState::Arrived);
}

#[test]
fn it_arrives_at_rest_and_leaves_when_it_is_clearly_away() {
    let mut law = law();
    let mut state = |offset: f64, had_arrived: bool| {
        let features = displaced(&law, offset);
        let record = &mut CycleRecord::default();
        law.run_law(&features, 0, Link::Next, had_arrived, record)
            .state
    };
    // The threshold is 2 px.
    assert_eq!(state(0.5, false), TwistState::Arrived);
    assert_eq!(state(3.0, false), TwistState::Moving);
    assert_eq!(state(3.0, true), TwistState::Arrived);
    assert_eq!(state(5.0, true), TwistState::Moving);
}

#[test]
fn what_the_law_refuses_is_held_with_its_cause() {
    let mut law = law();
    let mut off = displaced(&law, 0.0);
    off.points[0] = 1e6;
    let mut nan = displaced(&law, 0.0);
    nan.points[1] = f64::NAN;
    let mut five = displaced(&law, 0.0);
    five.count = 5;
    let mut mixed = displaced(&law, 0.0);
    mixed.points[..4].rotate_left(2);
    let mut zeros = displaced(&law, 0.0);
    zeros.points.fill(0.0);
    let mut hidden = displaced(&law, 0.0);
    hidden.visible = 0b0111;
    for (bad, hold) in [
        (hidden, Hold::Hidden),
        (off, Hold::OffImage),
        (nan, Hold::NotFinite),
        (five, Hold::Count),
        (mixed, Hold::Mixed),
        (zeros, Hold::Mixed),
    ] {
        let decision = law.run_law(&bad, 0, Link::Next, false, &mut CycleRecord::default());
        assert_eq!(decision, Decision::hold(hold));
    }
}

#[test]
fn hidden_points_are_carried_on_for_a_second() {
    let mut law = law();
    law.law.go_live(2_000_000_000);
    law.law.sent(&[0.0; 6], 1);
    let mut features = displaced(&law, 30.0);
    let mut step = |ns: u64, visible| {
        features.stamp.data_ns = ns;
        features.visible = visible;
        features.points[0] = if visible & 1 == 0 {
            1e9
        } else {
            features.points[0]
        };
        let mut record = CycleRecord {
            visible,
            ..CycleRecord::default()
        };
        let decision = law.run_law(&features, ns, Link::Next, false, &mut record);
        law.law.sent(&[0.0; 6], ns);
        (decision.hold, record)
    };
    const BEGIN_NS: u64 = 1_000_000_000;
    assert_eq!(step(BEGIN_NS, 0b1111).0, None);
    for k in 1..30 {
        let (hold, record) = step(BEGIN_NS + k * PERIOD, 0b1110);
        assert_eq!(hold, None, "{k}");
        // Where it was, within an ellipse that is not empty.
        let middle = record.points;
        assert!(
            middle[0] < 1000.0 && record.covariance[0] > 0.0,
            "{record:?}"
        );
        assert_eq!(record.covariance[3..], [0.0; 21]);
    }
    assert_eq!(step(BEGIN_NS + 31 * PERIOD, 0b1110).0, Some(Hold::Hidden));
}

#[test]
fn where_the_law_has_no_answer_the_camera_is_held() {
    let mut law = law_with(Settings {
        strategy: Strategy::Ibvs,
        ..Settings::default()
    });
    // Seen as a line, nearly: the interaction matrix is singular.
    let points = [
        [300.0, 299.0],
        [500.0, 299.0],
        [500.0, 301.0],
        [300.0, 301.0],
    ];
    let mut record = CycleRecord::default();
    let decision = law.run_law(&Features::new(&points, 0), 0, Link::New, false, &mut record);
    assert_eq!(decision, Decision::hold(Hold::Solver));
    assert_eq!(record.status, SolverStatus::NumericalFailure.code());
}

#[test]
fn on_a_live_robot_features_before_the_first_command_are_stale() {
    let mut law = law();
    law.law.go_live(100);
    let mut far = displaced(&law, 60.0);
    // The instant of the exposure is not known: it is no later than this.
    far.stamp.published_ns = 30;
    let step = |law: &mut ControlStep| {
        law.run_law(&far, 50, Link::New, false, &mut CycleRecord::default())
    };
    assert_eq!(step(&mut law), Decision::hold(Hold::Stale));
    law.law.sent(&[0.0; 6], 0);
    assert_eq!(step(&mut law).state, TwistState::Moving);
    law.law.forget_sent();
    assert_eq!(step(&mut law), Decision::hold(Hold::Stale));
}

#[test]
fn a_live_image_that_ignores_commands_is_not_believed() {
    const PERIOD: u64 = 33_000_000;
    let mut law = law();
    law.law.go_live(3 * PERIOD);
    let mut frame = displaced(&law, 60.0);
    let mut holds = Vec::new();
    for k in 1..21 {
        frame.stamp.data_ns = k * PERIOD;
        law.law.sent(&[0.1, 0.0, 0.0, 0.0, 0.0, 0.0], k * PERIOD);
        let decision = law.run_law(
            &frame,
            k * PERIOD,
            Link::Next,
            false,
            &mut CycleRecord::default(),
        );
        holds.push(decision.hold);
    }
    assert!(holds.contains(&Some(Hold::Frozen)), "{holds:?}");
    // The points by other names, in the place of the old ones: until they were out of sight.
    frame.points[..8].rotate_left(2);
    let mut step = |law: &mut ControlStep, k: u64| {
        frame.stamp.data_ns = k * PERIOD;
        law.run_law(
            &frame,
            k * PERIOD,
            Link::Next,
            false,
            &mut CycleRecord::default(),
        )
        .hold
    };
    assert_eq!(step(&mut law, 21), Some(Hold::Mixed));
    law.law.lose_sight();
    assert_eq!(step(&mut law, 22), None);
}

#[test]
fn a_live_image_may_repeat_until_a_late_first_command_moves_it() {
    const PERIOD: u64 = 33_000_000;
    // How late the command leaves, and how often the image repeats after it: whether it is frozen.
    let cases = [
        (0, 1, false),
        (0, 2, true),
        (PERIOD - 1_000_000, 1, false),
        (PERIOD - 1_000_000, 2, true),
    ];
    for (late_ns, repeats, is_frozen) in cases {
        let mut law = law();
        law.law.go_live(100 * PERIOD);
        law.law.sent(&[0.0; 6], 0);
        let mut frame = displaced(&law, 60.0);
        let mut step = |law: &mut ControlStep, k: u64| {
            frame.stamp.data_ns = k * PERIOD;
            let record = &mut CycleRecord::default();
            law.run_law(&frame, k * PERIOD, Link::Next, false, record)
                .hold
        };
        assert_eq!(step(&mut law, 1), None);
        law.law.sent(&[0.3, 0.0, 0.0, 0.0, 0.0, 0.0], PERIOD);
        law.law.sent_late(PERIOD + late_ns);
        let holds: Vec<_> = (2..2 + repeats).map(|k| step(&mut law, k)).collect();
        let case = format!("{late_ns}, {repeats}: {holds:?}");
        assert_eq!(holds.contains(&Some(Hold::Frozen)), is_frozen, "{case}");
    }
}

#[test]
fn on_a_live_robot_a_point_that_leaps_is_not_believed_at_once() {
    const PERIOD: u64 = 33_000_000;
    let mut law = law();
    law.law.go_live(100 * PERIOD);
    law.law.sent(&[0.0; 6], 0);
    let good = displaced(&law, 60.0);
    let mut leapt = good;
    leapt.points[0] += 100.0;
    let mut step = |k: u64, mut frame: Features| {
        frame.stamp.data_ns = k * PERIOD;
        // No two images are the same.
        frame.points[1] += 1e-6 * k as f64;
        law.run_law(
            &frame,
            k * PERIOD,
            Link::Next,
            false,
            &mut CycleRecord::default(),
        )
        .hold
    };
    assert_eq!(step(1, good), None);
    assert_eq!(step(2, leapt), Some(Hold::Mixed));
    assert_eq!(step(3, good), None);
    // It stays where it went: whoever it was is now the point.
    for k in 4..7 {
        assert_eq!(step(k, leapt), Some(Hold::Mixed), "{k}");
    }
    assert_eq!(step(7, leapt), None);
}

#[test]
fn a_wanted_twist_is_followed_while_it_counts() {
    const WANTED: [f64; 6] = [0.01, -0.02, 0.015, 0.03, 0.0, -0.05];
    let steps = |strategy, wish: &dyn Fn(u64) -> Input<DesiredTwist>| -> Vec<Decision> {
        let settings = Settings {
            strategy,
            ..Settings::default()
        };
        let rules = Rules {
            valid_ns: None,
            ..rules()
        };
        let mut control = control_with(settings, rules);
        let decisions = (1..=8).map(|k| {
            let mut features = Features::new(&FAR, k * PERIOD);
            (features.stamp.sequence, features.stamp.published_ns) = (k, k * PERIOD);
            let inputs = Inputs {
                now_ns: k * PERIOD,
                features: Input::Message(features),
                robot: Input::Nothing,
                desired: wish(k),
                missed: 0,
                suspended: false,
                shutdown: false,
            };
            control
                .decide(&inputs, &mut CycleRecord::default())
                .decision
        });
        decisions.collect()
    };
    let wanted = |k: u64, until_ns| {
        let mut desired = DesiredTwist::until(WANTED, until_ns);
        desired.stamp.published_ns = k * PERIOD;
        Input::Message(desired)
    };
    let once = |k| match k {
        2 => wanted(k, 5 * PERIOD),
        _ => Input::Nothing,
    };
    let followed = steps(Strategy::Follow, &once);
    let holds: Vec<_> = followed.iter().map(|decision| decision.hold).collect();
    let none = Some(Hold::Unwanted);
    let expected = [none, None, None, None, none, none, none, none];
    assert_eq!(holds, expected);
    for decision in &followed[1..4] {
        // To the last bit.
        assert_eq!(decision.twist, WANTED);
        assert_eq!(decision.state, TwistState::Moving);
    }
    // One that is refused ends what was wanted before; one from long ago counts for nothing.
    let refused = |k| match k {
        3 => Input::Refused(Stamp::default()),
        _ => once(k),
    };
    assert_eq!(steps(Strategy::Follow, &refused)[2].hold, none);
    let late = |k: u64| match k {
        8 => wanted(1, 2 * PERIOD),
        _ => Input::Nothing,
    };
    assert_eq!(steps(Strategy::Follow, &late)[7].hold, none);
    // Other strategies do not listen.
    let deaf = [&once as &dyn Fn(u64) -> _, &|_| Input::Nothing];
    let [with, without] = deaf.map(|wish| steps(Strategy::Previous, wish));
    assert_eq!(with, without);
}

#[test]
fn the_law_believes_that_the_camera_obeys_what_it_is_told() {
    let now_ns = 1 << 40;
    let mut message = Features::new(&FAR, now_ns);
    (message.stamp.sequence, message.stamp.published_ns) = (1, now_ns);
    let inputs = Inputs {
        now_ns,
        features: Input::Message(message),
        robot: Input::Nothing,
        desired: Input::Nothing,
        missed: 0,
        suspended: false,
        shutdown: false,
    };
    let at_once = Rules {
        ramp_ns: 0,
        ..rules()
    };
    let mut control = control_with(Settings::default(), at_once);
    let decided = control.decide(&inputs, &mut CycleRecord::default());
    let twist = decided.decision.twist;
    assert_ne!(twist, [0.0; 6]);
    let state = control.state();
    control.obeyed(&twist, now_ns);
    assert_eq!(control.state(), state);
    let expected = control.law().expected(now_ns + PERIOD);
    control.obeyed(&twist.map(|v| 0.5 * v), now_ns);
    assert!(expected.is_some());
    assert_ne!(control.law().expected(now_ns + PERIOD), expected);
}

#[test]
fn a_change_between_a_guard_and_a_goal_disarms() {
    let rules = Rules {
        lost_ns: None,
        valid_ns: None,
        ..rules()
    };
    for (from, to) in [
        (Strategy::Follow, StrategyCode::Previous),
        (Strategy::Previous, StrategyCode::Follow),
    ] {
        let settings = Settings {
            strategy: from,
            ..Settings::default()
        };
        let mut control = control_with(settings, rules);
        let far = displaced(&control, 60.0);
        let mut cycle = 0;
        let mut step = |control: &mut ControlStep| {
            cycle += 1;
            let mut features = far;
            features.points[0] += 1e-9 * cycle as f64;
            (features.stamp.sequence, features.stamp.published_ns) = (cycle, cycle * PERIOD);
            let inputs = Inputs {
                now_ns: cycle * PERIOD,
                features: Input::Message(features),
                robot: Input::Nothing,
                desired: Input::Nothing,
                missed: 0,
                suspended: false,
                shutdown: false,
            };
            control
                .decide(&inputs, &mut CycleRecord::default())
                .decision
        };
        (0..3).for_each(|_| _ = step(&mut control));
        let ask =
            |control: &mut ControlStep, code| control.request(&Request::strategy(1, code, 0), 1);
        // Another goal's strategy disarms nobody, nor does one that is not known.
        let same = contract::strategy_code(from).0;
        assert_eq!(ask(&mut control, same).veto, 0);
        assert_eq!(
            ask(&mut control, StrategyCode::Gpr).outcome(),
            Some(Outcome::NoMemory)
        );
        assert_ne!(step(&mut control).state, TwistState::Disarmed);
        let reply = ask(&mut control, to);
        assert_eq!(reply.outcome(), Some(Outcome::Done));
        let told = (reply.state(), reply.hold());
        assert_eq!(told, (Some(TwistState::Braking), Some(Hold::Operator)));
        (0..8).for_each(|_| _ = step(&mut control));
        assert_eq!(step(&mut control).state, TwistState::Disarmed, "{to}");
        // Who armed the other one did not mean this one.
        let arm =
            |control: &mut ControlStep, veto| control.request(&Request::arm(2, veto), 1).outcome();
        assert_eq!(arm(&mut control, 0), Some(Outcome::Vetoed));
        assert_eq!(arm(&mut control, reply.veto), Some(Outcome::Done));
    }
}

/// What a robot does that is wanted to roll its camera on and on, the joint at the hand nearing the
/// end of its range.
struct Rolled {
    /// Where joint 7 of the Panda ends, rad.
    ends_at: f64,
    record: CycleRecord,
}

/// Rolls for `seconds`; after half a second `lie` changes what the robot tells.
fn rolled(seconds: f64, lie: impl Fn(&mut RobotState, &[arm::Joints])) -> Rolled {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
    let text = format!("arm = 'panda.toml'\n{}", scene::PAPER_ROBOT);
    let mut scene = Scene::parse(&text, path).unwrap();
    scene.occlusions.clear();
    (scene.limits.linear, scene.limits.angular) = (0.1, 0.4);
    let settings = Settings {
        strategy: Strategy::Follow,
        ..Settings::default()
    };
    let rules = Rules {
        valid_ns: Some(3 * PERIOD),
        limits: scene.limits.velocity(),
        needs_robot: true,
        ..rules()
    };
    let mut control = ControlStep::new(&scene, settings, None, rules).unwrap();
    let known = control.law.task().arm.clone().unwrap();
    let mut q = arm::Joints::from(arm::READY);
    let object = known.chain.pose(&q) * arm::Pose::translation(0.0, 0.0, 0.4);
    let (mut twist, mut past) = ([0.0; 6], Vec::new());
    let mut record = CycleRecord::default();
    let begin_ns = 1 << 40;
    let last = (seconds * 1e9) as u64 / PERIOD;
    for k in 1..=last {
        let now_ns = begin_ns + k * PERIOD;
        q = known.moved(&q, &twist, 0.0, PERIOD as f64 * 1e-9);
        past.push(q);
        let seen = known.chain.pose(&q).inverse() * object;
        let points = scene.pattern.iter().map(|[x, y, z]| {
            let at = (seen * arm::Pose::translation(*x, *y, *z)).translation;
            let camera = &scene.camera;
            let [a, b] = [at.x / at.z, at.y / at.z];
            // As noisy as a camera: a frozen image is another matter.
            let noise = 0.02 * ((7 * k) % 11) as f64;
            [camera.fx * a + camera.cx + noise, camera.fy * b + camera.cy]
        });
        let mut features = Features::new(&points.collect::<Vec<_>>(), now_ns);
        (features.stamp.sequence, features.stamp.published_ns) = (k, now_ns);
        let mut robot = RobotState::free_camera([0.0; 3], [0.0; 3], now_ns);
        (robot.stamp.sequence, robot.stamp.published_ns) = (k, now_ns);
        (robot.mode, robot.joints) = (messages::RobotMode::Moving.code(), 7);
        (robot.q, robot.twist) = (q.into(), twist);
        if k * PERIOD > 500 * MS {
            lie(&mut robot, &past);
        }
        let mut wanted = DesiredTwist::until([0.0, 0.0, 0.0, 0.0, 0.0, 0.4], now_ns + PERIOD);
        wanted.stamp.published_ns = now_ns;
        let inputs = Inputs {
            now_ns,
            features: Input::Message(features),
            robot: Input::Message(robot),
            desired: Input::Message(wanted),
            missed: 0,
            suspended: false,
            shutdown: false,
        };
        record = CycleRecord::default();
        twist = control.decide(&inputs, &mut record).decision.twist;
    }
    Rolled {
        ends_at: q[6],
        record,
    }
}

#[test]
fn no_joint_leaves_its_range_however_the_robot_lies_of_its_joints() {
    const END: f64 = 2.8973;
    let is_held = |rolled: &Rolled, hold: Option<Hold>| {
        assert_eq!(rolled.record.hold(), hold, "{}", rolled.ends_at);
        assert!(rolled.ends_at < END, "{hold:?}: {}", rolled.ends_at);
    };
    let honest = rolled(9.0, |_, _| ());
    is_held(&honest, None);
    assert!(
        (honest.ends_at - (END - 0.2)).abs() < 0.01,
        "{}",
        honest.ends_at
    );
    let follows = Some(Hold::JointsNotFollowing);
    let when = (500 * MS / PERIOD) as usize;
    let frozen = rolled(9.0, |robot, past| robot.q = past[when].into());
    is_held(&frozen, follows);
    // Half a second, not ten.
    assert!(frozen.ends_at < 1.4, "{}", frozen.ends_at);
    let fault = frozen.record.joint_fault().unwrap();
    assert_eq!(fault.code, messages::JointFaultCode::Rotation);
    let late = |seconds: f64| {
        rolled(9.0, move |robot, past| {
            let ago = (seconds * 1e9) as usize / PERIOD as usize;
            robot.q = past[past.len().saturating_sub(1 + ago)].into();
        })
    };
    is_held(&late(0.6), follows);
    is_held(&late(0.2), None);
    is_held(
        &rolled(9.0, |robot, past| {
            if past.len() % 2 == 0 {
                robot.q[6] = -2.0;
            }
        }),
        follows,
    );
    let unknown = Some(Hold::NoJoints);
    for lie in [
        |robot: &mut RobotState| robot.stamp.data_ns += 1 << 60,
        |robot: &mut RobotState| robot.q[6] = 5.0,
        |robot: &mut RobotState| robot.q[6] = 1e300,
        |robot: &mut RobotState| robot.q[6] -= std::f64::consts::TAU,
        |robot: &mut RobotState| robot.q = robot.q.map(f64::to_degrees),
        |robot: &mut RobotState| robot.q = [0.0; 7],
        |robot: &mut RobotState| robot.q.reverse(),
        |robot: &mut RobotState| robot.joints = 6,
        |robot: &mut RobotState| robot.joints = 0,
    ] {
        let held = rolled(3.0, |robot, _| lie(robot));
        is_held(&held, unknown);
        assert!(held.ends_at < 1.2, "{}", held.ends_at);
    }
}
