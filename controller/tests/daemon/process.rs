//! The whole daemon as its peers see it, in lockstep: nothing depends on how late a machine is.
//! Silence, robots and clocks are for the target `simulation` of `system-tests`.

use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain, Observer, OperatorPorts};
use messages::{
    Action, CycleRecord, Features, Hold, Order, Outcome, Reply, Request, StrategyCode,
    TwistCommand, TwistState,
};
use rustix::process::Signal;
use scene::Scene;

use crate::fixture::{Place, Running, ended, eventually, scene_file, vpcd_in};

/// A camera that carries out what it is told, and who watches the daemon.
struct Bench {
    scene: Scene,
    camera: FreeCamera,
    ports: CameraPorts,
    observer: Observer,
    // Last: it clears away what is left of the domain.
    place: Place,
}

impl Bench {
    fn new() -> Self {
        let place = Place::new();
        let domain = Domain::join(&place.domain()).unwrap();
        let scene = Scene::read(&scene_file()).unwrap();
        let start = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap()[0];
        Self {
            camera: FreeCamera::new(&scene, &start),
            ports: CameraPorts::open(&domain).unwrap(),
            observer: Observer::open(&domain).unwrap(),
            scene,
            place,
        }
    }

    fn start(&self, arguments: &[&str]) -> Running {
        let mut command = vpcd_in(&self.place);
        command.args(["--clock", "lockstep"]).args(arguments);
        Running::start(command)
    }

    /// What the camera sees.
    fn features(&self) -> Features {
        Features::new(&self.camera.features().unwrap(), ipc::now_ns())
    }

    fn ask(&mut self, features: &Features) -> TwistCommand {
        let sent = self.ports.features.publish(features).unwrap();
        let answer = self
            .ports
            .wait_for_answer(&sent, testkit::PATIENCE)
            .unwrap();
        answer.expect("an answer in time").message
    }

    /// A frame: shows what the camera sees, and moves it by the answer.
    fn frame(&mut self) -> TwistCommand {
        let features = self.features();
        let answer = self.ask(&features);
        self.camera
            .advance(&answer.twist, self.scene.sampling_time());
        answer
    }

    /// A frame that moves the camera, within the limits.
    fn moves(&mut self) -> TwistCommand {
        let answer = self.frame();
        assert_eq!(answer.state(), Some(TwistState::Moving), "{answer:?}");
        let limits = self.scene.limits.velocity();
        let mut pairs = answer.twist.iter().zip(limits);
        assert!(pairs.all(|(v, limit)| v.abs() <= limit * 1.000_001));
        assert_ne!(answer.twist, [0.0; 6]);
        answer
    }

    /// Connects to the daemon, which is at work: what it says later is then kept, even after its
    /// end.
    fn attach(&mut self) {
        self.observer.twist.refresh().unwrap();
        self.observer.cycles.refresh().unwrap();
    }

    /// The record of the next cycle.
    fn record(&mut self) -> CycleRecord {
        let record = eventually("a record", || self.observer.cycles.oldest().unwrap());
        record.message
    }

    fn last_command(&mut self) -> TwistCommand {
        let newest = self.observer.twist.latest().unwrap();
        newest.expect("a command").message
    }
}

