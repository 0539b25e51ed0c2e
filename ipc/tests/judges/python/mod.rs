//! The client in Python (`ipc/clients/python`) against this crate: the same layouts, the same
//! guard, real messages both ways, its camera driven to the goal, its logger's tables, its package
//! installed. Needs Python 3.11 and, the first time, the network.

mod bridge;
mod cameras;
mod policy;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::mem::offset_of;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ipc::{CameraPorts, ControllerPorts, Domain, Observer, RecorderPort};
use messages::{
    Action, CycleRecord, Encoding, Features, Hold, ImageHeader, Meaning, Outcome, Payload, Qos,
    Reply, RobotMode, RobotState, Stamp, StrategyCode, Struct, TwistCommand, TwistState,
};

use testkit::python::{Environment, run};
use testkit::{Ended, Place, Running, eventually};

/// Steps in which the camera is driven to its goal.
const STEPS: u32 = 30;

fn sources(within: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(within)
}

/// A script of the tree, ready to run.
fn script(python: &Path, within: &str) -> Command {
    testkit::python::script(python, &sources(within))
}

/// A script of the tree that finds the stand-ins for libraries.
fn with_stand_ins(python: &Path, within: &str) -> Command {
    let mut command = script(python, within);
    let paths = [
        sources("clients/python"),
        sources("tests/judges/python/stand_ins"),
    ];
    command.env("PYTHONPATH", std::env::join_paths(paths).unwrap());
    command
}

/// Lines for the layout of a message and of its fields, as peer.py has them.
fn layout(lines: &mut String, message: &Struct) {
    let Struct { name, size, .. } = message;
    // Every message has a field of eight bytes.
    let _ = writeln!(lines, "{name} {size} 8");
    for field in message.fields {
        let (field, offset, size) = (field.name, field.offset, field.size);
        let _ = writeln!(lines, "{name}.{field} {offset} {size}");
    }
}

fn layouts_agree(python: &Path) {
    let theirs = run(script(python, "tests/judges/python/peer.py").arg("layout")).unwrap();
    let mut ours = String::new();
    for service in messages::SERVICES {
        let Qos {
            history,
            buffer,
            subscribers,
            publishers,
        } = service.qos;
        let (name, type_name) = (service.name, service.message.type_name);
        let borrowed = service.payload.borrowed();
        let alignment = match service.payload {
            Payload::Message => "None".to_owned(),
            Payload::Bytes { alignment } => alignment.to_string(),
        };
        let _ = writeln!(
            ours,
            "{name} {type_name} {history} {buffer} {subscribers} {publishers} {borrowed} {alignment}"
        );
    }
    layout(&mut ours, &Struct::of::<Stamp>());
    for service in messages::SERVICES {
        layout(&mut ours, &service.message);
    }
    for (theirs, ours) in theirs.lines().zip(ours.lines()) {
        assert_eq!(theirs, ours, "Python first, then Rust");
    }
    assert_eq!(theirs.lines().count(), ours.lines().count());
}

/// The numbers of a printed line that begins with `head`.
fn numbers(text: &str, head: &str) -> Vec<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix(head));
    line.unwrap_or_else(|| panic!("no line `{head}` in: {text}"))
        .split_whitespace()
        .map(|word| word.parse().unwrap())
        .collect()
}

