//! `serve --foxglove`, read by Foxglove's own client from npm beside a subscriber of the contract.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use ipc::Domain;
use messages::{CycleRecord, Features, Hold, ImageHeader, Message, Stamp, TwistState};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion};
use serde_json::Value;
use testkit::{Place, Running, node, program, root};

use crate::stand_in::Camera;

const TEST: &str = "foxgloves_own_client_reads_what_the_daemon_does";
const CLIENT: &str = "controller/vpcctl/tests/foxglove/client.cjs";
/// Longest wait for the messages that are compared: a few seconds, but for a loaded machine.
const PATIENCE: Duration = Duration::from_secs(60);
/// What stands still, and comes again.
const STILL: [&str; 3] = ["/world/pattern", "/camera/calibration", "/camera/image"];

/// What a client of Foxglove received.
#[derive(Default)]
struct Received {
    /// Topics with their JSON schemas; null for others.
    channels: BTreeMap<String, Value>,
    /// Messages by topic, in order: time, value.
    messages: BTreeMap<String, Vec<(Value, Value)>>,
    /// All other events.
    events: Vec<Value>,
}

impl Received {
    fn new(lines: &str) -> Self {
        let mut received = Self::default();
        for line in lines.lines() {
            let mut event: Value = serde_json::from_str(line).unwrap();
            let topic = event["topic"].as_str().unwrap_or_default().to_owned();
            match event["event"].as_str() {
                Some("channel") => {
                    let schema = event["schema"].as_str().unwrap();
                    let schema = serde_json::from_str(schema).unwrap_or_default();
                    received.channels.insert(topic, schema);
                }
                Some("message") => {
                    let message = (event["time"].take(), event["value"].take());
                    received.messages.entry(topic).or_default().push(message);
                }
                _ => received.events.push(event),
            }
        }
        received
    }

    fn of(&self, topic: &str) -> &[(Value, Value)] {
        let messages = self.messages.get(topic);
        messages
            .unwrap_or_else(|| panic!("{topic}: no message"))
            .as_slice()
    }

    fn last(&self, topic: &str) -> &Value {
        &self.of(topic).last().unwrap().1
    }

    /// The message of a topic at the time of another.
    fn at(&self, topic: &str, time: &Value) -> Option<&Value> {
        let found = self.of(topic).iter().find(|(at, _)| at == time);
        found.map(|(_, value)| value)
    }
}

/// What a subscriber of the contract received, by sequence numbers.
#[derive(Default)]
struct Direct {
    cycles: BTreeMap<u64, CycleRecord>,
    features: BTreeMap<u64, Features>,
}

impl Direct {
    /// Listens until the end; counts the cycles in motion.
    fn listen(domain: &Path, end: &AtomicBool, moving: &AtomicUsize) -> Self {
        let domain = Domain::join(domain).unwrap();
        let mut cycles = domain.subscriber::<CycleRecord>(1024).unwrap();
        let mut features = domain.subscriber::<Features>(64).unwrap();
        let mut direct = Self::default();
        while !end.load(Ordering::Relaxed) {
            while let Some(m) = cycles.oldest().unwrap() {
                let moves = m.message.state == TwistState::Moving.code();
                moving.fetch_add(usize::from(moves), Ordering::Relaxed);
                direct.cycles.insert(m.message.stamp.sequence, m.message);
            }
            while let Some(m) = features.oldest().unwrap() {
                direct.features.insert(m.message.stamp.sequence, m.message);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        direct
    }
}

/// Ends who listens, also where the test fails.
struct EndOnDrop<'a>(&'a AtomicBool);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Programs in a domain.
struct Stage {
    place: Place,
    url: String,
}

impl Stage {
    fn start(&self, name: &str, words: &[&str]) -> Running {
        let mut command = testkit::command(program(name));
        command.arg("--domain").arg(self.place.domain()).args(words);
        command
            .current_dir(root())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Running::start(command)
    }

    fn daemon(&self) -> Running {
        let mut daemon = self.start("vpcd", &["--config", "controller/vpcd-robot.toml", "--arm"]);
        daemon.line("scene controller");
        daemon
    }

    fn client(&self, words: &[&str]) -> Option<Running> {
        let mut client = node::script(TEST, CLIENT)?;
        client.arg(&self.url).args(words).stdout(Stdio::piped());
        Some(Running::start(client))
    }

