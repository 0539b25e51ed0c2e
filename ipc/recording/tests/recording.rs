//! The promises of a recording, over real shared memory. One executable: each that links iceoryx2 costs up to a minute
//! of build. A recorder that is killed is this same executable, started again.

mod python;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ipc::{
    Action, CameraPorts, ControllerPorts, CycleRecord, Domain, Features, Hold, OperatorPorts,
    Order, Outcome, RecorderPort, Reply, Request, RobotMode, RobotState, Stamp, StrategyCode,
    TwistCommand, TwistState,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use recording::{
    Account, Context, Ledger, Notice, Options, Recorded, Recording, RecordingFile, record,
};

/// Messages of each topic.
const MESSAGES: usize = 400;

/// A directory for one test, with a domain in it. When the test ends, joining and leaving clears away what killed
/// processes left in /dev/shm.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn domain(&self) -> PathBuf {
        self.0.path().join("domain")
    }

    fn file(&self) -> PathBuf {
        self.0.path().join("run.mcap")
    }

    fn options(&self) -> Options {
        Options {
            domain: self.domain(),
            output: self.file(),
            force: false,
            duration: None,
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if self.domain().exists() {
            let _ = Domain::join(&self.domain());
        }
    }
}

fn scene_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scene/scenes/paper-sim.toml")
}

fn context() -> Context {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../controller/vpcd.toml");
    Context::read(Some(&scene_file()), Some(&config)).unwrap()
}