/// The dead man says the same in both languages, and Python stops.
fn safety_agrees(python: &Path) {
    const SENT: u64 = 5_000_000_000;
    let cases = [
        (SENT + 10, SENT + 9),
        (SENT + 10, SENT + 10),
        (SENT + 33_000_000_000, SENT + 99_999_999),
        (SENT + 33_000_000_000, SENT + 100_000_000),
        (SENT + 33_000_000_000, SENT - 1_000_000),
        (SENT + 33_000_000_000, SENT - 1_000_001),
        (u64::MAX, SENT),
    ];
    let mut words = Vec::new();
    let expected: Vec<_> = cases
        .iter()
        .map(|&(valid_until_ns, now_ns)| {
            let mut command = messages::TwistCommand::zero(messages::TwistState::Moving);
            command.stamp.published_ns = SENT;
            (command.valid_until_ns, command.twist) = (valid_until_ns, [0.5; 6]);
            words.push(format!("{SENT},{valid_until_ns},{now_ns}"));
            command.in_force(now_ns)[5]
        })
        .collect();
    assert!(expected.contains(&0.5) && expected.contains(&0.0));
    let place = Place::new();
    std::fs::create_dir(place.domain()).unwrap();
    let mut stop_file = ipc::StopFile::open(&place.domain()).unwrap();
    let mut peer = script(python, "tests/judges/python/peer.py");
    peer.arg("safety").arg(place.domain()).args(words);
    let peer = Running::start(peer.stdout(Stdio::piped()));
    eventually("a stop from Python", || stop_file.is_asked().then_some(()));
    stop_file.obey();
    let ended = peer.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert_eq!(numbers(&ended.stdout, "in force"), expected);
    assert!(numbers(&ended.stdout, "stopped after")[0] < 10.0);
}

fn messages_go_both_ways(python: &Path) {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut recorder = RecorderPort::open(&domain).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let begun = ipc::now_ns();
    let mut peer = script(python, "tests/judges/python/peer.py");
    peer.arg("exchange").arg(place.domain());
    let peer = Running::start(peer.stdout(Stdio::piped()));

    let features = eventually("features from Python", || {
        controller.features.latest().unwrap()
    });
    let expected = [
        [0.1, 2.25],
        [640.5, -3.75],
        [1e-3, 4.0],
        [5.0, 6.0],
        [7.0, 1.0 / 3.0],
    ];
    assert!(features.pairs().eq(expected), "{features:?}");
    let stamp = features.stamp;
    assert_eq!(
        (stamp.sequence, stamp.data_ns, features.visible),
        (1, 123_456_789, 0b10111)
    );
    assert_eq!(features.exposure_ns, 4_000_000);
    // One clock for both languages.
    assert!((begun..=ipc::now_ns()).contains(&stamp.published_ns));

    let state = eventually("a state from Python", || observer.robot.oldest().unwrap());
    assert_eq!((state.stamp.data_ns, state.features_sequence), (77, 5));
    assert_eq!(
        (state.mode, state.faults, state.joints),
        (RobotMode::Moving.code(), 2, 7)
    );
    let counted = |offset: usize, numbers: &[f64]| {
        let mut counted = numbers.iter().enumerate();
        counted.all(|(i, x)| *x == offset as f64 + i as f64 / 8.0)
    };
    assert!(counted(
        offset_of!(RobotState, translation),
        &state.translation
    ));
    assert!(counted(offset_of!(RobotState, rotation), &state.rotation));
    assert!(counted(offset_of!(RobotState, twist), &state.twist));
    assert!(counted(offset_of!(RobotState, q), &state.q));
    assert!(counted(offset_of!(RobotState, dq), &state.dq));
    assert!(counted(
        offset_of!(RobotState, commands_in_time),
        &[state.commands_in_time]
    ));

    let twist = [0.1, -0.2, 1.0 / 3.0, 1e-9, -0.5, f64::MIN_POSITIVE];
    // An answer to something else first: the client must pass over it.
    let other = Stamp {
        published_ns: stamp.published_ns - 1,
        ..stamp
    };
    let wrong = TwistCommand::answer_to(&other, [9.0; 6], TwistState::Holding);
    controller.twist.publish(&wrong).unwrap();
    let answer = TwistCommand::answer(&features, twist, TwistState::Arrived);
    controller.twist.publish(&answer).unwrap();
    let record = CycleRecord {
        cycle: 1 << 52,
        lost_records: 3,
        np: 30,
        state: TwistState::Moving.code(),
        points: std::array::from_fn(|i| i as f64 / 7.0),
        way_point: std::array::from_fn(|i| 500.0 + i as f64),
        twist,
        cost: 1234.5,
        violation_px: -0.25,
        clearance_px: 1e300,
        error_px: 1e-300,
        ..CycleRecord::default()
    };
    recorder.cycles.publish(&record).unwrap();

    let request = eventually("a request from Python", || {
        controller.requests.oldest().unwrap()
    });
    assert_eq!(request.action(), Some(Action::Strategy));
    let knn = StrategyCode::Knn.code();
    assert_eq!((request.strategy, request.neighbours), (knn, 5));
    // To somebody else first: it must be passed over.
    let reply = Reply {
        stamp: Stamp::default(),
        id: !request.id,
        cycle: 0,
        action: request.action,
        outcome: Outcome::Done.code(),
        state: TwistState::Moving.code(),
        hold: Hold::number(None),
        strategy: StrategyCode::Gpr.code(),
        neighbours: 0,
        ..Reply::default()
    };
    controller.replies.publish(&reply).unwrap();
    let mut reply = Reply {
        id: request.id,
        cycle: 0,
        outcome: Outcome::NoMemory.code(),
        ..reply
    };
    reply.stamp.data_ns = 99;
    controller.replies.publish(&reply).unwrap();
    let request = eventually("an arm from Python", || {
        controller.requests.oldest().unwrap()
    });
    assert_eq!((request.action(), request.veto), (Some(Action::Arm), 7));
    let armed = Reply {
        id: request.id,
        action: request.action,
        outcome: Outcome::Done.code(),
        veto: 7,
        ..reply
    };
    controller.replies.publish(&armed).unwrap();

    let Ended {
        code, stdout: text, ..
    } = peer.ended();
    assert_eq!(code, Some(0), "{text}");
    let arrived = f64::from(TwistState::Arrived.code());
    assert_eq!(numbers(&text, "twist"), [&[arrived][..], &twist].concat());
    let moving = f64::from(TwistState::Moving.code());
    let numbers_of_record = [
        &[(1u64 << 52) as f64, 3.0, 30.0, moving][..],
        &record.points,
        &record.way_point,
        &twist,
        &[1234.5, -0.25, 1e300, 1e-300],
    ];
    assert_eq!(numbers(&text, "cycle"), numbers_of_record.concat());
    let refusal = "refused strategy: refused: no memory of motion for this strategy (moving, none)";
    assert!(text.lines().any(|line| line == refusal), "{text}");
    assert_eq!(
        numbers(&text, "reply"),
        [99.0, 4.0, 4.0, 1.0, 0.0, 2.0, 0.0]
    );
}

