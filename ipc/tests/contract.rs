//! The promises of the contract, over real shared memory and with other processes (`peers`).

mod images;
mod peers;

use std::collections::BTreeSet;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use ipc::{
    CameraPorts, ControllerPorts, Domain, Observer, OpenError, ReceiveError, RecorderPort,
    RobotPorts, StopFile,
};
use messages::{CycleRecord, Features, Hold, Order, RobotState, TwistCommand, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use testkit::{Place, Running, eventually};

use peers::{peer, square, working};

/// Kills at random moments of a start-up; each costs a few ms.
const START_UP_KILLS: u32 = 200;
/// Rounds of them beside a peer.
const BESIDE_A_PEER: u64 = 60;
/// Kills of a working publisher.
const STEADY_KILLS: u32 = 5;
/// Messages of the allocation test.
const MESSAGES: u64 = 10_000;

#[global_allocator]
static ALLOCATOR: heap_meter::Meter = heap_meter::Meter;

#[test]
fn every_message_goes_round() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut robot = RobotPorts::open(&domain).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut recorder = RecorderPort::open(&domain).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    assert_eq!(controller.features.latest().unwrap(), None);

    let mut features = square(0.5);
    features.exposure_ns = 5_000_000;
    let sent = camera.features.publish(&features).unwrap();
    assert_eq!((sent.sequence, sent.receivers), (1, 2));
    let received = controller.features.latest().unwrap().unwrap();
    assert_eq!(
        (received.points, received.exposure_ns),
        (features.points, 5_000_000)
    );
    assert_eq!(received.stamp.data_ns, features.stamp.data_ns);
    assert_eq!(
        (received.stamp.published_ns, received.order),
        (sent.published_ns, Order::First)
    );
    assert_eq!(controller.features.latest().unwrap(), None);

    let command = TwistCommand::answer(
        &received,
        [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        TwistState::Arrived,
    );
    controller
        .twist
        .publish(&command.valid_until(ipc::now_ns() + 1_000_000_000))
        .unwrap();
    let answer = camera.twist.latest().unwrap().unwrap();
    assert!(answer.answers(sent.sequence, sent.published_ns) && answer.is_valid_at(ipc::now_ns()));
    assert_eq!(
        (answer.twist, answer.state()),
        (command.twist, Some(TwistState::Arrived))
    );

    let state = RobotState::free_camera([0.1, 0.2, 0.3], [0.4, 0.5, 0.6], 7);
    robot.robot.publish(&state).unwrap();
    let record = CycleRecord {
        hold: Hold::Stale.code(),
        ..CycleRecord::default()
    };
    recorder.cycles.publish(&record).unwrap();
    assert_eq!(
        observer.robot.oldest().unwrap().unwrap().rotation,
        state.rotation
    );
    assert_eq!(
        observer.cycles.oldest().unwrap().unwrap().hold(),
        Some(Hold::Stale)
    );
    assert_eq!(
        observer.features.oldest().unwrap().unwrap().message,
        received.message
    );
    assert_eq!(
        observer.twist.oldest().unwrap().unwrap().message,
        answer.message
    );
}

#[test]
fn the_controller_sees_the_newest_message_and_the_observer_all() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    for k in 0..10 {
        camera.features.publish(&square(f64::from(k))).unwrap();
    }
    let newest = controller.features.latest().unwrap().unwrap();
    assert_eq!((newest.stamp.sequence, newest.points[0]), (10, 109.0));
    for k in 1..=10 {
        assert_eq!(
            observer.features.oldest().unwrap().unwrap().stamp.sequence,
            k
        );
    }
    camera.features.skip();
    camera.features.skip();
    camera.features.publish(&square(0.0)).unwrap();
    let order = controller.features.latest().unwrap().unwrap().order;
    assert_eq!(order, Order::Gap { missed: 2 });
}