fn eventually(what: &str, mut attempt: impl FnMut() -> bool) {
    let start = Instant::now();
    while !attempt() {
        assert!(
            start.elapsed() < Duration::from_secs(20),
            "{what}: did not happen"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Everybody who publishes, in one thread.
struct Stage {
    camera: CameraPorts,
    controller: ControllerPorts,
    telemetry: RecorderPort,
    operator: OperatorPorts,
    /// Who hears replies without any recorder.
    listeners: usize,
}

/// All that was published.
#[derive(Default)]
struct Published {
    features: Vec<Features>,
    twist: Vec<TwistCommand>,
    robot: Vec<RobotState>,
    cycles: Vec<CycleRecord>,
    requests: Vec<Request>,
    replies: Vec<Reply>,
}

impl Stage {
    fn open(directory: &Path) -> Self {
        let domain = Domain::join(directory).unwrap();
        let mut controller = ControllerPorts::open(&domain).unwrap();
        let camera = CameraPorts::open(&domain).unwrap();
        let telemetry = RecorderPort::open(&domain).unwrap();
        let operator = OperatorPorts::open(&domain).unwrap();
        let reply = reply(&Request::new(0, Action::Status));
        let listeners = controller.replies.publish(&reply).unwrap().receivers;
        Self {
            camera,
            controller,
            telemetry,
            operator,
            listeners,
        }
    }

    /// Waits until a recorder has opened its last port, replies, beside those who hear them anyway.
    fn wait_for_recorder(&mut self) {
        let reply = reply(&Request::new(0, Action::Status));
        eventually("the recorder listens", || {
            self.controller.replies.publish(&reply).unwrap().receivers > self.listeners
        });
    }

    /// Publishes a message of each topic, with numbers of all sizes.
    fn publish(&mut self, i: usize, random: &mut ChaCha8Rng, published: &mut Published) {
        let mut any = || {
            let size: f64 = random.random_range(-9.0..9.0);
            random.random_range(-1.0..1.0) * 10f64.powf(size)
        };
        let count = 4 + i % 5;
        let points: Vec<_> = (0..count).map(|_| [any(), any()]).collect();
        let mut features = Features::new(&points, ipc::now_ns());
        features.visible ^= 1 << (i % 4);
        features.exposure_ns = i as u64;
        let sent = self.camera.features.publish(&features).unwrap();
        stamp(&mut features.stamp, &sent);

        let mut state =
            RobotState::free_camera([any(), any(), 0.5], [any(), any(), any()], ipc::now_ns());
        state.mode = RobotMode::Moving.code();
        state.q = std::array::from_fn(|_| any());
        state.features_sequence = features.stamp.sequence;
        let sent = self.camera.robot.publish(&state).unwrap();
        stamp(&mut state.stamp, &sent);

        let twist = std::array::from_fn(|_| any());
        let mut command = TwistCommand::answer(&features, twist, TwistState::Moving);
        let sent = self.controller.twist.publish(&command).unwrap();
        stamp(&mut command.stamp, &sent);

        let mut cycle = CycleRecord {
            cycle: i as u64 + 1,
            step_ns: 1_000 + i as u64,
            features_sequence: features.stamp.sequence,
            count: count as u32,
            way_point_count: 4 * (i as u32 / 100 % 2),
            state: TwistState::Moving.code(),
            points: features.points,
            way_point: std::array::from_fn(|_| any()),
            twist,
            error_px: any(),
            clearance_px: f64::INFINITY,
            ..CycleRecord::default()
        };
        if i % 50 == 7 {
            (cycle.hold, cycle.state) = (Hold::Stale.code(), TwistState::Holding.code());
        } else {
            (cycle.cost, cycle.violation_px) = (any(), any());
        }
        let sent = self.telemetry.cycles.publish(&cycle).unwrap();
        stamp(&mut cycle.stamp, &sent);

        if i.is_multiple_of(8) {
            let mut request = Request::strategy(u64::MAX - i as u64, StrategyCode::Knn, 3);
            let sent = self.operator.requests.publish(&request).unwrap();
            stamp(&mut request.stamp, &sent);
            let mut reply = reply(&request);
            let sent = self.controller.replies.publish(&reply).unwrap();
            stamp(&mut reply.stamp, &sent);
            published.requests.push(request);
            published.replies.push(reply);
        }
        published.features.push(features);
        published.robot.push(state);
        published.twist.push(command);
        published.cycles.push(cycle);
    }
}

fn stamp(stamp: &mut Stamp, sent: &ipc::Sent) {
    (stamp.sequence, stamp.published_ns) = (sent.sequence, sent.published_ns);
}

fn reply(request: &Request) -> Reply {
    Reply {
        stamp: Stamp::default(),
        id: request.id,
        action: request.action,
        outcome: Outcome::NoMemory.code(),
        state: TwistState::Moving.code(),
        hold: Hold::None.code(),
        strategy: StrategyCode::Gpr.code(),
        neighbours: 0,
    }
}

/// Records in another thread while `play` runs; what was counted, and what was told on the way.
fn recorded(options: &Options, play: impl FnOnce()) -> (Ledger, Vec<Notice>) {
    let stop = AtomicBool::new(false);
    let mut notices = Vec::new();
    let context = context();
    let ledger = std::thread::scope(|threads| {
        let recorder = threads.spawn(|| {
            record(options, &context, &stop, |notice| {
                notices.push(notice.clone());
            })
        });
        // A test that fails must not leave the recorder running.
        let stopped = Stopping(&stop);
        play();
        drop(stopped);
        recorder.join().unwrap().unwrap()
    });
    (ledger, notices)
}

struct Stopping<'a>(&'a AtomicBool);

impl Drop for Stopping<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Bits of numbers, as `check.py` prints them.
fn bits(numbers: &[f64]) -> String {
    let one = |x: &f64| {
        if x.is_nan() {
            "nan".to_owned()
        } else {
            format!("{:016x}", x.to_bits())
        }
    };
    numbers.iter().map(one).collect::<Vec<_>>().join(" ")
}

/// The lines that `check.py values` is to print about messages, by topic.
fn lines(published: &Published) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = |topic: &str, stamp: &Stamp, whole: &[u64], real: &[&[f64]]| {
        let Stamp {
            sequence,
            published_ns,
            data_ns,
        } = stamp;
        let mut line = format!("message {topic} {sequence} {published_ns} {data_ns}");
        whole.iter().for_each(|n| write!(line, " {n}").unwrap());
        real.iter()
            .for_each(|x| write!(line, " {}", bits(x)).unwrap());
        lines.push(line);
    };
    for m in &published.features {
        let whole = [m.exposure_ns, m.count.into(), m.visible.into()];
        line("/vpc/features", &m.stamp, &whole, &[&m.points]);
    }
    for m in &published.twist {
        let whole = [
            m.features_sequence,
            m.features_published_ns,
            m.valid_until_ns,
            m.state.into(),
        ];
        line("/vpc/twist", &m.stamp, &whole, &[&m.twist]);
    }
    for m in &published.robot {
        let whole = [
            m.features_sequence,
            m.mode.into(),
            m.faults.into(),
            m.joints.into(),
        ];
        let real = [
            &m.translation[..],
            &m.rotation,
            &m.twist,
            &m.q,
            &m.dq,
            &m.room,
        ];
        line("/vpc/robot", &m.stamp, &whole, &real);
    }
    for m in &published.cycles {
        let whole = [
            m.cycle,
            m.step_ns,
            m.hold.into(),
            m.state.into(),
            m.way_point_count.into(),
        ];
        let law = [m.cost, m.violation_px, m.clearance_px, m.error_px];
        let real = [&m.points[..], &m.way_point, &m.twist, &law];
        line("/vpc/cycles", &m.stamp, &whole, &real);
    }
    for m in &published.requests {
        let whole = [
            m.id,
            m.action.into(),
            m.strategy.into(),
            m.neighbours.into(),
        ];
        line("/vpc/requests", &m.stamp, &whole, &[]);
    }
    for m in &published.replies {
        let whole = [m.id, m.action.into(), m.outcome.into(), m.state.into()];
        line("/vpc/replies", &m.stamp, &whole, &[]);
    }
    lines
}

/// Equal bit for bit, NaN to NaN: by their JSON, whose exactness has a test of its own.
fn same<T: Recorded>(read: &[T], published: &[T]) {
    assert_eq!(read.len(), published.len(), "{}", T::TOPIC);
    for (read, published) in read.iter().zip(published) {
        assert_eq!(read.to_json(), published.to_json());
    }
}

#[test]
fn what_was_published_comes_back_and_others_read_the_same() {
    // A starved machine may lose messages, and says so: then once more.
    let complete = (0..5).any(published_and_read);
    assert!(complete, "messages were lost each time");
}

/// Whether nothing was lost.
fn published_and_read(seed: u64) -> bool {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut published = Published::default();
    let mut before = Vec::new();
    let (ledger, notices) = recorded(&place.options(), || {
        stage.wait_for_recorder();
        for i in 0..MESSAGES {
            stage.publish(i, &mut random, &mut published);
            std::thread::sleep(Duration::from_millis(3));
        }
    });
    if ledger.total().lost > 0 {
        return false;
    }
    let mut recording = Recording::read(&place.file()).unwrap();
    // The replies by which the recorder was waited for.
    let first = published.replies[0].stamp.sequence;
    recording.replies.retain(|reply| {
        let early = reply.stamp.sequence < first;
        if early {
            before.push(*reply);
        }
        !early
    });

    assert_eq!(notices, [], "nothing was lost");
    assert_eq!(recording.cut, None);
    assert_eq!(recording.ledger.as_ref(), Some(&ledger));
    assert_eq!(recording.scene_toml.as_deref(), Some(scene::PAPER_SIM));
    assert!(recording.config_toml.as_ref().unwrap().contains("[law]"));
    same(&recording.features, &published.features);
    same(&recording.twist, &published.twist);
    same(&recording.robot, &published.robot);
    same(&recording.cycles, &published.cycles);
    same(&recording.requests, &published.requests);
    same(&recording.replies, &published.replies);
    assert_eq!(
        ledger.of("/vpc/cycles"),
        Account {
            recorded: MESSAGES as u64,
            ..Account::default()
        }
    );

    let test = "what_was_published_comes_back_and_others_read_the_same";
    if let Some(python) = python::python(test) {
        others_read_the_same(&python, &place.file(), &published, &before, &recording);
    }
    true
}

fn others_read_the_same(
    python: &Path,
    file: &Path,
    published: &Published,
    before: &[Reply],
    recording: &Recording,
) {
    let found = python::check(python, "values", &[file]);
    let messages = |lines: &[String], topic: &str| -> Vec<String> {
        let head = format!("message {topic} ");
        lines
            .iter()
            .filter(|line| line.starts_with(&head))
            .cloned()
            .collect()
    };
    let expected = lines(published);
    for (topic, skipped) in [
        ("/vpc/features", 0),
        ("/vpc/twist", 0),
        ("/vpc/robot", 0),
        ("/vpc/cycles", 0),
        ("/vpc/requests", 0),
        ("/vpc/replies", before.len()),
    ] {
        let (theirs, ours) = (messages(&found, topic), messages(&expected, topic));
        let count = format!("count {topic} {}", ours.len() + skipped);
        assert!(found.contains(&count), "{count}");
        for (theirs, ours) in theirs[skipped..].iter().zip(&ours) {
            assert_eq!(theirs, ours, "Python first, then Rust");
        }
        assert_eq!(theirs.len(), ours.len() + skipped, "{topic}");
    }
    let clock = recording.clock.unwrap();
    for line in [
        format!("metadata vpc.ledger /vpc/features.recorded {MESSAGES}"),
        "metadata vpc.ledger /vpc/features.lost 0".to_owned(),
        format!("metadata vpc.origin wall_ns {}", clock.wall_ns),
        format!(
            "attachment scene.toml application/toml {}",
            scene::PAPER_SIM.len()
        ),
        "count /vpc/scene 1".to_owned(),
        "count /camera/image 1".to_owned(),
    ] {
        assert!(found.contains(&line), "{line}");
    }
    let layout = Path::new(env!("CARGO_MANIFEST_DIR")).join("foxglove-layout.json");
    assert_eq!(python::check(python, "layout", &[&layout]).len(), 8);
    // Every topic and path that the layout names is in the recording; numbers that are not finite are left out.
    let paths = python::check(python, "paths", &[file, &layout]);
    assert!(paths.len() > 15, "{paths:?}");
    for line in &paths {
        let words: Vec<_> = line.split(' ').collect();
        let [heard, values] = [words[2], words[3]].map(|count| count.parse::<u64>().unwrap());
        let all = ["clearance_px", "error_px"]
            .iter()
            .all(|name| !words[1].ends_with(name));
        let is_there = heard > 0 && (values == heard || !all);
        assert!(is_there, "{line}: topic or path, messages, values");
    }
    let known = python::check(python, "schemas", &[file]);
    for name in [
        "ImageAnnotations",
        "RawImage",
        "CameraCalibration",
        "FrameTransform",
        "PoseInFrame",
        "Log",
    ] {
        let head = format!("known foxglove.{name} ");
        let line = known.iter().find(|line| line.starts_with(&head)).unwrap();
        assert!(!line.ends_with(" 0"), "{line}");
    }
}

#[test]
fn lost_messages_restarts_and_refusals_are_counted_and_told() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let (ledger, notices) = recorded(&place.options(), || {
        stage.wait_for_recorder();
        let square = Features::new(&[[1.0, 2.0]; 4], 1);
        stage.camera.features.publish(&square).unwrap();
        (0..3).for_each(|_| stage.camera.features.skip());
        stage.camera.features.publish(&square).unwrap();
        // As from a camera that was started again.
        let mut again = square;
        again.stamp = Stamp {
            sequence: 1,
            published_ns: ipc::now_ns(),
            data_ns: 5,
        };
        stage.camera.features.publish_verbatim(&again).unwrap();
        let mut nan = again;
        nan.stamp.sequence = 2;
        nan.points[3] = f64::NAN;
        stage.camera.features.publish_verbatim(&nan).unwrap();
    });
    let account = Account {
        recorded: 3,
        lost: 3,
        refused: 1,
        restarts: 1,
    };
    assert_eq!(ledger.of("/vpc/features"), account);
    let told: Vec<_> = notices.iter().map(Notice::to_string).collect();
    assert_eq!(
        told,
        [
            "/vpc/features: 3 messages lost",
            "/vpc/features: the publisher started again",
            "/vpc/features: a message was refused: vpc/features: points[3] = NaN; allowed: finite numbers",
        ]
    );
    let recording = Recording::read(&place.file()).unwrap();
    assert_eq!(recording.ledger.unwrap().of("/vpc/features"), account);
    assert_eq!(Recording::missing(&recording.features), 3);
}

