//! Inputs nobody thought of, made by `proptest` and made smaller where one fails: files and
//! requests that were edited at random, stop files of any content, and sequences of anything that
//! the decision step can receive. Nothing panics; what is wrong is refused; and of the twist:
//!
//! - it never passes the limits, nor those of acceleration but to stop at once;
//! - while the controller is disarmed it is zero, whatever comes but an `arm`;
//! - a stop wins over every other request of its cycle;
//! - while the law is held it never grows, and after that as steeply as braking shrinks it.
//!
//! The cases are the same in each run. `VPC_LONG=1` makes 10^6 inputs of the decision step.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Stdio;

use controller::replay::replay;
use decision::{Answer, ControlStep, Decision, Input, Inputs, Rules};
use ipc::{Domain, STOP_FILE, StopFile};
use memory_blob::MemoryFile;
use messages::{Action, CycleRecord, Features, Hold, Request, RobotState, Stamp, TwistState};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use recording::Recording;
use rustix::process::Signal;
use scene::{Scene, SceneFiles};

use crate::camera::Camera;
use crate::fixture::{PERIOD_NS, Place, Running, eventually, memory_file, program, repeats};

const MS: u64 = 1_000_000;
/// Time in which a twist at the limits is braked to zero, and taken up from there, ns.
const BRAKE_NS: u64 = 150 * MS;
/// Most inputs of the decision step in one case.
const MOST: usize = 100;

/// Tries so many cases, the same ones in each run.
fn check<S: Strategy>(
    cases: usize,
    strategy: S,
    test: impl Fn(S::Value) -> Result<(), TestCaseError>,
) {
    let config = Config {
        cases: cases as u32,
        failure_persistence: None,
        ..Config::default()
    };
    let random = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let outcome = TestRunner::new_with_rng(config, random).run(&strategy, test);
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
}

/// A change of some bytes.
#[derive(Clone, Debug)]
enum Edit {
    Replace(Index, Vec<u8>),
    Remove(Index, u8),
    Repeat(Index, u8),
    Cut(Index),
}

/// What is odd in a file of text.
const WORDS: [&str; 14] = [
    "nan",
    "-inf",
    "1e400",
    "-1",
    "0",
    "[]",
    "{}",
    "\"\"",
    "99999999999999999999",
    "[[",
    "= =",
    "1e-320",
    "true",
    "\u{fffd}",
];

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let word = proptest::sample::select(&WORDS[..]).prop_map(|word| word.as_bytes().to_vec());
    let bytes = prop_oneof![word, proptest::collection::vec(any::<u8>(), 1..9)];
    let edit = prop_oneof![
        6 => (any::<Index>(), bytes).prop_map(|(at, bytes)| Edit::Replace(at, bytes)),
        2 => (any::<Index>(), any::<u8>()).prop_map(|(at, count)| Edit::Remove(at, count)),
        1 => (any::<Index>(), any::<u8>()).prop_map(|(at, count)| Edit::Repeat(at, count)),
        1 => any::<Index>().prop_map(Edit::Cut),
    ];
    proptest::collection::vec(edit, 1..4)
}

fn edited(mut bytes: Vec<u8>, edits: &[Edit]) -> Vec<u8> {
    for edit in edits {
        if bytes.is_empty() {
            break;
        }
        let length = bytes.len();
        let stretch = |at: &Index, count: u8| {
            let from = at.index(length);
            from..(from + usize::from(count)).min(length)
        };
        match edit {
            Edit::Replace(at, with) => {
                let range = stretch(at, with.len() as u8);
                bytes.splice(range, with.iter().copied());
            }
            Edit::Remove(at, count) => _ = bytes.drain(stretch(at, *count)),
            Edit::Repeat(at, count) => {
                let again = bytes[stretch(at, *count)].to_vec();
                bytes.splice(stretch(at, 0), again);
            }
            Edit::Cut(at) => bytes.truncate(at.index(length)),
        }
    }
    bytes
}

#[test]
fn edited_scenes_and_masks_are_read_or_refused_by_name() {
    let place = Place::new();
    let png = place.path("mask.png");
    scene::write_mask(&png, 1024, 1024, |u, v| {
        u.abs_diff(300) + v.abs_diff(300) < 100
    })
    .unwrap();
    let png = std::fs::read(png).unwrap();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let painted = format!("{head}[[occlusion]]\nname = \"a\"\nmask = \"mask.png\"\n");
    let cases = repeats("edited scenes", 200, 40_000);
    let which = proptest::bool::weighted(0.2);
    check(cases, (which, edits()), |(is_mask, edits)| {
        let (text, png) = match is_mask {
            true => (painted.clone().into_bytes(), edited(png.clone(), &edits)),
            false => (edited(scene::PAPER_SIM.into(), &edits), png.clone()),
        };
        let text = String::from_utf8_lossy(&text).into_owned();
        match SceneFiles::parse(text, "odd.toml", &|_| Ok(png.clone())) {
            // What is taken for a scene can be steered in.
            Ok(files) => {
                let _ = vpc::Law::new(&files.scene, vpc::Settings::default(), |len| vec![0.0; len]);
            }
            Err(error) => prop_assert!(error.to_string().contains("odd.toml"), "{}", error),
        }
        Ok(())
    });
}