    /// Runs a client until it has this many messages of a topic.
    fn watched(&self, topic: &str, count: usize) -> Received {
        let client = self.client(&[]).unwrap();
        wait(topic, || has(&client, topic, count));
        Received::new(&client.terminated().stdout)
    }
}

/// Whether a client has printed this many messages of a topic.
fn has(client: &Running, topic: &str, count: usize) -> bool {
    let words = format!(r#"{{"event":"message","topic":"{topic}""#);
    client.stdout().matches(&words).count() >= count
}

/// Waits until it is so; looks seldom, because a client prints megabytes.
fn wait(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < end, "{what}: not in {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// Numbers of a list.
fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().unwrap();
    list.iter().map(|x| x.as_f64().unwrap()).collect()
}

/// The coordinates of a point.
fn place(value: &Value) -> [f64; 3] {
    ["x", "y", "z"].map(|axis| value[axis].as_f64().unwrap_or(0.0))
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// The entity of this name in a scene update.
fn entity<'a>(update: &'a Value, id: &str) -> &'a Value {
    let entities = update["entities"].as_array().unwrap();
    entities.iter().find(|entity| entity["id"] == id).unwrap()
}

fn line(entity: &Value) -> Vec<[f64; 3]> {
    let points = entity["lines"][0]["points"].as_array().unwrap();
    points.iter().map(place).collect()
}

fn isometry(value: &Value, [at, turn]: [&str; 2]) -> Isometry3<f64> {
    let [x, y, z] = place(&value[turn]);
    let turn = Quaternion::new(value[turn]["w"].as_f64().unwrap(), x, y, z);
    let turn = UnitQuaternion::from_quaternion(turn);
    Isometry3::from_parts(place(&value[at]).into(), turn)
}

#[test]
fn foxgloves_own_client_reads_what_the_daemon_does() {
    let place = Place::new();
    let mut server = testkit::command(env!("CARGO_BIN_EXE_vpcctl"));
    server.arg("--domain").arg(place.domain());
    server.args([
        "serve",
        "--foxglove",
        "127.0.0.1:0",
        "--hand-eye",
        "ipc/clients/panda/hand-eye.toml",
    ]);
    server
        .current_dir(root())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut server = Running::start(server);
    let line = server.line("Foxglove: open a connection to ws://127.0.0.1:");
    let url = line.rsplit(' ').next().unwrap().to_owned();
    let stage = Stage { place, url };
    // Before the daemon; one that never reads; one that ends and comes back.
    let Some(mut early) = stage.client(&[]) else {
        return;
    };
    early.line("capabilities");
    let deaf = stage.client(&["deaf"]).unwrap();
    let (ended, moving) = (AtomicBool::new(false), AtomicUsize::new(0));
    let (received, late, direct) = std::thread::scope(|threads| {
        let end = EndOnDrop(&ended);
        let domain = stage.place.domain();
        let (ended, moving) = (&ended, &moving);
        let direct = threads.spawn(move || Direct::listen(&domain, ended, moving));
        let _robot = stage.start(
            "hw-sim",
            &["--config", "hw-sim/hw-sim-robot.toml", "--start", "3"],
        );
        let _daemon = stage.daemon();
        wait("motion", || moving.load(Ordering::Relaxed) > 90);
        for topic in STILL {
            wait(topic, || has(&early, topic, 3));
        }
        let late = stage.watched("/vpc/cycles", 40);
        let received = Received::new(&early.terminated().stdout);
        drop(end);
        (received, late, direct.join().unwrap())
    });
    let scene = scene::Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml").unwrap();

    is_read_only(&received);
    what_stands_still_comes_again(&received);
    layout_names_what_is_served(&received);
    let compared = messages_are_the_daemons(&received, &direct);
    assert!(compared > 60, "{compared} cycles");
    let moves = |cycle: &&CycleRecord| cycle.state == TwistState::Moving.code();
    let moving = direct.cycles.values().filter(moves).count();
    assert!(moving > 60, "{moving} cycles in motion");
    drawings_are_of_these_messages(&received, &scene);
    world_is_connected(&received, &scene);
    // Who comes late is shown what stands still, too.
    assert!(messages_are_the_daemons(&late, &direct) > 20);
    world_is_connected(&late, &scene);
    assert_eq!(late.channels.len(), received.channels.len());
    let image = late.last("/camera/image");
    assert_eq!(
        (&image["encoding"], &image["width"]),
        (&"mono8".into(), &640.into())
    );

    // The daemon was killed: another comes, and a camera.
    let header = ImageHeader::new(32, 20, messages::Encoding::Rgb8, 1);
    let _camera = Camera::start(&stage.place.domain(), header, |u, v| [u as u8, v as u8, 7]);
    let begun_ns = ipc::now_ns();
    let _daemon = stage.daemon();
    let again = stage.watched("/camera/image", 30);
    let last = again.last("/vpc/cycles");
    let ran_ns = last["stamp"]["published_ns"].as_u64().unwrap() - begun_ns;
    let most = 1e-9 * ran_ns as f64 * scene.camera.rate_hz + 1.0;
    assert!((last["cycle"].as_u64().unwrap() as f64) < most, "{last}");
    assert_eq!(
        (&last["state_name"], &last["hold_name"]),
        (&"disarmed".into(), &"unclean end of the last vpcd".into())
    );
    let images = again.of("/camera/image");
    let sum: u32 = (0..20).flat_map(|v| (0..32).map(move |u| u + v + 7)).sum();
    let image = &images.last().unwrap().1;
    assert_eq!(
        (&image["encoding"], &image["step"]),
        (&"rgb8".into(), &96.into())
    );
    assert_eq!(image["data"]["sum"], sum);
    // 17 a second at most, of 100.
    let times: Vec<f64> = images.iter().map(|(at, _)| seconds(at)).collect();
    let apart = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    assert!(apart > 0.059, "{apart} s apart: {times:?}");
    // It ends at once beside a client that does not read.
    let ended = server.terminated();
    assert_eq!(ended.code, Some(0));
    let told = "/vpc/cycles: the publisher started again";
    assert!(ended.stderr.contains(told), "{}", ended.stderr);
    drop(deaf);
}

fn is_read_only(received: &Received) {
    let [open, server, ..] = &received.events[..] else {
        panic!("{:?}", received.events);
    };
    assert_eq!(open["protocol"], "foxglove.sdk.v1");
    assert_eq!(server["capabilities"], Value::Array(Vec::new()));
    let strange = received.events[2..]
        .iter()
        .find(|event| event["event"] != "close");
    assert_eq!(strange, None);
}

/// The time of a message, s.
fn seconds(at: &Value) -> f64 {
    1e-9 * at.as_str().unwrap().parse::<f64>().unwrap()
}

/// It comes also when nobody subscribes, and once a second where many topics are subscribed to. How
/// soon it comes again, a test of `recorder::live` says.
fn what_stands_still_comes_again(received: &Received) {
    for topic in STILL {
        let times: Vec<f64> = received
            .of(topic)
            .iter()
            .map(|(at, _)| seconds(at))
            .collect();
        assert!(times.len() > 2, "{topic} at {times:?}");
        for pair in times.windows(2) {
            assert!(pair[1] - pair[0] > 0.95, "{topic} at {times:?}");
        }
    }
}

/// Every topic of the layout is served, every field is in its schema.
fn layout_names_what_is_served(received: &Received) {
    let layout = root().join("ipc/recording/foxglove-layout.json");
    let layout = std::fs::read_to_string(layout).unwrap();
    // The scene of this run names no arm.
    let is_of_arm = |text: &&str| *text == "/camera/joints";
    let texts = layout.split('"').filter(|text| text.starts_with('/'));
    let texts = texts.filter(|text| !is_of_arm(text));
    let mut count = 0;
    for path in texts {
        let (topic, field) = path.split_once('.').unwrap_or((path, ""));
        let schema = received.channels.get(topic);
        let schema = schema.unwrap_or_else(|| panic!("{path} is not served"));
        let field = field.split('[').next().unwrap_or_default();
        assert!(
            field.is_empty() || schema["properties"].get(field).is_some(),
            "{path}"
        );
        count += 1;
    }
    assert!(count > 20, "{count}");
}

/// Compares all cycles and features with those that were received without Foxglove; how many
/// cycles.
fn messages_are_the_daemons(received: &Received, direct: &Direct) -> usize {
    for (_, read) in received.of("/vpc/features") {
        let number = read["stamp"]["sequence"].as_u64().unwrap();
        if let Some(sent) = direct.features.get(&number) {
            assert_eq!(numbers(&read["points"]), sent.points);
        }
    }
    let cycles = received.of("/vpc/cycles");
    let mut last = 0;
    for (_, read) in cycles {
        let number = read["stamp"]["sequence"].as_u64().unwrap();
        assert!(number > last, "{number} after {last}");
        last = number;
        let Some(sent) = direct.cycles.get(&number) else {
            continue;
        };
        let Stamp { published_ns, .. } = sent.stamp();
        assert_eq!(read["stamp"]["published_ns"], *published_ns);
        assert_eq!(numbers(&read["twist"]), sent.twist);
        assert_eq!(numbers(&read["points"]), sent.points);
        assert_eq!(read["step_ns"], sent.step_ns);
        assert_eq!(
            read["error_px"].as_f64().unwrap_or(f64::NAN).to_bits(),
            sent.error_px.to_bits()
        );
        let state = TwistState::from_code(sent.state).unwrap().to_string();
        let hold = Hold::from_code(sent.hold).map_or("none".to_owned(), |hold| hold.to_string());
        assert_eq!(
            (&read["state_name"], &read["hold_name"]),
            (&state.into(), &hold.into())
        );
    }
    cycles.len()
}

/// Marks in the image are where the features are, and the foreseen path ends at the goal.
fn drawings_are_of_these_messages(received: &Received, scene: &scene::Scene) {
    let mut drawn = 0;
    for (time, marks) in received.of("/camera/features") {
        let Some(features) = received.at("/vpc/features", time) else {
            continue;
        };
        let points = numbers(&features["points"]);
        for (circle, point) in marks["circles"]
            .as_array()
            .unwrap()
            .iter()
            .zip(points.chunks(2))
        {
            let [u, v, _] = self::place(&circle["position"]);
            // Foxglove counts from the corner of the first pixel.
            assert!(
                (u - 0.5 - point[0]).hypot(v - 0.5 - point[1]) < 1e-9,
                "{marks}"
            );
            drawn += 1;
        }
    }
    assert!(drawn > 200, "{drawn}");
    let wanted = Isometry3::new(scene.goal.translation.into(), scene.goal.rotation.into());
    let wanted = wanted.inverse().translation.vector.into();
    let mut ways = 0;
    for (time, marks) in received.of("/camera/way_point") {
        let Some(cycle) = received.at("/vpc/cycles", time) else {
            continue;
        };
        let text = marks["texts"][0]["text"].as_str().unwrap();
        assert!(
            text.starts_with(cycle["state_name"].as_str().unwrap()),
            "{text}"
        );
        if cycle["path_count"].as_u64().unwrap() < 2 || !cycle["arrival_s"].is_f64() {
            continue;
        }
        let lines = marks["points"].as_array().unwrap();
        for (line, goal) in lines.iter().zip(scene.goal_px()) {
            let end = self::place(line["points"].as_array().unwrap().last().unwrap());
            let miss = (end[0] - 0.5 - goal[0]).hypot(end[1] - 0.5 - goal[1]);
            assert!(miss < 25.0, "the path ends {miss} px from the goal");
        }
        let Some(update) = received.at("/world/foreseen", time) else {
            continue;
        };
        let way = self::line(entity(update, "foreseen"));
        assert_eq!(way.len() as u64, cycle["path_count"].as_u64().unwrap());
        let miss = apart(*way.last().unwrap(), wanted);
        assert!(miss < 0.05, "the camera's way ends {miss} m from the goal");
        ways += 1;
    }
    assert!(ways > 20, "{ways}");
    let log = received.of("/log").iter();
    assert!(
        log.filter(|(_, entry)| entry["message"].as_str().unwrap().contains("moving"))
            .count()
            > 0
    );
}

/// Pattern, camera, flange and base hang together, and the arm goes from the base to the flange.
fn world_is_connected(received: &Received, scene: &scene::Scene) {
    let balls = entity(received.last("/world/pattern"), "pattern")["spheres"]
        .as_array()
        .unwrap();
    assert_eq!(balls.len(), scene.pattern.len());
    for (ball, point) in balls.iter().zip(&scene.pattern) {
        assert!(apart(place(&ball["pose"]["position"]), *point) < 1e-12);
    }
    let frustum = entity(received.last("/world/frustum"), "frustum");
    assert_eq!(
        (&frustum["frame_id"], line(frustum)[0]),
        (&"camera".into(), [0.0; 3])
    );
    let k = &received.last("/camera/calibration")["K"];
    assert_eq!(numbers(k)[..3], [scene.camera.fx, 0.0, scene.camera.cx]);

    let links = received.of("/tf");
    let at_once = |time: &Value| links.iter().filter(|(at, _)| at == time).count();
    let arms = received.of("/world/arm").iter().rev();
    let (time, arm) = arms
        .into_iter()
        .find(|(time, _)| at_once(time) == 3)
        .unwrap();
    let link = |parent: &str, child: &str| {
        let is_it =
            |link: &Value| link["parent_frame_id"] == parent && link["child_frame_id"] == child;
        let link = links.iter().find(|(at, link)| at == time && is_it(link));
        let (_, link) = link.unwrap_or_else(|| panic!("{parent} to {child} at {time}"));
        isometry(link, ["translation", "rotation"])
    };
    let camera = link("object", "camera");
    if let Some(pose) = received.at("/camera/pose", time) {
        let pose = isometry(&pose["pose"], ["position", "orientation"]);
        assert!((camera.translation.vector - pose.translation.vector).norm() < 1e-12);
    }
    let arm = entity(arm, "arm");
    let (chain, base_from_flange) = (line(arm), link("flange", "base").inverse());
    assert_eq!((&arm["frame_id"], chain[0]), (&"base".into(), [0.0; 3]));
    let flange = base_from_flange.translation.vector.into();
    assert!(apart(*chain.last().unwrap(), flange) < 1e-9);
    // The emulator lays the pattern flat on a table before the arm, its z axis down.
    let object = (camera * link("camera", "flange") * link("flange", "base")).inverse();
    let at = object.translation.vector;
    assert!(apart(at.into(), [0.5, 0.0, 0.05]) < 2e-3, "{object}");
    let down = object.rotation.transform_vector(&nalgebra::Vector3::z());
    assert!(down.z < -0.9999, "{object}");
}