/// Drives the camera of camera.py from a start (object in the camera frame, m and rotation vector
/// in rad) by one twist, held for a second; returns what it says, and the first point at each step,
/// px.
fn driven(python: &Path, start: [f64; 6], twist: [f64; 6]) -> (String, Vec<[f64; 2]>) {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut camera = script(python, "clients/python/camera.py");
    camera
        .arg("--scene")
        .arg(sources("scene/scenes/paper-sim.toml"));
    camera.arg("--domain").arg(place.domain());
    // One more than are needed: with a wrong twist it says so instead of waiting for an answer for
    // ever.
    camera.args(["--steps", &(STEPS + 1).to_string(), "--start"]);
    camera.args(start.map(|x| x.to_string()));
    let mut camera = Running::start(camera.stdout(Stdio::piped()));
    let mut seen = Vec::new();
    while camera.is_running() {
        if let Some(features) = controller.features.latest().unwrap() {
            seen.extend(features.pairs().next());
            let answer = TwistCommand::answer(&features, twist, TwistState::Moving);
            controller.twist.publish(&answer).unwrap();
        }
        std::thread::sleep(std::time::Duration::from_micros(100));
    }
    (camera.ended().stdout, seen)
}

fn the_camera_can_be_driven(python: &Path) {
    let arrives = format!("{STEPS} steps, final error 0.0");
    // Straight to the goal, which is at 0.6 m: the first point of the pattern is at (-0.15, -0.15)
    // m.
    let (text, seen) = driven(
        python,
        [0.2, 0.0, 0.7, 0.0, 0.0, 0.0],
        [0.2, 0.0, 0.1, 0.0, 0.0, 0.0],
    );
    assert!(text.starts_with(&arrives), "{text}");
    assert_eq!(seen.len(), STEPS as usize);
    for (k, point) in seen.iter().enumerate() {
        let left = 1.0 - k as f64 / f64::from(STEPS);
        let depth = 0.6 + 0.1 * left;
        let expected = [
            512.0 + 800.0 * (0.2 * left - 0.15) / depth,
            512.0 - 800.0 * 0.15 / depth,
        ];
        let off = (point[0] - expected[0]).hypot(point[1] - expected[1]);
        assert!(off < 1e-9, "step {k}: {point:?}, {expected:?}");
    }
    // Rolling on the way.
    let (text, _) = driven(
        python,
        [0.0, 0.0, 0.7, 0.0, 0.0, 0.5],
        [0.0, 0.0, 0.1, 0.0, 0.0, 0.5],
    );
    assert!(text.starts_with(&arrives), "{text}");
}

