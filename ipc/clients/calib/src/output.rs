//! Files that are written, never over others unless asked.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use vision_calibration_core::Iso3;

use crate::camera::Camera;
use crate::hand_eye::{HandEye, Mounting};
use crate::intrinsics::Intrinsics;

/// A file cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct OutputError {
    path: String,
    reason: String,
}

impl OutputError {
    fn new(path: &Path, reason: impl ToString) -> Self {
        Self {
            path: path.display().to_string(),
            reason: reason.to_string(),
        }
    }
}

/// Refuses a file that exists, before there is something to lose.
///
/// # Errors
/// [`OutputError`]: it exists, and is not to be overwritten.
pub fn check(path: &Path, force: bool) -> Result<(), OutputError> {
    match path.exists() && !force {
        true => Err(OutputError::new(path, "exists; --force overwrites it")),
        false => Ok(()),
    }
}

/// Writes a file.
///
/// # Errors
/// [`OutputError`]: it exists and is not to be overwritten, or cannot be written.
pub fn write(path: &Path, text: &str, force: bool) -> Result<(), OutputError> {
    check(path, force)?;
    let file = match force {
        true => File::create(path),
        false => File::create_new(path),
    };
    file.and_then(|mut file| file.write_all(text.as_bytes()))
        .map_err(|error| OutputError::new(path, error))
}

/// A calibration of a camera, by the end of its file: `.yaml` or `.yml` as ROS has it
/// (`camera_info`), else TOML for vpc-camera.
pub fn intrinsics(path: &Path, result: &Intrinsics) -> String {
    let camera = &result.camera;
    let is_yaml = path
        .extension()
        .is_some_and(|end| end == "yaml" || end == "yml");
    match is_yaml {
        true => ros(path, camera),
        false => {
            let count = result.views.len();
            format!(
                "# Written by vpc-calib intrinsics: {count} views, reprojection error {:.3} px RMS.\n{}",
                result.rms_px,
                toml(camera)
            )
        }
    }
}

fn toml(camera: &Camera) -> String {
    let Camera {
        size: [width, height],
        focal: [fx, fy],
        center: [cx, cy],
        distortion,
    } = camera;
    let distortion = distortion.map(|k| format!("{k:.9}")).join(", ");
    format!(
        "width = {width}\nheight = {height}\nfx = {fx:.5}\nfy = {fy:.5}\ncx = {cx:.5}\ncy = {cy:.5}\n\
         # k1, k2, p1, p2, k3 as in OpenCV\ndistortion = [{distortion}]\n"
    )
}

fn ros(path: &Path, camera: &Camera) -> String {
    let Camera {
        size: [width, height],
        focal: [fx, fy],
        center: [cx, cy],
        distortion,
    } = camera;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let coefficients = distortion.map(|k| format!("{k:.9}")).join(", ");
    let matrix = |name: &str, rows: u32, columns: u32, data: &str| {
        format!("{name}:\n  rows: {rows}\n  cols: {columns}\n  data: [{data}]\n")
    };
    let k = format!("{fx:.5}, 0.0, {cx:.5}, 0.0, {fy:.5}, {cy:.5}, 0.0, 0.0, 1.0");
    let one = "1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0";
    let p = format!("{fx:.5}, 0.0, {cx:.5}, 0.0, 0.0, {fy:.5}, {cy:.5}, 0.0, 0.0, 0.0, 1.0, 0.0");
    [
        format!("image_width: {width}\nimage_height: {height}\ncamera_name: {name}\n"),
        matrix("camera_matrix", 3, 3, &k),
        "distortion_model: plumb_bob\n".to_owned(),
        matrix("distortion_coefficients", 1, 5, &coefficients),
        matrix("rectification_matrix", 3, 3, one),
        matrix("projection_matrix", 3, 4, &p),
    ]
    .concat()
}

/// The keys of a scene's `[camera]`, to be copied there.
pub fn scene_keys(camera: &Camera) -> String {
    let Camera {
        size: [width, height],
        focal: [fx, fy],
        center: [cx, cy],
        ..
    } = camera;
    format!(
        "[camera]    # of the scene file\nwidth = {width}\nheight = {height}\nfx = {fx:.3}\nfy = {fy:.3}\ncx = {cx:.3}\ncy = {cy:.3}\n"
    )
}

/// A hand-eye calibration: for vpc-panda, where the camera is on the flange.
pub fn hand_eye(result: &HandEye) -> String {
    let count = result.pairs.len();
    let Iso3 {
        translation,
        rotation,
    } = result.camera;
    let numbers = |vector: [f64; 3]| vector.map(|x| format!("{x:.6}")).join(", ");
    let turn = rotation.scaled_axis().map(f64::to_degrees);
    let [frame, _] = result.mounting.frames();
    // What reads files of cameras on wrists refuses this key.
    let other = match result.mounting {
        Mounting::EyeInHand => "",
        Mounting::EyeToHand => "frame = \"base\"\n",
    };
    format!(
        "# Written by vpc-calib hand-eye: {count} poses, the board seen to {:.2} mm RMS.\n\
         # The camera (x right, y down, z forward) in the {frame}'s frame.\n{other}\
         translation = [{}]    # m\nrotation_deg = [{}]    # rotation vector, deg\n",
        1e3 * result.scatter,
        numbers(translation.vector.into()),
        numbers(turn.into())
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_overwritten_unless_it_is_asked_for() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.toml");
        write(&path, "a", false).unwrap();
        let error = write(&path, "b", false).unwrap_err().to_string();
        assert!(
            error.ends_with("a.toml: exists; --force overwrites it"),
            "{error}"
        );
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "a");
        write(&path, "b", true).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "b");
    }
}
