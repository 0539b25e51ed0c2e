//! The other process of this crate's tests, which start it, and kill it: `peer DOMAIN ROLE`. With
//! `once` behind the role it ends itself by SIGKILL after its first turn.

use std::error::Error;
use std::path::Path;
use std::time::Duration;

use ipc::{CameraPorts, ControllerPorts, Domain};
use messages::{Encoding, Features, ImageHeader, TwistCommand, TwistState};
use rustix::process::{Signal, getpid, kill_process};

/// Between two turns of a camera, and between two looks of one that answers.
const PERIOD: Duration = Duration::from_millis(1);
const LOOK: Duration = Duration::from_micros(50);

/// How long a stop waits.
const PATIENCE: Duration = Duration::from_secs(20);

/// Tells the test that the ports are open.
fn working() {
    println!("working");
}

/// Publishes features without end; calls `turned` after each.
fn camera(domain: &Domain, turned: impl Fn()) -> Result<(), Box<dyn Error>> {
    let mut camera = CameraPorts::open(domain)?;
    working();
    loop {
        let square = [
            [100.0, 100.0],
            [200.0, 100.0],
            [200.0, 200.0],
            [100.0, 200.0],
        ];
        camera
            .features
            .publish(&Features::new(&square, ipc::now_ns()))?;
        turned();
        std::thread::sleep(PERIOD);
    }
}

/// Answers features with zero twists, without end.
fn echo(domain: &Domain, turned: impl Fn()) -> Result<(), Box<dyn Error>> {
    let mut controller = ControllerPorts::open(domain)?;
    working();
    loop {
        if let Some(features) = controller.features.latest()? {
            let twist = TwistCommand::answer(&features, [0.0; 6], TwistState::Moving);
            controller.twist.publish(&twist)?;
        }
        turned();
        std::thread::sleep(LOOK);
    }
}

/// Publishes grey images without end.
fn images(domain: &Domain) -> Result<(), Box<dyn Error>> {
    const WIDTH: u32 = 640;
    const HEIGHT: u32 = 480;
    let mut publisher = domain.image_publisher((WIDTH * HEIGHT) as usize)?;
    working();
    for grey in (0..=255).cycle() {
        let header = ImageHeader::new(WIDTH, HEIGHT, Encoding::Mono8, ipc::now_ns());
        let mut image = publisher.loan(&header)?;
        image.fill(grey);
        publisher.publish(image)?;
        std::thread::sleep(PERIOD);
    }
    Ok(())
}

/// Answers images with zero twists, without end: finder of features and controller in one.
fn image_echo(domain: &Domain) -> Result<(), Box<dyn Error>> {
    let mut images = domain.image_subscriber()?;
    let mut controller = ControllerPorts::open(domain)?;
    working();
    loop {
        if let Some(image) = images.latest()? {
            let mut features = Features::new(&[[1.0, 1.0]], 0);
            features.stamp = image.header().stamp;
            let twist = TwistCommand::answer(&features, [0.0; 6], TwistState::Moving);
            controller.twist.publish(&twist)?;
        }
        std::thread::sleep(LOOK);
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let (directory, role, is_once) = match words[..] {
        [directory, role] => (directory, role, false),
        [directory, role, "once"] => (directory, role, true),
        _ => return Err("peer DOMAIN camera|echo|images|image-echo|stop [once]".into()),
    };
    if role == "stop" {
        ipc::stop(Path::new(directory), PATIENCE)?;
        return Ok(());
    }
    let domain = Domain::join(Path::new(directory))?;
    let turned = || {
        if is_once {
            let _ = kill_process(getpid(), Signal::KILL);
        }
    };
    match role {
        "camera" => camera(&domain, turned),
        "echo" => echo(&domain, turned),
        "images" => images(&domain),
        "image-echo" => image_echo(&domain),
        other => Err(format!("no role {other}").into()),
    }
}
