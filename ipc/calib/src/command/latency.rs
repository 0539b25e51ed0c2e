//! `vpc-calib latency`.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError};
use vision_calibration_core::{Iso3, Vec3};
use vpc_camera::lens;

use crate::arguments::LatencyArguments;
use crate::camera::Camera;
use crate::command::Failure;
use crate::detector::Detector;
use crate::latency::{self, Frame, Setup};
use crate::live::{self, News};
use crate::trajectory::Trajectory;

pub fn run(arguments: &LatencyArguments, stop: &AtomicBool) -> Result<bool, Failure> {
    let lens = lens::read(&arguments.camera)?;
    let mount = mount(&arguments.hand_eye)?;
    let (target, _) = arguments.target.read()?;
    if !(1.0..=600.0).contains(&arguments.seconds) {
        let error = FileError::value("command line", "--seconds", arguments.seconds, "1 to 600 s");
        return Err(error.into());
    }
    let mut detector = Detector::new()?;
    let (mut frames, mut arm) = (Vec::<Frame>::new(), Trajectory::default());
    let mut size = Ok(());
    eprintln!(
        "wiggle the camera now, irregularly, the tags in sight: {} s",
        arguments.seconds
    );
    let domain = arguments
        .domain
        .clone()
        .unwrap_or_else(ipc::default_directory);
    live::watch(&domain, stop, |news| match news {
        News::Robot(sample) => {
            arm.push(*sample);
            true
        }
        News::Image(picture, time) => {
            size = lens.check_size(picture.size);
            if size.is_err() {
                return false;
            }
            let seen = picture.grey().map(|grey| detector.view("", &grey));
            if let Some(Ok(mut view)) = seen {
                view.straighten(&lens);
                frames.push(Frame { time, view });
            }
            frames
                .first()
                .is_none_or(|first| time - first.time < arguments.seconds)
        }
    })?;
    size?;
    if arm.span().is_none() {
        return Err(Failure::new(
            69,
            "no joints on vpc/robot; is the bridge at work?",
        ));
    }
    let setup = Setup {
        camera: &Camera::pinhole(&lens),
        mount: &mount,
        target: &target,
    };
    let result = latency::estimate(&frames, &arm, &setup).map_err(Failure::not_enough)?;
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
