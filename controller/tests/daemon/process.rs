//! The whole daemon as its peers see it.

use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain, Observer, OperatorPorts, RobotPorts};
use messages::{
    Action, Features, Hold, Order, Outcome, Request, RobotMode, RobotState, StrategyCode,
    TwistCommand, TwistState,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;

use crate::fixture::{Place, Running, ended, eventually, scene_file, square, vpcd, vpcd_in};

const PATIENCE: Duration = Duration::from_secs(10);

/// A camera that shows random features, and the daemon.
struct Bench {
    scene: Scene,
    camera: CameraPorts,
    robot: RobotPorts,
    observer: Observer,
    random: ChaCha8Rng,
    // Last: it clears away what is left of the domain.
    place: Place,
}

impl Bench {
    fn new() -> Self {
        let place = Place::new();
        let domain = Domain::join(&place.domain()).unwrap();
        Self {
            scene: Scene::read(&scene_file()).unwrap(),
            camera: CameraPorts::open(&domain).unwrap(),
            robot: RobotPorts::open(&domain).unwrap(),
            observer: Observer::open(&domain).unwrap(),
            random: ChaCha8Rng::seed_from_u64(1),
            place,
        }
    }

    fn start(&self, arguments: &[&str]) -> Running {
        let mut command = vpcd_in(&self.place);
        command.args(arguments);
        Running::start(command)
    }

    fn features(&mut self) -> Features {
        Features::new(&square(&self.scene, &mut self.random), ipc::now_ns())
    }

    fn ask(&mut self, features: &Features) -> TwistCommand {
        let sent = self.camera.features.publish(features).unwrap();
        let answer = self.camera.wait_for_answer(&sent, PATIENCE).unwrap();
        answer.expect("an answer in time").message
    }

    /// Connects to the daemon, which is at work: what it says later is then kept, even after its
    /// end.
    fn attach(&mut self) {
        self.observer.twist.refresh().unwrap();
        self.observer.cycles.refresh().unwrap();
    }

    fn last_command(&mut self) -> TwistCommand {
        let newest = self.observer.twist.latest().unwrap();
        newest.expect("a command").message
    }
}

#[test]
fn lockstep_answers_each_message_exactly_once() {
    let mut bench = Bench::new();
    let daemon = bench.start(&["--clock", "lockstep", "--cycles", "50"]);
    for k in 1..=50 {
        let features = bench.features();
        let answer = bench.ask(&features);
        assert_eq!((answer.features_sequence, answer.stamp.sequence), (k, k));
        bench.attach();
        assert_eq!(answer.state(), Some(TwistState::Moving));
        let limits = bench.scene.limits;
        assert!(
            answer.twist[..3]
                .iter()
                .all(|v| v.abs() <= limits.linear * 1.000_001)
        );
        assert!(
            answer.twist[3..]
                .iter()
                .all(|w| w.abs() <= limits.angular * 1.000_001)
        );
    }
    let (code, log) = daemon.ended().log();
    assert_eq!(code, 0, "{log}");
    assert!(
        log.contains("stopped") && log.contains("cycles=50"),
        "{log}"
    );
    // The last word is zero, and answers nothing.
    let last = bench.last_command();
    assert_eq!(
        (last.features_sequence, last.state()),
        (0, Some(TwistState::Stopped))
    );
    assert_eq!(last.twist, [0.0; 6]);
    let mut stood = 0;
    for k in 1..=50 {
        let record = bench
            .observer
            .cycles
            .oldest()
            .unwrap()
            .expect("a record of each cycle");
        assert_eq!(
            (record.cycle, record.features_sequence, record.count),
            (k, k, 4)
        );
        assert!(record.error_px > 0.0 && record.step_ns > 0 && record.hold().is_none());
        // Random features may be inside an occlusion, where the law may stand.
        let stands = record.twist == [0.0; 6];
        assert!(!stands || record.clearance_px < 0.0, "{record:?}");
        stood += usize::from(stands);
    }
    assert!(stood <= 10, "{stood}");
    assert_eq!(bench.observer.cycles.oldest().unwrap(), None);
}

/// Processor time of a process, s. Linux counts it in hundredths.
fn processor_s(id: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap();
    let (_, fields) = stat.rsplit_once(") ").unwrap();
    // The first field behind the name is the third of all; these are the 14th and the 15th.
    let ticks = fields.split(' ').skip(11).take(2);
    let ticks: u32 = ticks.map(|field| field.parse::<u32>().unwrap()).sum();
    f64::from(ticks) / 100.0
}

#[test]
fn in_lockstep_a_loop_without_a_camera_sleeps() {
    let mut bench = Bench::new();
    let daemon = bench.start(&["--clock", "lockstep"]);
    let features = bench.features();
    bench.ask(&features);
    // Sleeps become longer with the silence.
    std::thread::sleep(Duration::from_millis(500));
    let (begin, before) = (Instant::now(), processor_s(daemon.id()));
    std::thread::sleep(Duration::from_secs(2));
    let share = (processor_s(daemon.id()) - before) / begin.elapsed().as_secs_f64();
    // An even pace of 20 us uses 0.2 to 0.5.
    assert!(share < 0.05, "{share} of a processor");
    let features = bench.features();
    assert_eq!(bench.ask(&features).state(), Some(TwistState::Moving));
    assert_eq!(daemon.terminated().code, Some(0));
}

#[test]
fn bad_features_are_answered_with_zero_and_good_ones_go_on() {
    let mut bench = Bench::new();
    let daemon = bench.start(&["--clock", "lockstep"]);
    let mut nan = bench.features();
    nan.points[2] = f64::NAN;
    let mut hidden = bench.features();
    hidden.visible = 0b0001;
    let mut off = bench.features();
    off.points[0] = -500.0;
    let three = Features::new(
        &[[100.0, 100.0], [200.0, 100.0], [200.0, 200.0]],
        ipc::now_ns(),
    );
    let nine = Features::new(&[[100.0, 100.0]; 9], ipc::now_ns());
    let bad = [
        // Before any image showed all points, nothing carries it on.
        (hidden, Hold::Hidden),
        (nan, Hold::Invalid),
        (off, Hold::OffImage),
        (three, Hold::Count),
        (nine, Hold::Invalid),
    ];
    for (bad, cause) in bad {
        let answer = bench.ask(&bad);
        assert_eq!(
            (answer.state(), answer.twist),
            (Some(TwistState::Holding), [0.0; 6]),
            "{cause}"
        );
        let record = eventually("a record", || bench.observer.cycles.latest().unwrap());
        assert_eq!(record.hold(), Some(cause));
        let good = bench.features();
        let answer = bench.ask(&good);
        assert_eq!(answer.state(), Some(TwistState::Moving), "{cause}");
        eventually("a record", || bench.observer.cycles.latest().unwrap());
    }
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    for words in [
        "invalid message",
        "hidden point",
        "off image",
        "wrong count",
    ] {
        assert!(log.contains(words), "{log}\nlacks: {words}");
    }
}

#[test]
fn a_silent_camera_is_met_with_zero() {
    let mut bench = Bench::new();
    let config = "[safety]\nrobot = 'optional'\n";
    let config = bench.place.file("vpcd.toml", config);
    let config = config.to_str().unwrap();
    let daemon = bench.start(&["--clock", "fixed", "--config", config]);
    // The twist of a live camera moves.
    eventually("a moving twist", || {
        let features = bench.features();
        bench.camera.features.publish(&features).unwrap();
        let twist = bench.camera.twist.latest().unwrap()?;
        (twist.state() == Some(TwistState::Moving) && twist.is_valid_at(ipc::now_ns()))
            .then_some(())
    });
    // Silence: the daemon goes on sending, and what it sends is zero.
    let held = eventually("the end of all motion", || {
        let twist = bench.camera.twist.latest().unwrap()?;
        (twist.state() == Some(TwistState::Disarmed)).then_some(twist)
    });
    assert_eq!(held.twist, [0.0; 6]);
    // Features alone do not set it in motion again.
    for _ in 0..5 {
        let features = bench.features();
        bench.camera.features.publish(&features).unwrap();
        let next = eventually("another command", || bench.camera.twist.latest().unwrap());
        assert_eq!(
            (next.state(), next.twist),
            (Some(TwistState::Disarmed), [0.0; 6])
        );
    }
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    // A machine so busy that releases were missed gives the daemon other reasons to stop.
    let is_starved = log.contains("overrun");
    for words in ["braking: stale features", "disarmed: features lost"] {
        assert!(is_starved || log.contains(words), "{log}\nlacks: {words}");
    }
}

#[test]
fn an_operator_arms_changes_the_strategy_disarms_and_stops() {
    let place = Place::new();
    let mut command = vpcd();
    // The camera is an ordinary thread, whose frames come late on a busy machine, and it does not
    // move: so slowly that its points are not taken for others.
    let text = "[cycle]\nstale_periods = 20.0\n[safety]\nlost_s = 10.0\nrobot = 'optional'\n";
    command.arg("--config").arg(place.file("vpcd.toml", text));
    let text = std::fs::read_to_string(scene_file()).unwrap();
    let slow = text
        .replace("linear = 0.5", "linear = 0.02")
        .replace("angular = 1.0", "angular = 0.02");
    assert_ne!(slow, text);
    command.arg("--scene").arg(place.file("scene.toml", slow));
    command.arg("--domain").arg(place.domain());
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let daemon = Running::start(command);
    let domain = Domain::join(&place.domain()).unwrap();
    let mut operator = OperatorPorts::open(&domain).unwrap();
    let id = std::cell::Cell::new(0);
    let mut ask = |request: fn(u64) -> Request| {
        // Until the daemon is up there is nobody to hear a request.
        let reply = eventually("an answer", || {
            id.set(id.get() + 1);
            let patience = Duration::from_millis(200);
            operator.ask(&request(id.get()), patience).unwrap()
        });
        (reply.outcome().unwrap(), reply.state().unwrap(), reply)
    };
    let arm = |id| Request::new(id, Action::Arm);
    let first = ask(arm);
    assert_eq!(
        (first.0, first.1),
        (Outcome::NoFeatures, TwistState::Disarmed)
    );
    let ended = AtomicBool::new(false);
    let commands = std::thread::scope(|threads| {
        // A camera that sends features of its own accord, and notes what it is told.
        let camera = threads.spawn(|| {
            let domain = Domain::join(&place.domain()).unwrap();
            let mut camera = CameraPorts::open(&domain).unwrap();
            let scene = Scene::read(&scene_file()).unwrap();
            let mut random = ChaCha8Rng::seed_from_u64(1);
            let mut commands = Vec::new();
            let mut points = square(&scene, &mut random);
            while !ended.load(Ordering::Relaxed) {
                // Not the last bit stays: the daemon would take the image for frozen.
                points
                    .as_flattened_mut()
                    .iter_mut()
                    .for_each(|x| *x += random.random_range(-0.1..0.1));
                let features = Features::new(&points, ipc::now_ns());
                camera.features.publish(&features).unwrap();
                std::thread::sleep(Duration::from_millis(30));
                while let Some(twist) = camera.twist.oldest().unwrap() {
                    commands.push(twist.message);
                }
            }
            commands
        });
        let status = |id| Request::new(id, Action::Status);
        let is_moving = |state| matches!(state, TwistState::Moving | TwistState::Arrived);
        eventually("arming", || (ask(arm).0 == Outcome::Done).then_some(()));
        eventually("motion", || is_moving(ask(status).1).then_some(()));
        let gpr = ask(|id| Request::strategy(id, StrategyCode::Gpr, 0));
        assert_eq!(gpr.0, Outcome::NoMemory);
        assert_eq!(gpr.2.strategy, StrategyCode::Foresight.code());
        let knn = ask(|id| Request::strategy(id, StrategyCode::Knn, 65));
        assert_eq!(knn.0, Outcome::Neighbours);
        let ibvs = ask(|id| Request::strategy(id, StrategyCode::Ibvs, 0));
        assert_eq!(ibvs.0, Outcome::Done);
        assert_eq!(ibvs.2.strategy, StrategyCode::Ibvs.code());
        // What the contract does not know moves nothing, and is answered.
        let unknown_action = ask(|id| Request {
            action: 99,
            ..Request::new(id, Action::Status)
        });
        assert_eq!(unknown_action.0, Outcome::Unknown);
        assert_eq!(unknown_action.2.action, Action::Status.code());
        let unknown_strategy = ask(|id| Request {
            strategy: 77,
            ..Request::new(id, Action::Strategy)
        });
        assert_eq!(unknown_strategy.0, Outcome::Unknown);
        assert_eq!(unknown_strategy.2.strategy, StrategyCode::Ibvs.code());
        let disarm = ask(|id| Request::new(id, Action::Disarm));
        assert_eq!((disarm.0, disarm.1), (Outcome::Done, TwistState::Braking));
        eventually("rest", || {
            (ask(status).1 == TwistState::Disarmed).then_some(())
        });
        eventually("arming", || (ask(arm).0 == Outcome::Done).then_some(()));
        eventually("motion", || is_moving(ask(status).1).then_some(()));
        let stop = ask(|id| Request::new(id, Action::Stop));
        assert_eq!((stop.0, stop.1), (Outcome::Done, TwistState::Disarmed));
        ended.store(true, Ordering::Relaxed);
        camera.join().unwrap()
    });
    // What the camera saw: still, moving, braking, still, moving, still at once.
    let mut states: Vec<_> = commands
        .iter()
        .map(|twist| match twist.state().unwrap() {
            TwistState::Arrived => TwistState::Moving,
            state => state,
        })
        .collect();
    states.dedup();
    use TwistState::{Braking, Disarmed, Moving};
    assert_eq!(
        states[..6],
        [Disarmed, Moving, Braking, Disarmed, Moving, Disarmed]
    );
    for twist in &commands {
        let is_still = twist.twist == [0.0; 6];
        assert_eq!(is_still, twist.state() == Some(Disarmed), "{twist:?}");
    }
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    for words in [
        "operator: arm: refused: no good features",
        "operator: arm: done",
        "operator: strategy: refused: no memory of motion",
        "operator: request refused: vpc/requests: action = 99; allowed: 0 status, 1 arm",
        "operator: request refused: vpc/requests: strategy = 77",
        "operator: stop: done",
        "disarmed: operator",
    ] {
        assert!(log.contains(words), "{log}\nlacks: {words}");
    }
}

#[test]
fn a_faulty_robot_stops_the_camera_and_a_silent_one_disarms() {
    let mut bench = Bench::new();
    let mut operator = {
        let domain = Domain::join(&bench.place.domain()).unwrap();
        OperatorPorts::open(&domain).unwrap()
    };
    let daemon = bench.start(&[]);
    // Requests from before it listens would be lost.
    eventually("a command", || bench.camera.twist.latest().unwrap());
    let mut points = bench.features();
    let mut id = 0;
    // A frame, and what the robot says of itself beside it; what the daemon does about it, and what
    // it says to `arm`.
    let mut frame = |robot: Option<RobotMode>, arms: bool| {
        for x in &mut points.points[..8] {
            *x += bench.random.random_range(-0.1..0.1);
        }
        points.stamp.data_ns = ipc::now_ns();
        bench.camera.features.publish(&points).unwrap();
        if let Some(mode) = robot {
            let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], ipc::now_ns());
            state.mode = mode.code();
            bench.robot.robot.publish(&state).unwrap();
        }
        std::thread::sleep(Duration::from_millis(30));
        id += 1;
        let reply = arms.then(|| operator.ask(&Request::new(id, Action::Arm), PATIENCE));
        let outcome = reply.and_then(|reply| reply.unwrap().unwrap().outcome());
        let record = bench.observer.cycles.latest().unwrap();
        let record = record.map(|found| {
            let state = TwistState::from_code(found.state).unwrap();
            (state, found.hold(), found.twist)
        });
        (outcome, record)
    };
    type Seen = (TwistState, Option<Hold>, [f64; 6]);
    let moves = |(_, record): (_, Option<Seen>)| {
        record.filter(|(state, _, _)| *state == TwistState::Moving)
    };
    for (robot, cause, refusal) in [
        (
            Some(RobotMode::Fault),
            Some(Hold::RobotFault),
            Outcome::RobotFault,
        ),
        (None, Some(Hold::RobotLost), Outcome::RobotLost),
    ] {
        // Armed again and again: a busy machine may have disarmed it.
        eventually("motion", || moves(frame(Some(RobotMode::Idle), true)));
        let disarmed = Some((TwistState::Disarmed, cause, [0.0; 6]));
        eventually("disarmed", || match frame(robot, false).1 {
            Some((TwistState::Disarmed, other, _)) if other != cause => {
                frame(Some(RobotMode::Idle), true);
                None
            }
            record => (record == disarmed).then_some(()),
        });
        assert_eq!(frame(robot, true).0, Some(refusal), "{cause:?}");
        // The robot is back: nothing moves by itself.
        for _ in 0..5 {
            let (_, record) = frame(Some(RobotMode::Idle), false);
            assert!(record.is_none() || record == disarmed, "{record:?}");
        }
        eventually("arming", || {
            (frame(Some(RobotMode::Idle), true).0 == Some(Outcome::Done)).then_some(())
        });
    }
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
}