#[test]
fn a_file_is_not_overwritten_unless_asked() {
    let place = Place::new();
    let options = Options {
        duration: Some(Duration::ZERO),
        ..place.options()
    };
    let stop = AtomicBool::new(false);
    std::fs::write(place.file(), "dear to somebody").unwrap();
    let refused = record(&options, &Context::default(), &stop, |_| ()).unwrap_err();
    let message = format!(
        "{}: exists; allowed: a new file, or --force",
        place.file().display()
    );
    assert_eq!(refused.to_string(), message);
    assert_eq!(std::fs::read(place.file()).unwrap(), b"dear to somebody");
    // Nobody was disturbed: not even the domain was made.
    assert!(!place.domain().exists());

    let options = Options {
        force: true,
        ..options
    };
    record(&options, &Context::default(), &stop, |_| ()).unwrap();
    let recording = Recording::read(&place.file()).unwrap();
    assert!(recording.cut.is_none() && recording.features.is_empty() && recording.scene.is_none());
}

#[test]
fn a_masked_scene_is_whole_in_the_recording_when_its_files_are_gone() {
    let place = Place::new();
    let ring = place.0.path().join("ring.png");
    let is_white = |u: u32, v: u32| {
        let square = u.abs_diff(300).pow(2) + v.abs_diff(700).pow(2);
        (120 * 120..200 * 200).contains(&square)
    };
    scene::write_mask(&ring, 1024, 1024, is_white).unwrap();
    let png = std::fs::read(&ring).unwrap();
    let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
    let text = format!("{head}[[occlusion]]\nname = \"ring\"\nmask = \"ring.png\"\n");
    let path = place.0.path().join("scene.toml");
    std::fs::write(&path, &text).unwrap();
    let context = Context::read(Some(&path), None).unwrap();
    // What is painted after the start is not what was recorded.
    std::fs::remove_file(&ring).unwrap();
    std::fs::remove_file(&path).unwrap();

    let mut file = RecordingFile::create(&place.file(), false, &context).unwrap();
    for i in 0..40 {
        let mut cycle = CycleRecord {
            cycle: i + 1,
            features_sequence: i + 1,
            count: 4,
            ..CycleRecord::default()
        };
        cycle.stamp.data_ns = i * 33_333_333;
        for (place, corner) in [300.0, 300.0, 700.0, 300.0, 700.0, 700.0, 300.0, 700.0]
            .into_iter()
            .enumerate()
        {
            cycle.points[place] = corner + 5.0 * i as f64;
        }
        file.cycle(&cycle, Order::Next).unwrap();
    }
    file.finish().unwrap();

    let recording = Recording::read(&place.file()).unwrap();
    let scene = recording.scene.as_ref().unwrap();
    assert_eq!(recording.scene_toml.as_deref(), Some(&*text));
    assert_eq!(scene.fingerprint(), context.scene.unwrap().0.fingerprint());
    assert!(scene.masks().next().unwrap().is_forbidden(140, 700));
    let plots = Path::new(env!("CARGO_TARGET_TMPDIR")).join("masked");
    let drawn = recording::plot(&recording, None, &plots).unwrap();
    let svg = std::fs::read_to_string(plots.join("run.svg")).unwrap();
    assert!(drawn.contains(&plots.join("run.png")), "{drawn:?}");
    assert!(svg.contains("crispEdges"), "the mask is not in run.svg");

    let test = "a_masked_scene_is_whole_in_the_recording_when_its_files_are_gone";
    if let Some(python) = python::python(test) {
        let found = python::check(&python, "values", &[&place.file()]);
        let line = format!("attachment ring.png image/png {}", png.len());
        assert!(found.contains(&line), "{line}");
    }
}