#[test]
fn an_edited_memory_is_refused() {
    let place = Place::new();
    let good = std::fs::read(memory_file()).unwrap();
    let cases = repeats("edited memories", 100, 5_000);
    check(cases, edits(), |edits| {
        let bytes = edited(good.clone(), &edits);
        let file = place.file("m.vpcmem", &bytes);
        prop_assert_eq!(MemoryFile::open(&file, None).is_ok(), bytes == good);
        Ok(())
    });
}

/// A scene's controller in real time, with limits of acceleration (m/s^2, rad/s^2) or without.
fn control(acceleration: Option<[f64; 2]>) -> (ControlStep<'static>, Rules) {
    let mut text = scene::PAPER_SIM.to_owned();
    if let Some([linear, angular]) = acceleration {
        let limits =
            format!("[limits]\nlinear_acceleration = {linear}\nangular_acceleration = {angular}\n");
        text = text.replace("[limits]\n", &limits);
    }
    let scene = Scene::parse(&text, "sim").unwrap();
    let rules = Rules {
        limits: scene.limits.velocity(),
        change: (scene.limits.acceleration()).map(|a| a * scene.sampling_time()),
        valid_ns: Some(3 * PERIOD_NS),
        brake_ns: BRAKE_NS,
        ramp_ns: BRAKE_NS,
        lost_ns: Some(300 * MS),
        needs_robot: false,
        begins_armed: false,
        after_arrival: Default::default(),
    };
    let settings = vpc::Settings {
        foresight_steps: 5,
        ..vpc::Settings::default()
    };
    let control = ControlStep::new(&scene, settings, None, rules).unwrap();
    (control, rules)
}

#[test]
fn an_edited_recording_is_refused_or_replayed_to_its_end() {
    let place = Place::new();
    let text = "[cycle]\nclock = 'lockstep'\n[flight]\ndirectory = 'records'\nat_exit = true\n";
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let mut camera = Camera::new(&scene, &starts, &place.domain()).in_lockstep();
    let daemon = Running::start(place.vpcd(text));
    for _ in 0..100 {
        let sent = camera.show();
        let answer = camera.ports.wait_for_answer(&sent, testkit::PATIENCE);
        camera.obey(&answer.unwrap().expect("an answer"));
    }
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.ended().code, Some(0));
    let mut records = std::fs::read_dir(place.path("records")).unwrap();
    let record = records.next().unwrap().unwrap().path();
    let good = std::fs::read(&record).unwrap();
    let odd = place.path("odd.mcap");
    let cases = repeats("edited recordings", 60, 5_000);
    check(cases, edits(), |edits| {
        std::fs::write(&odd, edited(good.clone(), &edits)).unwrap();
        match Recording::read(&odd) {
            Ok(recording) => _ = replay(&mut control(None).0, &recording, None),
            Err(error) => prop_assert!(error.to_string().contains("odd.mcap"), "{}", error),
        }
        Ok(())
    });
}

#[test]
fn whatever_the_controller_did_not_write_last_is_a_stop() {
    let place = Place::new();
    let file = place.path(STOP_FILE);
    let cases = repeats("contents of the stop file", 500, 100_000);
    let content = || proptest::collection::vec(prop_oneof![Just(0), any::<u8>()], 0..100);
    // As C pads: what is missing is zero.
    let first = |bytes: &[u8]| {
        let mut asked = [0; 32];
        let count = bytes.len().min(32);
        asked[..count].copy_from_slice(&bytes[..count]);
        asked
    };
    check(
        cases,
        (content(), any::<bool>()),
        |(content, is_repeated)| {
            let mut stop = StopFile::open(&place.path("")).unwrap();
            prop_assert!(!stop.is_asked());
            for _ in 0..=usize::from(is_repeated) {
                std::fs::write(&file, &content).unwrap();
                prop_assert!(stop.is_asked());
                stop.obey();
                prop_assert!(!stop.is_asked());
                let there = std::fs::read(&file).unwrap();
                prop_assert_eq!(there, [first(&content), first(&content)].concat());
            }
            // While no controller runs, also with what it wrote last.
            drop(stop);
            let left = std::fs::read(&file).unwrap();
            std::fs::write(&file, left).unwrap();
            let mut stop = StopFile::open(&place.path("")).unwrap();
            prop_assert!(stop.is_asked());
            stop.obey();
            Ok(())
        },
    );
}