/// What is refused, and in which words; every port is free again after the end of its `with`.
fn refusals_have_words(python: &Path) {
    let place = Place::new();
    let mut peer = script(python, "tests/judges/python/peer.py");
    let said = run(peer.arg("refusals").arg(place.domain())).unwrap();
    let lines: Vec<&str> = said.lines().collect();
    let pairs = "allowed: pairs (u, v) of numbers, shape (N, 2)";
    let expected = [
        "vpc/features: count = 0; allowed: 1 to 8",
        "vpc/features: points[1] = nan; allowed: finite numbers",
        &format!("vpc/features: points of shape (8,); {pairs}"),
        &format!("vpc/features: points of shape (4, 1, 2); {pairs}"),
        "data_ns = -1; allowed: 0 to",
        "taken: vpc/features: another publisher is at work in domain",
        "vpc/twist: no answer to features 1 within 0.01 s; does vpcd run",
        "service vpc/nothing; allowed: vpc/features, vpc/twist,",
        "vpc/twist: buffer = 65; allowed: 1 to 64",
        &format!(
            "domain {}: no controller; start vpcd",
            place.domain().display()
        ),
        "vpc/features: this port was closed",
        "domain '/dev/null': [Errno 17] File exists",
    ];
    assert_eq!(lines.len(), expected.len(), "{said}");
    for (line, expected) in lines.iter().zip(expected) {
        assert!(line.starts_with(expected), "{line}, not {expected}");
    }
    assert_eq!(Domain::segments(&place.domain()).unwrap(), 0);
}

/// Each code of each field is taken, and each other number refused.
fn codes_agree(python: &Path) {
    let theirs = run(script(python, "tests/judges/python/peer.py").arg("codes")).unwrap();
    let theirs: BTreeSet<&str> = theirs.lines().collect();
    let fields = messages::SERVICES.iter().flat_map(|service| {
        let Struct { name, fields, .. } = service.message;
        fields.iter().map(move |field| (name, field))
    });
    let ours: BTreeSet<String> = fields
        .filter_map(|(message, field)| {
            let (Meaning::Code(table) | Meaning::AnyCode(table)) = field.meaning else {
                return None;
            };
            let taken = table.names.iter().map(|code| format!(" {}", code.number));
            Some(format!(
                "{message}.{}{}",
                field.name,
                taken.collect::<String>()
            ))
        })
        .collect();
    assert!(ours.len() > 20, "{ours:?}");
    assert_eq!(theirs, ours.iter().map(String::as_str).collect());
}

fn bad_messages_are_refused(python: &Path) {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut peer = script(python, "tests/judges/python/peer.py");
    peer.arg("hears").arg(place.domain());
    let mut peer = Running::start(peer.stdout(Stdio::piped()));
    peer.line("listening");
    let mut twist = TwistCommand::zero(TwistState::Moving);
    twist.twist[3] = f64::INFINITY;
    controller.twist.publish(&twist).unwrap();
    twist.twist[3] = 0.0;
    twist.state = 77;
    controller.twist.publish(&twist).unwrap();
    twist.state = TwistState::Moving.code();
    controller.twist.publish(&twist).unwrap();
    let Ended { code, stdout, .. } = peer.ended();
    let expected = [
        "listening",
        "vpc/twist: twist[3] = inf; allowed: finite numbers",
        "vpc/twist: state = 77; allowed: 0 stopped, 1 moving, 2 arrived, 3 holding, 4 braking, 5 disarmed",
        "good 3",
    ];
    assert_eq!(stdout.lines().collect::<Vec<_>>(), expected);
    assert_eq!(code, Some(0));
}