#[test]
fn nothing_moves_before_a_robot_was_heard() {
    let mut bench = Bench::new();
    let daemon = bench.start(&[]);
    eventually("a command", || bench.camera.twist.latest().unwrap());
    let mut start = bench.scene.goal;
    start.translation[0] += 0.05;
    start.translation[2] += 0.1;
    let mut camera = FreeCamera::new(&bench.scene, &start);
    let (mut command, mut since_ns) = ([0.0; 6], ipc::now_ns());
    // A frame of a camera that carries out what is commanded, and beside it a robot that says how
    // much faster it moves along y, m/s: the newest record.
    let mut frame = |faster: Option<f64>| {
        let now_ns = ipc::now_ns();
        camera.advance(&command, (now_ns - since_ns) as f64 * 1e-9);
        since_ns = now_ns;
        let mut points = camera.features().unwrap();
        // What repeats itself to the bit is frozen.
        for x in points.iter_mut().flatten() {
            *x += bench.random.random_range(-0.1..0.1);
        }
        let features = Features::new(&points, now_ns);
        bench.camera.features.publish(&features).unwrap();
        if let Some(faster) = faster {
            let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns);
            state.mode = RobotMode::Moving.code();
            state.twist = command;
            state.twist[1] += faster;
            bench.robot.robot.publish(&state).unwrap();
        }
        if let Some(newest) = bench.camera.twist.latest().unwrap() {
            command = newest.message.twist;
        }
        std::thread::sleep(Duration::from_millis(30));
        let record = bench.observer.cycles.latest().unwrap();
        record.map(|found| (found.hold(), found.twist != [0.0; 6]))
    };
    eventually("a cause", || {
        (frame(None) == Some((Some(Hold::NoRobot), false))).then_some(())
    });
    for _ in 0..10 {
        assert!(frame(None).is_none_or(|found| found == (Some(Hold::NoRobot), false)));
    }
    eventually("motion", || frame(Some(0.0)).filter(|(_, moves)| *moves));
    // It follows; then something else moves it, twice as fast as the limit.
    for _ in 0..40 {
        let cause = frame(Some(0.0)).and_then(|(hold, _)| hold);
        assert_ne!(cause, Some(Hold::NotFollowed));
    }
    eventually("disarmed", || {
        (frame(Some(1.0)) == Some((Some(Hold::NotFollowed), false))).then_some(())
    });
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    assert!(log.contains("disarmed: not followed"), "{log}");
}