#[test]
fn a_second_publisher_is_refused_until_the_first_has_left() {
    let place = Place::new();
    let first = Domain::join(&place.domain()).unwrap();
    let second = Domain::join(&place.domain()).unwrap();
    let controller = ControllerPorts::open(&first).unwrap();
    let error = ControllerPorts::open(&second).unwrap_err();
    assert!(
        matches!(
            error,
            OpenError::Taken {
                service: "vpc/twist",
                ..
            }
        ),
        "{error}"
    );
    let words = error.to_string();
    assert!(
        words.contains("another publisher") && words.contains("allowed: 1"),
        "{words}"
    );
    drop(controller);
    ControllerPorts::open(&second).unwrap();
}

#[test]
fn domains_do_not_meet() {
    let places = [Place::new(), Place::new()];
    let [here, there] = [0, 1].map(|k| Domain::join(&places[k].domain()).unwrap());
    let mut camera = CameraPorts::open(&here).unwrap();
    let mut controller = ControllerPorts::open(&there).unwrap();
    assert_eq!(camera.features.publish(&square(0.0)).unwrap().receivers, 0);
    assert_eq!(controller.features.latest().unwrap(), None);
}

#[test]
fn a_late_controller_gets_the_message_that_the_camera_waits_on() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let sent = camera.features.publish(&square(0.0)).unwrap();
    assert_eq!(sent.receivers, 0);
    let echo = working("echo", &place);
    let answer = camera.wait_for_answer(&sent, testkit::PATIENCE).unwrap();
    assert!(answer.is_some_and(|answer| answer.features_sequence == 1));
    echo.kill();
}

#[test]
fn bad_messages_are_refused_on_reception() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut refusal = |features: &Features| {
        camera.features.publish(features).unwrap();
        let error = controller.features.latest().unwrap_err();
        assert!(matches!(error, ReceiveError::Invalid { .. }));
        error.to_string()
    };
    let mut nan = square(0.0);
    nan.points[3] = f64::NAN;
    assert!(refusal(&nan).contains("points[3] = NaN"));
    let none = Features::new(&[], 0);
    assert!(refusal(&none).contains("count = 0; allowed: 1 to 8"));
    let many = Features::new(&[[1.0, 1.0]; 9], 0);
    assert!(refusal(&many).contains("count = 9; allowed: 1 to 8"));
    // The next good one is taken, and is no gap: refused messages count as seen.
    camera.features.publish(&square(0.0)).unwrap();
    assert_eq!(
        controller.features.latest().unwrap().unwrap().order,
        Order::Next
    );
}

#[test]
fn a_killed_camera_comes_back() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    for round in 0..STEADY_KILLS {
        let camera = working("camera", &place);
        let seen = eventually("features", || controller.features.latest().unwrap());
        let expected = if round == 0 {
            Order::First
        } else {
            Order::Restarted
        };
        // The first sight of the new camera may come after some of its messages.
        assert!(
            seen.order == expected || seen.stamp.sequence > 1,
            "{seen:?}"
        );
        camera.kill();
        while controller.features.latest().unwrap().is_some() {}
    }
}

#[test]
fn a_killed_controller_comes_back() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    for _ in 0..STEADY_KILLS {
        let echo = working("echo", &place);
        for _ in 0..20 {
            let sent = camera.features.publish(&square(0.0)).unwrap();
            let answer = camera.wait_for_answer(&sent, testkit::PATIENCE).unwrap();
            assert!(answer.is_some());
        }
        echo.kill();
    }
}

/// Kills peers at random moments of their start-up.
fn kill_at_start_up(place: &Place, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // From the start of the process to well after its first message.
    let start = Instant::now();
    let first = working("echo", place);
    let duration = start.elapsed();
    first.kill();
    for _ in 0..START_UP_KILLS {
        let echo = Running::start(peer("echo", place, None));
        std::thread::sleep(duration.mul_f64(random.random_range(0.0..1.2)));
        echo.kill();
    }
}

/// A camera comes, and `echo` answers it. Returns the camera.
fn answered_by(echo: Running, place: &Place) -> CameraPorts {
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let sent = camera.features.publish(&square(0.0)).unwrap();
    let answer = camera.wait_for_answer(&sent, testkit::PATIENCE);
    assert!(answer.unwrap().is_some());
    echo.kill();
    camera
}