/// Images both ways: what Python fills in is what Rust sees, and the other way round.
fn images_go_both_ways(python: &Path) {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut subscriber = domain.image_subscriber().unwrap();
    let mut peer = script(python, "tests/judges/python/peer.py");
    peer.arg("images").arg(place.domain());
    let mut peer = Running::start(peer.stdout(Stdio::piped()));
    let mut next = || eventually("an image", || subscriber.latest().unwrap());
    let loaned = next();
    assert_eq!(loaned.header().exposure_begin_ns, 1_000);
    assert_eq!(loaned.header().stamp.data_ns, 1_005);
    assert_eq!(loaned.header().encoding(), Some(Encoding::Rgb8));
    let expected: Vec<u8> = (0..24).collect();
    assert!(loaned.rows().eq(expected.chunks(12)));
    // The sign to go on.
    controller
        .twist
        .publish(&TwistCommand::zero(TwistState::Moving))
        .unwrap();
    let copied = next();
    let ImageHeader {
        stamp,
        width,
        height,
        ..
    } = *copied.header();
    assert_eq!((stamp.sequence, stamp.data_ns), (3, 5));
    assert_eq!((width, height, &copied[..]), (6, 3, &[7; 18][..]));

    peer.line("watching");
    let mut publisher = domain.image_publisher(64).unwrap();
    let mut send = |encoding: Encoding, grey: u8, stride, code| {
        let mut header = ImageHeader::new(5, 3, encoding, ipc::now_ns());
        header.stride = stride;
        let mut image = publisher.loan(&header).unwrap();
        image.fill(200);
        for row in image.chunks_mut(stride as usize) {
            row[..5 * encoding.bytes_per_pixel()].fill(grey);
        }
        image.header_mut().encoding = code;
        publisher.publish(image).unwrap();
    };
    let (mono, rgb) = (Encoding::Mono8, Encoding::Rgb8);
    send(mono, 3, 8, mono.code());
    peer.line("image (3, 5) (8, 1) 45");
    send(mono, 3, 8, 9);
    peer.line("refused vpc/image: encoding = 9; allowed: 0 mono8, 1 bgr8, 2 rgb8, 3 yuyv");
    send(rgb, 2, 20, rgb.code());
    peer.line("image (3, 5, 3) (20, 3, 1) 90");
    send(Encoding::Yuyv, 4, 10, Encoding::Yuyv.code());
    peer.line("image (3, 5, 2) (10, 2, 1) 120");
    send(mono, 65, 5, mono.code());
    peer.line("refused vpc/image: no image can be received");
    let Ended { code, stdout, .. } = peer.ended();
    assert_eq!(code, Some(0), "{stdout}");
    let said: Vec<&str> = stdout.lines().collect();
    let expected = [
        "refused vpc/image: no memory for an image",
        "refused vpc/image: data_ns = 990; allowed: 1000 to 1010",
        "sent 1 ",
        "refused vpc/image: this image was sent",
        "refused vpc/image: float64 of shape (3, 3); allowed: uint8, shape (height, width),",
        "refused vpc/image: uint8 of shape (9,); allowed: uint8",
        "refused vpc/image: uint8 of shape (3, 3, 4); allowed: uint8",
        "refused vpc/image: list of shape (); allowed: uint8",
        "refused vpc/image: an image of 37 bytes; allowed: 36, for which the port was opened",
        "refused vpc/image: another publisher is at work",
        "refused vpc/image: this port was closed",
        "refused service vpc/image; allowed: vpc/features, ",
        "refused vpc/image: images of 0 bytes; allowed: 1 to 268435456",
    ];
    for (line, expected) in said.iter().zip(expected) {
        assert!(line.starts_with(expected), "{line}, not {expected}");
    }
    assert_eq!(said.last(), Some(&"newest 5 mono8 b'AAAAAAAAAAAAAAA'"));
    drop((loaned, copied, publisher, subscriber, controller, domain));
    assert_eq!(Domain::segments(&place.domain()).unwrap(), 0);
}