#[test]
fn before_any_camera_the_twist_is_zero_and_sigterm_ends_it() {
    let mut bench = Bench::new();
    let daemon = bench.start(&[]);
    let first = eventually("a command", || bench.camera.twist.latest().unwrap());
    assert_eq!(
        (first.twist, first.state()),
        ([0.0; 6], Some(TwistState::Holding))
    );
    assert_eq!(first.features_sequence, 0);
    bench.attach();
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    assert_eq!(bench.last_command().state(), Some(TwistState::Stopped));
}

#[test]
fn waiting_armed_for_camera_and_robot_is_no_fault() {
    let mut bench = Bench::new();
    let daemon = bench.start(&[]);
    eventually("a command", || bench.camera.twist.latest().unwrap());
    bench.attach();
    // A robot comes and goes before any camera.
    let state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], ipc::now_ns());
    bench.robot.robot.publish(&state).unwrap();
    eventually("disarmed", || {
        let newest = bench.observer.cycles.latest().unwrap();
        newest.filter(|record| record.hold() == Some(Hold::RobotLost))
    });
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let said = |level: &str| log.lines().filter(|line| line.contains(level)).count();
    assert_eq!(said(" WARN "), 1, "{log}");
    assert!(log.contains("WARN disarmed: robot silent"), "{log}");
    assert!(log.contains("INFO holding: no robot"), "{log}");
    assert!(!log.contains("flight record"), "{log}");
    assert!(!log.contains("NaN"), "{log}");
}

