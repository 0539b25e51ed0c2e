//! `vpc-calib latency`.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use program::Exit;
use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError};
use vision_calibration_core::{Iso3, Vec3};
use vpc_camera::grey::Grey;
use vpc_camera::lens::{self, Lens};

use crate::arguments::LatencyArguments;
use crate::camera::Camera;
use crate::command::{Failure, oriented};
use crate::detector::Detector;
use crate::latency::{self, Frame, Latency, Setup};
use crate::live::{self, News};
use crate::pose_file;
use crate::trajectory::{Track, Trajectory};

pub fn run(arguments: &LatencyArguments, stop: &AtomicBool) -> Result<bool, Failure> {
    let result = match (&arguments.robot_poses, &arguments.board_poses) {
        (Some(robot), Some(board)) => {
            let arm = Track::from(pose_file::read_timed(robot)?);
            latency::estimate_poses(&pose_file::read_timed(board)?, &arm)
                .map_err(Failure::not_enough)?
        }
        _ => of_images(arguments, stop)?,
    };
    let verdict = result.verdict();
    print!("{result}");
    println!("{verdict}");
    if verdict.is_good() {
        println!(
            "stamp_offset_ms = {:.2}    # of vpc-camera.toml",
            1e3 * result.offset
        );
    }
    Ok(verdict.is_good())
}

fn of_images(arguments: &LatencyArguments, stop: &AtomicBool) -> Result<Latency, Failure> {
    let (Some(camera), Some(hand_eye)) = (&arguments.camera, &arguments.hand_eye) else {
        return Err(Failure::new(
            Exit::Usage,
            "--camera and --hand-eye are missing",
        ));
    };
    let lens = lens::read(camera)?;
    let mount = mount(hand_eye)?;
    let (target, board) = arguments.target.read()?;
    let mut detector = oriented(board)?;
    if !(1.0..=600.0).contains(&arguments.seconds) {
        let error = FileError::value("command line", "--seconds", arguments.seconds, "1 to 600 s");
        return Err(error.into());
    }
    let (mut frames, mut arm) = (Vec::<Frame>::new(), Trajectory::default());
    let mut failed = None;
    eprintln!(
        "wiggle the camera now, irregularly, the tags in sight: {} s",
        arguments.seconds
    );
    live::watch(&arguments.stream, stop, |news| {
        let frame = match news {
            News::Robot(sample) => {
                arm.push(sample);
                return true;
            }
            News::Image { image, time } => frame(&mut detector, &lens, &image, time),
        };
        match frame {
            Ok(frame) => frames.push(frame),
            Err(error) => failed = Some(error),
        }
        let seconds = |first: &Frame, last: &Frame| last.time - first.time;
        let watched = frames.first().zip(frames.last());
        let watched = watched.map_or(0.0, |(first, last)| seconds(first, last));
        failed.is_none() && watched < arguments.seconds
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    if arm.span().is_none() {
        return Err(Failure::new(
            Exit::Unavailable,
            "no joints on vpc/robot; is the bridge at work?",
        ));
    }
    let setup = Setup {
        camera: &Camera::pinhole(&lens),
        mount: &mount,
        target: &target,
    };
    latency::estimate(&frames, &arm, &setup).map_err(Failure::not_enough)
}

/// The tags of an image, straightened.
fn frame(
    detector: &mut Detector,
    lens: &Lens,
    image: &Grey,
    time: Option<f64>,
) -> Result<Frame, Failure> {
    lens.check_size([image.width(), image.height()].map(|side| side as u32))?;
    let time = time.ok_or_else(|| {
        Failure::new(
            Exit::Unavailable,
            "the images do not tell when they were exposed (data_ns = 0)",
        )
    })?;
    let mut view = detector.view("", image)?;
    view.straighten(lens);
    Ok(Frame { time, view })
}

/// The camera in the flange, as vpc-panda reads it from TOML.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct HandEye {
    /// Its place.
    #[schemars(inner(range(min = -1, max = 1)), extend("x-unit" = "m"))]
    translation: [f64; 3],
    /// Its rotation vector.
    #[schemars(inner(range(min = -360, max = 360)), extend("x-unit" = "deg"))]
    rotation_deg: [f64; 3],
}

fn mount(path: &Path) -> Result<Iso3, FileError> {
    let HandEye {
        translation,
        rotation_deg,
    } = Document::read(Some(path))?.check()?;
    let turn = rotation_deg.map(f64::to_radians);
    Ok(Iso3::new(Vec3::from(translation), Vec3::from(turn)))
}