/// logger.py hears what is published, leaves tables with it, and counts what it missed.
fn the_logger_fills_tables(python: &Path, format: &str) {
    let place = Place::new();
    let (domain_at, out) = (place.domain(), place.path("log"));
    let domain = Domain::join(&domain_at).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut recorder = RecorderPort::open(&domain).unwrap();
    let mut logger = script(python, "clients/python/logger.py");
    logger
        .arg("--domain")
        .arg(&domain_at)
        .arg("--out")
        .arg(&out);
    logger.args(["--seconds", "60", "--cycles", "20", "--format", format]);
    let mut logger = Running::start(logger.stdout(Stdio::piped()));
    logger.line("logging");
    let mut sent_ns = Vec::new();
    for k in 0..20_u32 {
        if k == 10 {
            recorder.cycles.skip();
        }
        let features = Features::new(&[[f64::from(k), 0.25]; 4], 0);
        sent_ns.push(camera.features.publish(&features).unwrap().published_ns);
        let seen = controller.features.latest().unwrap().unwrap();
        let answer = TwistCommand::answer(&seen, [0.5; 6], TwistState::Moving);
        controller.twist.publish(&answer).unwrap();
        let cycle = CycleRecord {
            cycle: u64::from(k) + 1,
            step_ns: 1000 * (u64::from(k) + 1),
            ..CycleRecord::default()
        };
        recorder.cycles.publish(&cycle).unwrap();
    }
    let Ended { code, stdout, .. } = logger.ended();
    assert_eq!(code, Some(0), "{stdout}");
    let cycles = stdout
        .lines()
        .find(|line| line.contains(&format!("cycles.{format}")));
    let counted = cycles.is_some_and(|line| line.ends_with("20 messages, 1 missed"));
    assert!(counted, "{stdout}");
    // The nearest ranks of 1 to 20 us, between which pandas draws straight lines.
    let steps = stdout.lines().find(|line| line.starts_with("step"));
    let steps: Vec<&str> = steps.unwrap().split_whitespace().collect();
    assert_eq!(steps, ["step", "10.5", "19.1", "19.8", "20.0"], "{stdout}");
    assert!(stdout.lines().any(|l| l.starts_with("features to twist")));
    // Numbers and kinds as pandas reads them back; a time in ns needs all 64 bits.
    let read = "import pandas, sys; table = getattr(pandas, 'read_' + sys.argv[1])(sys.argv[2]); \
                print(*table['points_0']); print(table['published_ns'].dtype.kind, *table['published_ns'])";
    let mut pandas = testkit::command(python);
    pandas.args(["-c", read, format]);
    let table = run(pandas.arg(out.join(format!("features.{format}")))).unwrap();
    let (points, times) = table.trim().split_once('\n').unwrap();
    let first: Vec<f64> = points.split(' ').map(|x| x.parse().unwrap()).collect();
    let published: Vec<f64> = (0..20).map(f64::from).collect();
    assert_eq!(first, published);
    let (kind, times) = times.split_once(' ').unwrap();
    let times: Vec<u64> = times.split(' ').map(|ns| ns.parse().unwrap()).collect();
    assert!(["i", "u"].contains(&kind), "{kind}");
    assert_eq!(times, sent_ns);
}

/// The camera's referee measures as hw-sim's does: the same numbers as in the unit tests there.
fn the_referee_measures(python: &Path) {
    let place = Place::new();
    let mut peer = script(python, "tests/judges/python/peer.py");
    let said = run(peer.arg("depths").arg(place.directory())).unwrap();
    let expected = [
        "16.0 75.0 0.0",
        "30.0 50.0 0.0",
        "10.25 0.5 inf 0.0",
        "None True",
        "None False",
        "None False",
        "painted False",
        "None False",
        "outside the image False",
        "outside the image False",
    ];
    assert_eq!(said.lines().collect::<Vec<_>>(), expected);
}