#[test]
fn lockstep_answers_each_message_exactly_once() {
    let mut bench = Bench::new();
    let daemon = bench.start(&["--strategy", "previous", "--cycles", "50"]);
    for k in 1..=50 {
        let answer = bench.moves();
        assert_eq!((answer.features_sequence, answer.stamp.sequence), (k, k));
        bench.attach();
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
    for k in 1..=50 {
        let record = bench.record();
        assert_eq!(
            (record.cycle, record.features_sequence, record.count),
            (k, k, 4)
        );
        assert!(record.error_px > 0.0 && record.step_ns > 0 && record.hold().is_none());
        assert_ne!(record.twist, [0.0; 6]);
    }
    assert_eq!(bench.observer.cycles.oldest().unwrap(), None);
}

#[test]
fn bad_features_are_answered_with_zero_and_good_ones_go_on() {
    let mut bench = Bench::new();
    let daemon = bench.start(&["--strategy", "previous"]);
    let mut nan = bench.features();
    nan.points[2] = f64::NAN;
    let mut hidden = bench.features();
    hidden.visible = 0b0001;
    let mut off = bench.features();
    off.points[0] = -500.0;
    let corner = [100.0, 100.0];
    let bad = [
        // Before any image showed all points, nothing carries it on.
        (hidden, Hold::Hidden),
        (nan, Hold::Invalid),
        (off, Hold::OffImage),
        (Features::new(&[corner; 3], ipc::now_ns()), Hold::Count),
        (Features::new(&[corner; 9], ipc::now_ns()), Hold::Invalid),
    ];
    for (bad, cause) in bad {
        let answer = bench.ask(&bad);
        assert_eq!(
            (answer.state(), answer.twist),
            (Some(TwistState::Holding), [0.0; 6]),
            "{cause}"
        );
        assert_eq!(bench.record().hold(), Some(cause));
        bench.moves();
        assert_eq!(bench.record().hold(), None);
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
fn an_operator_arms_changes_the_strategy_disarms_and_stops() {
    use TwistState::Disarmed;
    let mut bench = Bench::new();
    let config = bench.place.file("vpcd.toml", "[safety]\narmed = false\n");
    let mut command = crate::fixture::vpcd();
    command.arg("--config").arg(config);
    command.arg("--scene").arg(scene_file());
    command.arg("--domain").arg(bench.place.domain());
    command.args(["--clock", "lockstep", "--strategy", "previous"]);
    command.stderr(std::process::Stdio::piped());
    let daemon = Running::start(command);
    let domain = Domain::join(&bench.place.domain()).unwrap();
    let mut operator = OperatorPorts::open(&domain).unwrap();
    let mut asked = 0;
    let mut ask = |request: &dyn Fn(u64) -> Request| -> (Outcome, Reply) {
        loop {
            asked += 1;
            let reply = operator.ask(&request(asked), testkit::PATIENCE).unwrap();
            let reply = reply.expect("a reply in time");
            // A daemon that did not get a processor in time refuses what moves: asked again.
            if reply.outcome() != Some(Outcome::Late) {
                return (reply.outcome().unwrap(), reply);
            }
        }
    };
    let arm = |id| Request::new(id, Action::Arm);
    let stands = |answer: TwistCommand| {
        assert_eq!((answer.state(), answer.twist), (Some(Disarmed), [0.0; 6]));
    };
    let mut hidden = bench.features();
    hidden.visible = 0b0001;
    stands(bench.ask(&hidden));
    let (outcome, reply) = ask(&arm);
    assert_eq!(
        (outcome, reply.state()),
        (Outcome::NoFeatures, Some(Disarmed))
    );
    stands(bench.frame());
    assert_eq!(ask(&arm).0, Outcome::Done);
    bench.moves();
    let (outcome, reply) = ask(&|id| Request::strategy(id, StrategyCode::Gpr, 0));
    assert_eq!(outcome, Outcome::NoMemory);
    assert_eq!(reply.strategy, StrategyCode::Previous.code());
    let knn = ask(&|id| Request::strategy(id, StrategyCode::Knn, 65));
    assert_eq!(knn.0, Outcome::Neighbours);
    let (outcome, reply) = ask(&|id| Request::strategy(id, StrategyCode::Ibvs, 0));
    assert_eq!(outcome, Outcome::Done);
    assert_eq!(reply.strategy, StrategyCode::Ibvs.code());
    // What the contract does not know moves nothing, and is answered.
    let (outcome, reply) = ask(&|id| Request {
        action: 99,
        ..Request::new(id, Action::Status)
    });
    assert_eq!(outcome, Outcome::Unknown);
    assert_eq!(reply.action, Action::Status.code());
    let (outcome, reply) = ask(&|id| Request {
        strategy: 77,
        ..Request::new(id, Action::Strategy)
    });
    assert_eq!(outcome, Outcome::Unknown);
    assert_eq!(reply.strategy, StrategyCode::Ibvs.code());
    bench.moves();
    assert_eq!(ask(&|id| Request::new(id, Action::Disarm)).0, Outcome::Done);
    stands(bench.frame());
    // Who arms after a disarm or a stop names it.
    let (outcome, reply) = ask(&arm);
    assert_eq!(outcome, Outcome::Vetoed);
    let veto = reply.veto;
    assert_eq!(ask(&|id| Request::arm(id, veto)).0, Outcome::Done);
    bench.moves();
    let (outcome, reply) = ask(&|id| Request::new(id, Action::Stop));
    assert_eq!((outcome, reply.state()), (Outcome::Done, Some(Disarmed)));
    stands(bench.frame());
    let veto = reply.veto;
    assert_eq!(ask(&arm).0, Outcome::Vetoed);
    stands(bench.frame());
    assert_eq!(ask(&|id| Request::arm(id, veto)).0, Outcome::Done);
    bench.moves();
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

/// On the real clock, which nothing here depends on.
#[test]
fn before_any_camera_the_twist_is_zero_and_sigterm_ends_it() {
    let mut bench = Bench::new();
    let daemon = Running::start(vpcd_in(&bench.place));
    let first = eventually("a command", || bench.ports.twist.latest().unwrap());
    assert_eq!((first.features_sequence, first.twist), (0, [0.0; 6]));
    bench.attach();
    let (code, log) = daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let last = bench.last_command();
    assert_eq!(
        (last.state(), last.twist),
        (Some(TwistState::Stopped), [0.0; 6])
    );
}

#[test]
fn a_second_daemon_is_69_and_names_the_first_which_goes_on() {
    let mut bench = Bench::new();
    let first = bench.start(&[]);
    bench.frame();
    let domain = bench.place.domain().canonicalize().unwrap();
    let words = format!(
        "domain {}: another vpcd is at work, process {};",
        domain.display(),
        first.id()
    );
    // Also one that is stopped.
    for signal in [Signal::CONT, Signal::STOP] {
        first.signal(signal);
        let (code, message) = ended(vpcd_in(&bench.place));
        assert_eq!(code, 69, "{message}");
        assert!(message.contains(&words), "{message}\nlacks {words}");
    }
    first.signal(Signal::CONT);
    assert_eq!(bench.frame().stamp.sequence, 2);
    assert_eq!(first.terminated().code, Some(0));
}

#[test]
fn a_killed_daemon_is_replaced() {
    let mut bench = Bench::new();
    for round in 0..3 {
        let daemon = bench.start(&[]);
        for k in 1..=3 {
            // A new daemon counts its commands from 1; the first one may answer the features of the
            // round before.
            let answer = bench.frame();
            assert!(answer.stamp.sequence >= k, "round {round}: {answer:?}");
        }
        daemon.kill();
    }
    while bench.observer.twist.oldest().unwrap().is_some() {}
}

#[test]
fn a_restarted_camera_is_a_new_run() {
    let bench = Bench::new();
    let place = &bench.place;
    let daemon = bench.start(&[]);
    // Exposed when they are delivered.
    let features = Features::new(&bench.camera.features().unwrap(), 0);
    drop(bench.ports);
    let answers: Vec<_> = (0..3)
        .map(|_| {
            let domain = Domain::join(&place.domain()).unwrap();
            let mut camera = CameraPorts::open(&domain).unwrap();
            let sent = camera.features.publish(&features).unwrap();
            let answer = camera
                .wait_for_answer(&sent, testkit::PATIENCE)
                .unwrap()
                .expect("an answer");
            assert_eq!((sent.sequence, answer.features_sequence), (1, 1));
            assert!(matches!(answer.order, Order::First | Order::Gap { .. }));
            answer.twist
        })
        .collect();
    // The same features in a new run give the same twist: nothing of the run before is left.
    assert_ne!(answers[0], [0.0; 6]);
    assert_eq!(answers[0], answers[1]);
    assert_eq!(answers[0], answers[2]);
    assert_eq!(daemon.terminated().code, Some(0));
}