#[test]
fn the_page_survives_edited_requests() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut command = testkit::command(program("vpcctl"));
    command.arg("--domain").arg(place.domain());
    command.args(["serve", "--listen", "127.0.0.1:0", "--control"]);
    let mut page = Running::start(command.stdout(Stdio::piped()));
    let line = page.line("live view at");
    let (_, rest) = line.split_once("http://").unwrap();
    let (address, _) = rest.split_once('/').unwrap();
    let ask = |bytes: &[u8]| -> std::io::Result<String> {
        let mut stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(testkit::PATIENCE))?;
        stream.write_all(bytes)?;
        stream.shutdown(std::net::Shutdown::Write)?;
        let mut answer = Vec::new();
        // An event stream goes on for ever: its head is enough.
        let mut part = [0; 4096];
        let count = stream.read(&mut part)?;
        answer.extend_from_slice(&part[..count]);
        Ok(String::from_utf8_lossy(&answer).into_owned())
    };
    let get = format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n");
    let post = format!(
        "POST /stop HTTP/1.1\r\nHost: {address}\r\nX-Token: abc\r\nContent-Length: 2\r\n\r\n{{}}"
    );
    let events = format!("GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n");
    let request = proptest::sample::select(vec![get.clone(), post, events]);
    let cases = repeats("edited requests of the page", 200, 10_000);
    check(cases, (request, edits()), |(request, edits)| {
        let bytes = edited(request.into_bytes(), &edits);
        // Closed without a word, or an answer by the protocol.
        if let Ok(answer) = ask(&bytes) {
            prop_assert!(
                answer.is_empty() || answer.starts_with("HTTP/1.1 "),
                "{}",
                answer
            );
        }
        Ok(())
    });
    // The page notices by and by that the event streams are closed, whose number it limits.
    eventually("the page answers as before", || {
        let answer = ask(get.as_bytes()).ok()?;
        answer.starts_with("HTTP/1.1 200").then_some(())
    });
    drop(domain);
}

/// What comes to a cycle.
#[derive(Clone, Debug)]
struct Event {
    /// Time since the last one, ns; the clock may go back.
    step_ns: i64,
    features: Frame,
    /// Mode and faults, if the robot tells any.
    robot: Option<(u32, u32)>,
    /// Actions, each with a strategy.
    requests: Vec<(u32, u32)>,
    missed: u32,
    suspended: bool,
    shutdown: bool,
}

/// What the camera sends.
#[derive(Clone, Debug)]
enum Frame {
    /// The points moved by so much, px.
    Good(f64, f64),
    Nothing,
    Refused,
    Failed,
    Odd([f64; 8], u32, u64),
}

fn event() -> impl Strategy<Value = Event> {
    let step = prop_oneof![
        40 => Just(PERIOD_NS as i64),
        2 => 0..(4 * PERIOD_NS as i64),
        1 => Just(2000 * MS as i64),
        1 => Just(-(MS as i64)),
    ];
    let odd = prop_oneof![any::<f64>(), -2000.0..2000.0_f64];
    let frame = prop_oneof![
        30 => (-3.0..3.0_f64, -3.0..3.0_f64).prop_map(|(u, v)| Frame::Good(u, v)),
        2 => Just(Frame::Nothing),
        1 => Just(Frame::Refused),
        1 => Just(Frame::Failed),
        1 => (proptest::array::uniform8(odd), any::<u32>(), any::<u64>())
            .prop_map(|(points, visible, sequence)| Frame::Odd(points, visible, sequence)),
    ];
    let robot = prop_oneof![
        20 => Just(None),
        1 => (0..5_u32, 0..32_u32).prop_map(Some),
    ];
    let arm = (Just(Action::Arm.code()), Just(0));
    let request = prop_oneof![4 => arm, 1 => (0..8_u32, 0..7_u32)];
    let requests = prop_oneof![
        3 => Just(Vec::new()),
        1 => proptest::collection::vec(request, 1..4),
    ];
    let missed = prop_oneof![20 => Just(0), 1 => any::<u32>()];
    let (rare, rarer) = (
        proptest::bool::weighted(0.01),
        proptest::bool::weighted(0.002),
    );
    (step, frame, robot, requests, missed, rare, rarer).prop_map(
        |(step_ns, features, robot, requests, missed, suspended, shutdown)| Event {
            step_ns,
            features,
            robot,
            requests,
            missed,
            suspended,
            shutdown,
        },
    )
}

/// A camera, a robot and operators that do as the events say.
struct World {
    now_ns: u64,
    sequence: u64,
    points: [[f64; 2]; 4],
}