/// Starts this executable as a recorder.
fn recorder(place: &Place) -> Running {
    let child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "play_a_recorder",
            "--ignored",
            "--test-threads=1",
        ])
        .env("VPC_TEST_DOMAIN", place.domain())
        .env("VPC_TEST_FILE", place.file())
        .stdout(Stdio::null())
        .spawn();
    Running(child.unwrap())
}

/// A process that ends with its owner.
struct Running(Child);

impl Running {
    fn signal(&self, name: &str) {
        let id = self.0.id().to_string();
        let done = Command::new("kill").args([name, &id]).status().unwrap();
        assert!(done.success(), "kill {name} {id}");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "not a test: the recorder of the tests that kill or stop one"]
fn play_a_recorder() {
    let variable = |name| PathBuf::from(std::env::var_os(name).unwrap());
    let options = Options {
        domain: variable("VPC_TEST_DOMAIN"),
        output: variable("VPC_TEST_FILE"),
        force: false,
        duration: None,
    };
    // Ends by a signal, or when the file that it is told by appears.
    let stop = AtomicBool::new(false);
    let enough = options.output.with_extension("enough");
    let context = context();
    std::thread::scope(|threads| {
        threads.spawn(|| {
            while !enough.exists() {
                std::thread::sleep(Duration::from_millis(5));
            }
            stop.store(true, Ordering::Relaxed);
        });
        record(&options, &context, &stop, |_| ()).unwrap();
    });
}

fn size(place: &Place) -> u64 {
    std::fs::metadata(place.file()).map_or(0, |file| file.len())
}

/// Publishes until the recorder has flushed twice; the bound is on messages, not on time.
fn until_flushed(
    place: &Place,
    stage: &mut Stage,
    random: &mut ChaCha8Rng,
    published: &mut Published,
) {
    let mut sizes = Vec::new();
    eventually("two flushes", || {
        stage.publish(published.features.len(), random, published);
        sizes.push(size(place));
        sizes.dedup();
        sizes.len() > 2 && published.features.len() > 500
    });
}

#[test]
fn a_killed_recorder_leaves_a_file_that_can_be_read() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let mut published = Published::default();
    let mut recorder = recorder(&place);
    stage.wait_for_recorder();
    let begun = size(&place);
    until_flushed(&place, &mut stage, &mut random, &mut published);
    recorder.signal("-KILL");
    recorder.0.wait().unwrap();

