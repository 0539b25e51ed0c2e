//! What these tests share: somebody who publishes everything, and a recorder beside.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use ipc::{CameraPorts, ControllerPorts, Domain, OperatorPorts, RecorderPort, RobotPorts};
use messages::{
    Action, CycleRecord, Features, Hold, Outcome, Reply, Request, RobotMode, RobotState, Stamp,
    StrategyCode, TwistCommand, TwistState,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use recorder::{Ledger, Notice, Options, record};
use recording::{Recorded, Recording};
use scene::SceneFiles;
use testkit::{Place, eventually};

/// Messages of each topic: no more than the shortest queue holds, so that none is lost, however late
/// the recorder comes to take them.
pub const MESSAGES: usize = 64;

/// Name of the recording in a place.
pub const FILE: &str = "run.mcap";

/// A topic of the layout that is not recorded here: the scene names no arm.
pub const OF_AN_ARM: &str = "/camera/joints";

/// How to record a place.
pub fn options(place: &Place) -> Options {
    Options {
        domain: place.domain(),
        output: place.path(FILE),
        force: false,
        duration: None,
        scene: Some(scene()),
        mount: None,
    }
}

fn scene() -> SceneFiles {
    SceneFiles::read(&testkit::scene_file()).unwrap()
}

/// Everybody who publishes, in one thread.
pub struct Stage {
    pub camera: CameraPorts,
    pub robot: RobotPorts,
    pub controller: ControllerPorts,
    pub telemetry: RecorderPort,
    pub operator: OperatorPorts,
    /// Who hears replies without any recorder.
    pub listeners: usize,
}

impl Stage {
    pub fn open(directory: &Path) -> Self {
        let domain = Domain::join(directory).unwrap();
        // As the daemon does.
        let config = directory.join(ipc::CONFIG_FILE);
        std::fs::create_dir_all(config.parent().unwrap()).unwrap();
        std::fs::copy(testkit::root().join("controller/vpcd.toml"), config).unwrap();
        let mut controller = ControllerPorts::open(&domain).unwrap();
        let camera = CameraPorts::open(&domain).unwrap();
        let robot = RobotPorts::open(&domain).unwrap();
        let telemetry = RecorderPort::open(&domain).unwrap();
        let operator = OperatorPorts::open(&domain).unwrap();
        let reply = reply(&Request::new(0, Action::Status));
        let listeners = controller.replies.publish(&reply).unwrap().receivers;
        Self {
            camera,
            robot,
            controller,
            telemetry,
            operator,
            listeners,
        }
    }

    /// Waits until a recorder has opened its last port, replies, beside those who hear them anyway.
    pub fn wait_for_recorder(&mut self) {
        let reply = reply(&Request::new(0, Action::Status));
        eventually("the recorder listens", || {
            let sent = self.controller.replies.publish(&reply).unwrap();
            (sent.receivers > self.listeners).then_some(())
        });
    }

    /// Publishes a message of each topic, with numbers of all sizes.
    pub fn publish(&mut self, i: usize, random: &mut ChaCha8Rng, published: &mut Recording) {
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
        (state.joints, state.q) = (7, std::array::from_fn(|_| any()));
        state.features_sequence = features.stamp.sequence;
        let sent = self.robot.robot.publish(&state).unwrap();
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
            way_point_count: 4 * (i as u32 / 16 % 2),
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

/// Publishes [`MESSAGES`] of each topic, records them, and reads the recording; what was published,
/// read, and the counts.
pub fn published_and_read(place: &Place) -> (Recording, Recording, Ledger) {
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut published = Recording::default();
    let (ledger, notices) = recorded(&options(place), || {
        stage.wait_for_recorder();
        for i in 0..MESSAGES {
            stage.publish(i, &mut random, &mut published);
        }
    });
    assert_eq!(notices, [], "nothing was lost");
    let recording = Recording::read(&place.path(FILE)).unwrap();
    (published, recording, ledger)
}

fn stamp(stamp: &mut Stamp, sent: &ipc::Sent) {
    (stamp.sequence, stamp.published_ns) = (sent.sequence, sent.published_ns);
}

fn reply(request: &Request) -> Reply {
    Reply {
        stamp: Stamp::default(),
        id: request.id,
        cycle: 0,
        action: request.action,
        outcome: Outcome::NoMemory.code(),
        state: TwistState::Moving.code(),
        hold: Hold::number(None),
        strategy: StrategyCode::Gpr.code(),
        neighbours: 0,
        ..Reply::default()
    }
}

/// Records in another thread while `play` runs; what was counted, and what was told on the way but
/// for waiting.
pub fn recorded(options: &Options, play: impl FnOnce()) -> (Ledger, Vec<Notice>) {
    let stop = AtomicBool::new(false);
    let mut notices = Vec::new();
    let ledger = std::thread::scope(|threads| {
        let recorder = threads.spawn(|| {
            record(options, &stop, |notice| {
                if !matches!(notice, Notice::Waiting { .. } | Notice::Begun) {
                    notices.push(notice.clone());
                }
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

/// Equal bit for bit, NaN to NaN: by their JSON, whose exactness has a test of its own.
pub fn same<T: Recorded>(read: &[T], published: &[T]) {
    assert_eq!(read.len(), published.len(), "{}", T::TOPIC);
    for (read, published) in read.iter().zip(published) {
        assert_eq!(read.to_json(), published.to_json());
    }
}
