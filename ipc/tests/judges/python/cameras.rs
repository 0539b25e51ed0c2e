//! `realsense_camera.py` and `aravis_camera.py` with stand-ins for their libraries: when an image
//! was exposed, which frames were lost, and its pixels.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use ipc::Domain;
use messages::Encoding;
use testkit::python::{Environment, run};
use testkit::{Place, Running, eventually};

use super::with_stand_ins;

/// Images that are judged.
const IMAGES: usize = 120;
/// Most that a told time may be off, ns.
const CLOSE_NS: u64 = 100_000;

/// What the stand-in says of each frame: middle of the exposure and its length, ns.
fn exposed(log: &Path) -> BTreeMap<u64, [u64; 2]> {
    let text = std::fs::read_to_string(log).unwrap();
    let number = |word: &str| word.parse().unwrap();
    text.lines()
        .map(|line| line.split_whitespace().map(number).collect())
        .map(|line: Vec<u64>| (line[0], [line[1], line[2]]))
        .collect()
}

/// Takes images of a camera; judges their times, sequence and pixels.
fn images_are_honest(python: &Path, camera: &str, log: &str, arguments: &[&str], what: Encoding) {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut images = domain.image_subscriber().unwrap();
    let log = place.path(log);
    let mut program = with_stand_ins(python, &format!("clients/python/{camera}_camera.py"));
    let serial = if camera == "aravis" {
        "--camera"
    } else {
        "--serial"
    };
    program.arg(serial).arg(&log).args(arguments);
    program.arg("--domain").arg(place.domain());
    program.stdout(Stdio::piped()).stderr(Stdio::piped());
    let program = Running::start(&mut program);
    let mut taken = Vec::new();
    while taken.len() < IMAGES {
        let image = eventually("an image", || {
            std::thread::sleep(Duration::from_millis(1));
            images.latest().unwrap()
        });
        let rows: Vec<Vec<u8>> = image.rows().map(<[u8]>::to_vec).collect();
        taken.push((*image.header(), rows.concat()));
    }
    let ended = program.terminated();
    assert_eq!(ended.code, Some(0), "{ended:?}");

    let exposed = exposed(&log);
    // The frame of an image, by its first byte and the time that it tells.
    let nearest = |told: u64| {
        let off = |at: &u64| exposed[at][0].abs_diff(told);
        *exposed.keys().min_by_key(|number| off(number)).unwrap()
    };
    let first = &taken[0].0;
    let begin = nearest(first.stamp.data_ns) - first.stamp.sequence;
    let mut worst = 0;
    for (header, pixels) in &taken {
        let number = nearest(header.stamp.data_ns);
        let [middle, exposure] = exposed[&number];
        worst = worst.max(header.stamp.data_ns.abs_diff(middle));
        assert_eq!(header.encoding(), Some(what));
        assert_eq!(header.stamp.sequence, number - begin, "{camera}: {number}");
        assert!(header.exposure_ns.abs_diff(exposure) < 1000);
        let begun = header.stamp.data_ns - header.exposure_ns / 2;
        assert_eq!(header.exposure_begin_ns, begun);
        assert_eq!(pixels.len(), 96 * 64 * what.bytes_per_pixel());
        assert_eq!(pixels[0], (number % 256) as u8);
        let counted = pixels.iter().enumerate().skip(1);
        assert!(counted.into_iter().all(|(k, x)| *x == k as u8));
    }
    let (last, frames) = (&taken[IMAGES - 1].0, taken.len() as u64);
    let gaps = last.stamp.sequence - first.stamp.sequence + 1 - frames;
    println!(
        "{camera}: {IMAGES} images, {gaps} lost, told within {:.3} ms",
        worst as f64 / 1e6
    );
    assert!(worst < CLOSE_NS, "{camera}: {worst} ns");
    assert!(gaps >= 4, "{camera}: {gaps}");
}

fn refusals(python: &Path) {
    let place = Place::new();
    let refused = |camera: &str, arguments: &[&str]| {
        let mut program = with_stand_ins(python, &format!("clients/python/{camera}_camera.py"));
        program.args(arguments).arg("--domain").arg(place.domain());
        run(&mut program).unwrap_err()
    };
    let bare = place.path("log.bare");
    let bare = bare.to_str().unwrap();
    for (camera, arguments, words) in [
        (
            "realsense",
            &["--size", "640"][..],
            "--size 640; allowed: WIDTHxHEIGHT, such as 640x480",
        ),
        (
            "realsense",
            &["--transfer-ms", "-1"],
            "--transfer-ms -1.0; allowed: 0 to 200",
        ),
        (
            "realsense",
            &["--serial", bare],
            "the frames have no metadata frame_timestamp; allowed: librealsense with metadata (see above)",
        ),
        (
            "aravis",
            &["--exposure-us", "0"],
            "--exposure-us 0.0; allowed: 1 to 1000000",
        ),
        (
            "aravis",
            &["--exposure-us", "4000", "--rate", "60", "--camera", bare],
            "the camera has no TimestampLatch; allowed: cameras whose clock can be read",
        ),
    ] {
        assert_eq!(
            refused(camera, arguments),
            format!("{camera}_camera: {words}")
        );
    }
}

#[test]
fn the_cameras_in_python_tell_when_an_image_was_exposed() {
    if let Some(python) =
        Environment::JUDGES.python("the_cameras_in_python_tell_when_an_image_was_exposed")
    {
        refusals(&python);
        let realsense = [
            "--size",
            "96x64",
            "--rate",
            "60",
            "--exposure-us",
            "3000",
            "--transfer-ms",
            "4",
        ];
        images_are_honest(&python, "realsense", "log", &realsense, Encoding::Bgr8);
        let infrared = [&realsense[..], &["--stream", "infrared"]].concat();
        images_are_honest(&python, "realsense", "log", &infrared, Encoding::Mono8);
        let aravis = ["--exposure-us", "4000", "--rate", "60"];
        for log in ["log", "log.gev"] {
            images_are_honest(&python, "aravis", log, &aravis, Encoding::Mono8);
        }
    }
}