impl World {
    fn inputs(&mut self, event: &Event) -> Inputs {
        self.now_ns = self.now_ns.wrapping_add_signed(event.step_ns);
        let now_ns = self.now_ns;
        self.sequence += 1;
        let stamp = Stamp {
            sequence: self.sequence,
            published_ns: now_ns - MS,
            data_ns: now_ns - 20 * MS,
        };
        let mut message = Features::new(&self.points, 0);
        message.stamp = stamp;
        let features = match &event.features {
            Frame::Good(u, v) => {
                self.points = self.points.map(|[x, y]| [x + u, y + v]);
                message.points[..8].copy_from_slice(self.points.as_flattened());
                Input::Message(message)
            }
            Frame::Nothing => Input::Nothing,
            Frame::Refused => Input::Refused(stamp),
            Frame::Failed => Input::Failed,
            Frame::Odd(points, visible, sequence) => {
                message.points[..8].copy_from_slice(points);
                (message.visible, message.stamp.sequence) = (*visible, *sequence);
                Input::Message(message)
            }
        };
        let robot = event.robot.map_or(Input::Nothing, |(mode, faults)| {
            let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns);
            state.stamp = stamp;
            (state.mode, state.faults) = (mode, faults);
            Input::Message(state)
        });
        Inputs {
            now_ns,
            features,
            robot,
            desired: Input::Nothing,
            missed: event.missed,
            suspended: event.suspended,
            shutdown: event.shutdown,
        }
    }
}

/// The largest component of a twist as a share of its limit.
fn share(decision: &Decision, rules: &Rules) -> f64 {
    let shares = decision.twist.iter().zip(rules.limits);
    // A NaN is infinite.
    shares.fold(0.0, |most: f64, (v, limit)| match v.abs() / limit {
        share if share.is_nan() => f64::INFINITY,
        share => most.max(share),
    })
}

/// What must hold from one decision to the next.
fn judge(
    rules: &Rules,
    event: &Event,
    before: &Decision,
    after: &Decision,
) -> Result<(), TestCaseError> {
    const ROUNDING: f64 = 1e-9;
    let (was, is) = (share(before, rules), share(after, rules));
    prop_assert!(is <= 1.0 + ROUNDING, "beyond the limits: {:?}", after);
    let asks = |action: Action| {
        event
            .requests
            .iter()
            .any(|(code, _)| *code == action.code())
    };
    if asks(Action::Stop) {
        prop_assert_eq!(after.twist, [0.0; 6], "a stop did not win");
    }
    if before.state == TwistState::Disarmed && !asks(Action::Arm) {
        prop_assert_eq!((after.state, after.twist), (TwistState::Disarmed, [0.0; 6]));
    }
    if after.hold.is_some() {
        prop_assert!(is <= was + ROUNDING, "it grows while held: {:?}", after);
    }
    let has_acceleration = rules.change[0].is_finite();
    if before.hold.is_some() && after.hold.is_none() && !has_acceleration {
        let step = event.step_ns.max(0) as f64 / BRAKE_NS as f64;
        prop_assert!(
            is <= was + step + ROUNDING,
            "{} after {}: {:?}",
            is,
            was,
            after
        );
    }
    if after.twist != [0.0; 6] {
        let changes = std::iter::zip(after.twist, before.twist).zip(rules.change);
        for ((after, before), most) in changes {
            prop_assert!(
                (after - before).abs() <= most * (1.0 + ROUNDING),
                "{after} {before}"
            );
        }
    }
    Ok(())
}

#[test]
fn no_sequence_of_inputs_breaks_what_holds_of_the_twist() {
    let inputs = repeats("inputs of the decision step", 10_000, 1_000_000);
    let events = proptest::collection::vec(event(), 1..MOST);
    let begin = [
        [250.0, 250.0],
        [420.0, 260.0],
        [410.0, 430.0],
        [240.0, 420.0],
    ];
    check(
        2 * inputs / MOST,
        (any::<bool>(), events),
        |(is_limited, events)| {
            let (mut control, rules) = control(is_limited.then_some([2.0, 4.0]));
            let mut world = World {
                now_ns: 1 << 40,
                sequence: 0,
                points: begin,
            };
            let mut before = Decision::still(Hold::NotArmed, TwistState::Disarmed);
            for (cycle, event) in events.iter().enumerate() {
                for (action, strategy) in &event.requests {
                    let mut request = Request::new(cycle as u64 + 1, Action::Status);
                    (request.action, request.strategy) = (*action, *strategy);
                    control.request(&request, cycle as u64);
                }
                let inputs = world.inputs(event);
                let Answer { decision, .. } = control.decide(&inputs, &mut CycleRecord::default());
                control.think();
                judge(&rules, event, &before, &decision)?;
                before = decision;
            }
            Ok(())
        },
    );
}