#[test]
#[ignore = "long: kills at random moments"]
fn kills_during_start_up_do_no_harm_to_who_comes_next() {
    let place = Place::new();
    kill_at_start_up(&place, 1);
    let echo = working("echo", &place);
    answered_by(echo, &place);
}

#[test]
#[ignore = "long: kills at random moments"]
fn kills_during_start_up_beside_a_peer_do_no_harm() {
    for seed in 0..BESIDE_A_PEER {
        let place = Place::new();
        let domain = Domain::join(&place.domain()).unwrap();
        let mut observer = Observer::open(&domain).unwrap();
        kill_at_start_up(&place, seed);
        let echo = working("echo", &place);
        let _camera = answered_by(echo, &place);
        let seen = eventually("features", || observer.features.oldest().unwrap());
        assert_eq!(seen.stamp.sequence, 1, "seed {seed}");
        eventually("the answer", || observer.twist.oldest().unwrap());
    }
}

/// What the nodes of a domain have noted of their ports: a file for each.
fn tags(directory: &Path) -> BTreeSet<PathBuf> {
    let nodes = std::fs::read_dir(directory.join("iox2/nodes")).unwrap();
    nodes
        .filter_map(|node| std::fs::read_dir(node.unwrap().path()).ok())
        .flatten()
        .map(|file| file.unwrap().path())
        .filter(|file| file.extension().is_some_and(|end| end == "port_tag"))
        .collect()
}

#[test]
fn a_place_that_a_killed_cleaner_left_taken_is_not_the_last() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let ours = tags(&place.domain());
    let echo = working("echo", &place);
    echo.kill();
    // As far as a cleaner gets that is killed before the places themselves are free.
    let theirs = tags(&place.domain());
    assert!(theirs.len() > ours.len() + 4, "{theirs:?}");
    for tag in theirs.difference(&ours) {
        std::fs::remove_file(tag).unwrap();
    }
    // iceoryx2 keeps their places; the next controller has others.
    let echo = working("echo", &place);
    let _camera = answered_by(echo, &place);
    eventually("the answer", || observer.twist.oldest().unwrap());
    assert!(tags(&place.domain()).is_superset(&ours));
}

/// Start of the names of a domain's files in /dev/shm.
fn prefix(directory: &Path) -> String {
    let generation = std::fs::read_to_string(directory.join("generation")).unwrap();
    format!("vpc_{}_", generation.trim_end())
}

#[test]
fn shared_memory_that_was_never_finished_is_removed() {
    let place = Place::new();
    let _here = Domain::join(&place.domain()).unwrap();
    let unborn = Path::new("/dev/shm").join(format!("{}0_0.connection", prefix(&place.domain())));
    // By who joins, although somebody is there.
    drop(std::fs::File::create(&unborn).unwrap());
    let _there = Domain::join(&place.domain()).unwrap();
    assert!(!unborn.exists());
}

#[test]
fn a_domain_at_work_elsewhere_is_not_wiped() {
    let place = Place::new();
    let first = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&first).unwrap();
    let mut observer = Observer::open(&first).unwrap();
    let segments = prefix(&place.domain());
    let moved = place.path("moved");
    std::fs::rename(place.domain(), &moved).unwrap();
    // Who comes to the old path, is alone there, and leaves again.
    let second = Domain::join(&place.domain()).unwrap();
    drop((CameraPorts::open(&second).unwrap(), second));
    let third = Domain::join(&place.domain()).unwrap();
    let at_work = CameraPorts::open(&third).unwrap();
    let files = || {
        let files = std::fs::read_dir("/dev/shm").unwrap().flatten();
        let names = files.map(|file| file.file_name().into_string().unwrap());
        names.filter(|name| name.starts_with(&segments)).count()
    };
    assert!(files() > 4);
    camera.features.publish(&square(0.1)).unwrap();
    assert!(observer.features.latest().unwrap().is_some());
    // Who comes to the new path meets the first.
    let visitor = Domain::join(&moved).unwrap();
    assert!(matches!(
        CameraPorts::open(&visitor),
        Err(OpenError::Taken { .. })
    ));
    // Nor does the first wipe the other when it leaves.
    drop((visitor, camera, observer, first));
    assert!(place.domain().join("iox2").exists());
    drop(at_work);
}