    let recording = Recording::read(&place.file()).unwrap();
    assert!(size(&place) > begun);
    assert!(recording.cut.is_some() && recording.ledger.is_none());
    assert_eq!(recording.scene_toml.as_deref(), Some(scene::PAPER_SIM));
    let (count, cycles) = (recording.features.len(), recording.cycles.len());
    assert!(count >= 100 && cycles >= 100, "{count}, {cycles}");
    // Those before the last of them are there, but for those that a starved machine lost.
    for (read, number) in recording.features.iter().zip(1_u64..) {
        assert!(read.stamp.sequence >= number);
        let published = &published.features[read.stamp.sequence as usize - 1];
        same(&[*read], &[*published]);
    }
    for read in &recording.cycles {
        let published = &published.cycles[read.stamp.sequence as usize - 1];
        same(&[*read], &[*published]);
    }

    if let Some(python) = python::python("a_killed_recorder_leaves_a_file_that_can_be_read") {
        let found = python::check(&python, "rest", &[&place.file()]);
        for line in [
            format!("count /vpc/features {count}"),
            format!("count /vpc/cycles {cycles}"),
        ] {
            assert!(found.contains(&line), "{line}: {found:?}");
        }
    }
}

#[test]
fn a_recorder_that_hangs_delays_nobody_and_counts_what_it_missed() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut published = Published::default();
    let mut recorder = recorder(&place);
    stage.wait_for_recorder();
    until_flushed(&place, &mut stage, &mut random, &mut published);
    recorder.signal("-STOP");
    let before = published.features.len() as u64;
    for i in 0..2_000 {
        // Every `publish` in here succeeds.
        stage.publish(i, &mut random, &mut published);
    }
    let all = before + 2_000;
    recorder.signal("-CONT");
    std::fs::write(place.file().with_extension("enough"), "").unwrap();
    assert!(recorder.0.wait().unwrap().success());

    let recording = Recording::read(&place.file()).unwrap();
    let ledger = recording.ledger.unwrap();
    for (topic, missing, last) in [
        (
            "/vpc/features",
            Recording::missing(&recording.features),
            recording.features.last().map(|m| m.stamp),
        ),
        (
            "/vpc/cycles",
            Recording::missing(&recording.cycles),
            recording.cycles.last().map(|m| m.stamp),
        ),
    ] {
        let account = ledger.of(topic);
        // How many depends on when the recorder really stood still; the longest queue holds 1024.
        assert!(account.lost >= 100, "{topic}: {account:?}");
        assert_eq!(account.lost, missing, "{topic}");
        assert_eq!(last.unwrap().sequence, all, "{topic}");
        assert!(
            account.recorded + account.lost <= all,
            "{topic}: {account:?}"
        );
    }
}

