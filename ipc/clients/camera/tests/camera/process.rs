//! The shipped programs: a robot whose camera sends rendered images, `vpc-camera`, `vpcd`.

use std::process::{Command, Stdio};

use ipc::{Domain, Subscriber};
use messages::{Encoding, Features, ImageHeader};
use rustix::process::Signal;
use testkit::{Place, Running, eventually, program, root};

fn camera() -> Command {
    testkit::command(env!("CARGO_BIN_EXE_vpc-camera"))
}

#[test]
fn a_wrong_configuration_is_refused_by_name() {
    let place = Place::new();
    for (text, code, said) in [
        (
            "source = \"usb\"\nscene = \"no.toml\"",
            78,
            "source = usb; allowed: shm",
        ),
        ("source = \"shm\"\nscene = \"no.toml\"", 66, "no.toml"),
        ("source = \"shm\"\ntag = [1]", 78, "tag"),
        ("scene = \"no.toml\"", 78, "source is missing"),
    ] {
        let file = place.file("camera.toml", text);
        let ended = testkit::ended(camera().arg("--config").arg(file));
        assert_eq!(ended.code, Some(code), "{text}: {ended:?}");
        assert!(ended.stderr.contains(said), "{text}: {}", ended.stderr);
    }
    let shipped = root().join("ipc/clients/camera/vpc-camera.toml");
    for (flags, said) in [
        (
            ["--tags", "1,2,3"],
            "tags = [1, 2, 3]; allowed: 4 different numbers",
        ),
        (["--tags", "1,2,3,1"], "allowed: 4 different numbers"),
        (
            ["--corners-of", "600"],
            "corners-of = 600; allowed: 0 to 586",
        ),
        (
            ["--family=DICT_APRILTAG_25h9", "--tags=0,1,2,35"],
            "tags = 35; allowed: 0 to 34 of DICT_APRILTAG_25h9",
        ),
        (["--stamp-offset-ms", "-5000"], "stamp-offset-ms = -5000"),
    ] {
        let ended = testkit::ended(camera().arg("--config").arg(&shipped).args(flags));
        assert_eq!(ended.code, Some(78), "{flags:?}: {ended:?}");
        assert!(ended.stderr.contains(said), "{flags:?}: {}", ended.stderr);
    }
    let ended = testkit::ended(camera().arg("--nonsense"));
    assert_eq!(ended.code, Some(64));
}

#[test]
fn an_image_of_another_size_is_passed_over() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut images = domain.image_publisher(640 * 480).unwrap();
    let mut features: Subscriber<Features> = domain.subscriber(1).unwrap();
    let mut eye = camera();
    let shipped = root().join("ipc/clients/camera/vpc-camera.toml");
    eye.arg("--config")
        .arg(shipped)
        .arg("--domain")
        .arg(place.domain());
    eye.args(["--clock", "lockstep"]);
    let eye = Running::start(eye.stderr(Stdio::piped()));
    let mut send = |width, height| {
        let header = ImageHeader::new(width, height, Encoding::Mono8, 1);
        let mut image = images.loan(&header).unwrap();
        image.fill(128);
        images.publish(image).unwrap().sequence
    };
    let words = "an image of 320 x 240 px is passed over; allowed: 640 x 480 px";
    eventually(words, || {
        // Until it listens.
        send(320, 240);
        eye.stderr().contains(words).then_some(())
    });
    let good = send(640, 480);
    let found = eventually("features", || features.latest().unwrap());
    assert_eq!(found.stamp.sequence, good);
    assert_eq!((found.count, found.visible), (4, 0));
    let eye = eye.terminated();
    assert_eq!(eye.code, Some(0), "{}", eye.stderr);
    assert!(eye.stderr.contains("frames=1 "), "{}", eye.stderr);
}

#[test]
fn from_images_to_the_goal() {
    let place = Place::new();
    let domain = place.domain();
    std::fs::create_dir(&domain).unwrap();
    let started = |mut command: Command| {
        command
            .args(["--clock", "lockstep", "--domain"])
            .arg(&domain);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Running::start(command)
    };
    let mut daemon = testkit::command(program("vpcd"));
    // Without a memory: the way is free.
    let text = "[law]\nstrategy = \"previous\"\nnp = 3\nstep_s = 0.4\nmargin_px = 12.0\n";
    let scene = root().join("ipc/scene/scenes/tags-robot.toml");
    let config = format!("scene = \"{}\"\n{text}", scene.display());
    daemon.arg("--config").arg(place.file("vpcd.toml", config));
    let daemon = started(daemon);
    let mut eye = camera();
    let shipped = root().join("ipc/clients/camera/vpc-camera.toml");
    eye.arg("--config").arg(shipped).arg("--print");
    eye.arg("--metrics").arg(place.path("metrics.prom"));
    let eye = started(eye);
    let mut robot = testkit::command(program("hw-sim"));
    let tags = root().join("hw-sim/hw-sim-tags.toml");
    // A start to the left of the goal and behind it.
    let starts = place.file(
        "starts.csv",
        "tx,ty,tz,rx,ry,rz\n-0.02,-0.02,0.40,0,0,0.1\n",
    );
    robot.arg("--config").arg(tags).arg("--starts").arg(starts);
    let ended = started(robot).ended_within(std::time::Duration::from_secs(240));
    eye.signal(Signal::TERM);
    let eye = eye.ended();
    let daemon = daemon.terminated();
    assert_eq!(
        ended.code,
        Some(0),
        "{ended:?}\n{}\n{}",
        eye.stderr,
        daemon.stderr
    );
    assert!(
        ended.stdout.contains("\"verdict\":\"arrived\""),
        "{ended:?}"
    );
    assert_eq!(
        (eye.code, daemon.code),
        (Some(0), Some(0)),
        "{}",
        eye.stderr
    );
    assert!(eye.stderr.contains("stopped: frames="), "{}", eye.stderr);
    let frames = eye.stdout.lines().count();
    assert!(frames > 100, "{frames} frames");
    let metrics = std::fs::read_to_string(place.path("metrics.prom")).unwrap();
    let line = format!("vpc_camera_frames_total {frames}\n");
    assert!(metrics.contains(&line), "{metrics}");
}