#[test]
fn files_of_other_users_in_shared_memory_keep_nobody_out() {
    let place = Place::new();
    drop(Domain::join(&place.domain()).unwrap());
    if !testkit::is_root("a file of another user in /dev/shm") {
        return;
    }
    let theirs = Path::new("/dev/shm").join(format!("{}theirs", prefix(&place.domain())));
    std::fs::write(&theirs, "").unwrap();
    std::os::unix::fs::chown(&theirs, Some(65534), Some(65534)).unwrap();
    let domain = Domain::join(&place.domain());
    let is_there = theirs.exists();
    std::fs::remove_file(&theirs).unwrap();
    CameraPorts::open(&domain.unwrap()).unwrap();
    assert!(is_there, "it is theirs to remove");
}

#[test]
fn a_stop_gets_through_a_limit_on_the_size_of_files() {
    let place = Place::new();
    std::fs::create_dir(place.domain()).unwrap();
    let mut controller = StopFile::open(&place.domain()).unwrap();
    let mut shell = testkit::command("sh");
    shell.args(["-c", "ulimit -f 0; exec \"$@\"", "sh"]);
    let peer = Running::start(peer("stop", &place, Some(shell)));
    eventually("a stop", || controller.is_asked().then_some(()));
    controller.obey();
    let ended = peer.ended();
    assert_eq!(ended.code, Some(0), "{ended:?}");
}

#[test]
fn nothing_is_left_when_the_last_one_has_left() {
    let place = Place::new();
    let first = Domain::join(&place.domain()).unwrap();
    let prefix = prefix(&place.domain());
    let left = || {
        let files = std::fs::read_dir("/dev/shm").unwrap();
        let ours = files.filter(|file| {
            let name = file.as_ref().unwrap().file_name();
            name.as_bytes().starts_with(prefix.as_bytes())
        });
        ours.count()
    };
    let camera = CameraPorts::open(&first).unwrap();
    let second = Domain::join(&place.domain()).unwrap();
    assert!(left() > 4);
    drop((camera, first));
    assert!(left() > 4);
    drop(second);
    assert_eq!(left(), 0);
    assert!(!place.domain().join("iox2").exists());
}

#[test]
fn sending_and_receiving_never_allocate() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = CameraPorts::open(&domain).unwrap();
    let mut robot = RobotPorts::open(&domain).unwrap();
    let mut controller = ControllerPorts::open(&domain).unwrap();
    let mut recorder = RecorderPort::open(&domain).unwrap();
    let mut observer = Observer::open(&domain).unwrap();
    let mut round = |k: u64| {
        camera.features.publish(&square(k as f64 / 1e3)).unwrap();
        robot
            .robot
            .publish(&RobotState::free_camera([0.0; 3], [0.0; 3], k))
            .unwrap();
        let features = controller.features.latest().unwrap().unwrap();
        let twist = TwistCommand::answer(&features, [0.1; 6], TwistState::Moving);
        controller.twist.publish(&twist).unwrap();
        assert_eq!(camera.twist.latest().unwrap().unwrap().features_sequence, k);
        recorder.cycles.publish(&CycleRecord::default()).unwrap();
        if k.is_multiple_of(8) {
            while observer.cycles.oldest().unwrap().is_some() {}
            observer.features.latest().unwrap().unwrap();
        }
    };
    // Connections are made, and allocate, with the first message.
    (1..=8).for_each(&mut round);
    let before = heap_meter::calls();
    (9..=MESSAGES).for_each(&mut round);
    assert_eq!(heap_meter::calls() - before, 0);
    // The counter counts.
    drop(std::hint::black_box(Box::new(1)));
    assert_eq!(heap_meter::calls() - before, 2);
}