/// A program of the workspace beside this test; `None`, loudly, where it was not built.
fn program(name: &str) -> Option<PathBuf> {
    let test = std::env::current_exe().unwrap();
    let path = test.parent().unwrap().parent().unwrap().join(name);
    if path.is_file() {
        return Some(path);
    }
    assert!(
        std::env::var_os("VPC_REQUIRE_PROGRAMS").is_none(),
        "{}: not built",
        path.display()
    );
    let message = format!(
        "the run with a real daemon was skipped: {} was not built\n",
        path.display()
    );
    let _ = std::io::Write::write_all(&mut std::io::stderr(), message.as_bytes());
    None
}

#[test]
fn a_run_of_daemon_and_emulator_is_recorded_drawn_and_replayed_bit_for_bit() {
    let (Some(vpcd), Some(hw_sim)) = (program("vpcd"), program("hw-sim")) else {
        return;
    };
    // A starved machine may lose messages, and says so: then once more.
    let complete = (0..5).any(|_| flown(&vpcd, &hw_sim));
    assert!(complete, "messages were lost each time");
}

/// Whether nothing was lost.
fn flown(vpcd: &Path, hw_sim: &Path) -> bool {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let place = Place::new();
    let config = place.0.path().join("vpcd.toml");
    let text = format!(
        "scene = \"{}\"\nmemory = \"{}\"\n[law]\nstrategy = \"gpr\"\nnp = 4\n",
        scene_file().display(),
        root.join("memory-blob/default/paper-sim.vpcmem").display()
    );
    std::fs::write(&config, text).unwrap();
    let context = Context::read(None, Some(&config)).unwrap();
    let stop = AtomicBool::new(false);
    let options = place.options();
    let ledger = std::thread::scope(|threads| {
        let recorder = threads.spawn(|| record(&options, &context, &stop, |_| ()));
        let stopped = Stopping(&stop);
        // The recorder makes the domain.
        eventually("the recorder", || {
            place.file().exists() && place.domain().exists()
        });
        let mut daemon = Running(
            Command::new(vpcd)
                .arg("--config")
                .arg(&config)
                .arg("--arm")
                .arg("--domain")
                .arg(place.domain())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
        let emulator = Command::new(hw_sim)
            .arg("--scene")
            .arg(scene_file())
            .arg("--starts")
            .arg(root.join("ipc/scene/scenes/paper-sim-starts.csv"))
            .args(["--start", "82", "--time-limit", "3"])
            .arg("--domain")
            .arg(place.domain())
            .output()
            .unwrap();
        assert!(
            emulator.status.code().is_some_and(|code| code <= 1),
            "{emulator:?}"
        );
        daemon.signal("-TERM");
        assert!(daemon.0.wait().unwrap().success());
        drop(stopped);
        recorder.join().unwrap().unwrap()
    });
    if ledger.total().lost > 0 {
        return false;
    }
    let recording = Recording::read(&place.file()).unwrap();
    assert!(recording.features.len() > 20 && recording.cycles.len() > 20);
    let first = &recording.cycles[0];
    if first.cycle != 1 {
        // The recorder came late.
        return false;
    }
    let drawn = recording::plot(&recording, None, &place.0.path().join("plots")).unwrap();
    assert!(
        drawn.iter().all(|file| file.is_file()) && drawn.len() == 6,
        "{drawn:?}"
    );

    let replay = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_vpc-replay"));
        let output = command
            .arg(place.file())
            .arg("--json")
            .args(words)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        (output.status.code().unwrap(), text)
    };
    let (code, text) = replay(&[]);
    assert_eq!(code, 0, "{text}");
    let found: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(found["equal"], recording.cycles.len() as u64, "{text}");
    assert!(found["steps"].as_u64().unwrap() > 15, "{text}");
    // Another law is told from this one.
    std::fs::write(
        &config,
        std::fs::read_to_string(&config).unwrap() + "margin_px = 9.0\n",
    )
    .unwrap();
    let (code, text) = replay(&["--config", config.to_str().unwrap()]);
    assert_eq!(code, 1, "{text}");
    true
}