/// Every file below a directory.
fn files(directory: &Path) -> BTreeSet<PathBuf> {
    let entries = std::fs::read_dir(directory).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .flat_map(|path| match path.is_dir() {
            true => files(&path),
            false => BTreeSet::from([path]),
        })
        .filter(|path| !path.iter().any(|name| name == "__pycache__"))
        .collect()
}

/// The package makes a wheel without a trace in the tree. A user's program passes `mypy --strict`
/// against what is installed, and runs away from the tree.
fn the_package_installs(python: &Path) {
    let place = Place::new();
    let (tree, installed) = (sources("clients/python"), place.path("installed"));
    let in_python = |arguments: &[&str]| {
        let mut command = testkit::command(python);
        command.args(arguments).env("PYTHONPATH", &installed);
        command.env("MYPYPATH", &installed);
        command.env("PYTHONDONTWRITEBYTECODE", "1");
        command.current_dir(place.path("."));
        command
    };
    let before = files(&tree);
    let mut pip = in_python(&["-m", "pip", "install", "--quiet", "--no-deps"]);
    pip.args(["--no-build-isolation", "--disable-pip-version-check"]);
    run(pip.arg("--target").arg(&installed).arg(&tree)).unwrap();
    assert_eq!(files(&tree), before, "left in the tree");

    let mut requires = in_python(&["-c"]);
    requires.arg("import importlib.metadata as m; print(m.requires('vpc-client')[0])");
    assert_eq!(run(&mut requires).unwrap().trim(), "iceoryx2==0.9.3");

    let consumer = sources("tests/judges/python/consumer.py");
    let mypy = || {
        let mut mypy = in_python(&["-m", "mypy", "--strict", "--cache-dir=mypy"]);
        mypy.arg("--config-file").arg(tree.join("pyproject.toml"));
        mypy
    };
    let mut both = mypy();
    both.arg(&consumer).arg(installed.join("vpc_client"));
    let checked = Ended::from(both.output().unwrap());
    assert_eq!(checked.code, Some(0), "{checked:?}");
    // It does check.
    let right = std::fs::read_to_string(&consumer).unwrap();
    for (call, wrong, said) in [
        ("publish(frame(7))", "publish(b\"7\")", "[arg-type]"),
        ("publish(frame(7))", "publish(frame(7) / 2.0)", "[arg-type]"),
        (
            "publish(status)",
            "publish(vpc_client.Reply())",
            "[arg-type]",
        ),
        // ctypes gives every unknown attribute the type Any.
        ("features.count", "features.counts", "[assert-type]"),
    ] {
        assert!(right.contains(call), "{call}");
        let wrong = place.file("wrong.py", right.replace(call, wrong));
        let checked = Ended::from(mypy().arg(wrong).output().unwrap());
        assert!(checked.stdout.contains(said), "{call}: {checked:?}");
    }

    let mut use_it = in_python(&[]);
    let said = run(use_it.arg(&consumer).arg(place.domain())).unwrap();
    assert!(said.starts_with(installed.to_str().unwrap()), "{said}");
}

#[test]
fn the_client_in_python_agrees() {
    if let Some(python) = Environment::JUDGES.python("the_client_in_python_agrees") {
        layouts_agree(&python);
        messages_go_both_ways(&python);
        safety_agrees(&python);
        the_camera_can_be_driven(&python);
        the_referee_measures(&python);
        images_go_both_ways(&python);
    }
}

#[test]
fn the_client_in_python_refuses_what_breaks_the_contract() {
    if let Some(python) =
        Environment::JUDGES.python("the_client_in_python_refuses_what_breaks_the_contract")
    {
        refusals_have_words(&python);
        codes_agree(&python);
        bad_messages_are_refused(&python);
    }
}

#[test]
fn the_logger_in_python_fills_tables() {
    if let Some(python) = Environment::JUDGES.python("the_logger_in_python_fills_tables") {
        the_logger_fills_tables(&python, "csv");
        the_logger_fills_tables(&python, "parquet");
    }
}

#[test]
fn the_package_of_the_client_installs() {
    if let Some(python) = Environment::JUDGES.python("the_package_of_the_client_installs") {
        the_package_installs(&python);
    }
}