#[test]
fn a_second_daemon_is_69_and_the_first_goes_on() {
    let mut bench = Bench::new();
    let first = bench.start(&["--clock", "lockstep"]);
    let features = bench.features();
    bench.ask(&features);
    let mut second = vpcd_in(&bench.place);
    second.args(["--clock", "lockstep"]);
    let (code, message) = ended(second);
    assert_eq!(code, 69, "{message}");
    let holder = first.id();
    assert!(
        message.contains(&format!("another vpcd is at work, process {holder};")),
        "{message}"
    );
    let features = bench.features();
    assert_eq!(bench.ask(&features).stamp.sequence, 2);
    drop(first);
}

#[test]
fn a_killed_daemon_is_replaced() {
    let mut bench = Bench::new();
    for round in 0..3 {
        let daemon = bench.start(&["--clock", "lockstep"]);
        for k in 1..=5 {
            let features = bench.features();
            // A new daemon counts its commands from 1; the first one may answer the features of the
            // round before.
            let answer = bench.ask(&features);
            assert!(answer.stamp.sequence >= k, "round {round}: {answer:?}");
        }
        drop(daemon);
    }
    while bench.observer.twist.oldest().unwrap().is_some() {}
}

#[test]
fn a_restarted_camera_is_a_new_run() {
    let place = Place::new();
    let scene = Scene::read(&scene_file()).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut command = vpcd_in(&place);
    command.args(["--clock", "lockstep"]);
    let daemon = Running::start(command);
    // Exposed when they are delivered.
    let features = Features::new(&square(&scene, &mut random), 0);
    let answers: Vec<_> = (0..3)
        .map(|_| {
            let domain = Domain::join(&place.domain()).unwrap();
            let mut camera = CameraPorts::open(&domain).unwrap();
            let sent = camera.features.publish(&features).unwrap();
            let answer = camera
                .wait_for_answer(&sent, PATIENCE)
                .unwrap()
                .expect("an answer");
            assert_eq!((sent.sequence, answer.features_sequence), (1, 1));
            assert!(matches!(answer.order, Order::First | Order::Gap { .. }));
            answer.twist
        })
        .collect();
    // The same features in a new run give the same twist: nothing of the run before is left.
    assert_eq!(answers[0], answers[1]);
    assert_eq!(answers[0], answers[2]);
    drop(daemon);
}
