//! Where the camera sits: files of hand-eye calibrations.
//!
//! - TOML: `translation` (m) and `rotation_deg` (rotation vector, deg) of the camera in its frame.
//! - YAML of easy_handeye 1 and 2 (ROS), eye on hand: `transformation` with x y z qx qy qz qw, or
//!   `transform` with `translation` and `rotation`.
//! - YAML of OpenCV's `FileStorage`: the matrices `R_cam2gripper` and `t_cam2gripper`, named as in
//!   `cv::calibrateHandEye`, t in m.
//!
//! All of them give the pose of the camera (x right, y down, z forward) in the robot's frame that
//! the calibration was made with: the flange, or the end effector.
#![forbid(unsafe_code)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::path::Path;

use arm::{Mount, Pose};
use clap::ValueEnum;
use nalgebra::{Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml_schema::{FileError, YamlFile, YamlNode, read_text};

/// Farthest that a camera on a wrist is from its frame, m: beyond it, units are mixed up.
const FARTHEST: f64 = 1.0;
/// By how much a rotation or the length of a quaternion may miss, without unit.
const ORTHONORMAL: f64 = 1e-3;

/// The frame that a calibration is about.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize, Serialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// The flange, `panda_link8`.
    #[default]
    Flange,
    /// The end effector that the robot has set (O_T_EE).
    Ee,
}

/// The camera in a frame of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEye {
    /// Which frame.
    pub frame: Frame,
    /// The camera in it.
    pub camera: Pose,
}

impl HandEye {
    /// The camera in the flange, given F_T_EE.
    pub fn mount(&self, flange_from_ee: &Pose) -> Mount {
        Mount {
            flange_from_camera: match self.frame {
                Frame::Flange => self.camera,
                Frame::Ee => flange_from_ee * self.camera,
            },
        }
    }
}

/// Reads a file of any of the kinds.
///
/// # Errors
/// The file cannot be read, is none of the kinds, or is no pose of a camera on a wrist: names the
/// key, its value and what is allowed.
pub fn read(path: &Path, frame: Frame) -> Result<HandEye, FileError> {
    let name = path.display().to_string();
    let text = read_text(path)?;
    let is_yaml = matches!(path.extension(), Some(end) if end == "yaml" || end == "yml");
    let camera = match is_yaml {
        true => of_yaml(&name, &text)?,
        false => of_toml(&name, &text)?,
    };
    let far = camera.translation.vector.norm();
    if far > FARTHEST {
        let allowed = format!("0 to {FARTHEST} m from the {frame:?}; are the units metres?");
        return Err(FileError::value(&name, "translation", far, allowed));
    }
    Ok(HandEye { frame, camera })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Toml {
    translation: [f64; 3],
    rotation_deg: [f64; 3],
}

fn of_toml(name: &str, text: &str) -> Result<Pose, FileError> {
    let Toml {
        translation,
        rotation_deg,
    } = toml::from_str(text).map_err(|error| FileError::Syntax {
        path: name.to_owned(),
        message: format!("{error}; allowed: translation and rotation_deg, 3 numbers each"),
    })?;
    for (key, numbers) in [("translation", translation), ("rotation_deg", rotation_deg)] {
        if let Some(number) = numbers.iter().find(|x| !x.is_finite()) {
            return Err(FileError::value(name, key, number, "finite numbers"));
        }
    }
    Ok(Pose::from_parts(
        Translation3::from(translation),
        Rotation3::new(Vector3::from(rotation_deg.map(f64::to_radians))),
    ))
}

fn of_yaml(name: &str, text: &str) -> Result<Pose, FileError> {
    let file = YamlFile::parse(text, name)?;
    let root = file.root();
    let numbers = |of: &YamlNode, keys: [&str; 3]| -> Result<[f64; 3], FileError> {
        Ok([
            of.number(keys[0])?,
            of.number(keys[1])?,
            of.number(keys[2])?,
        ])
    };
    let quaternion = |at: [f64; 3], w: f64, [x, y, z]: [f64; 3]| {
        let turn = Quaternion::new(w, x, y, z);
        if (turn.norm() - 1.0).abs() > ORTHONORMAL {
            let length = format!("a quaternion of length {}", turn.norm());
            return Err(FileError::value(name, "rotation", length, "of length 1"));
        }
        let turn = UnitQuaternion::new_normalize(turn);
        Ok(Pose::from_parts(
            Translation3::from(at),
            turn.to_rotation_matrix(),
        ))
    };
    let parameter = |key| root.find("parameters").and_then(|all| all.find(key));
    if let Some(eye_on_hand) = parameter("eye_on_hand")
        && eye_on_hand.as_bool() == Some(false)
    {
        return Err(eye_on_hand.refuse("true: the camera is on the wrist"));
    }
    // The same in version 2.
    if let Some(kind) = parameter("calibration_type")
        && kind.as_str() != Some("eye_in_hand")
    {
        return Err(kind.refuse("eye_in_hand: the camera is on the wrist"));
    }
    if let Some(all) = root.find("transformation") {
        let at = numbers(&all, ["x", "y", "z"])?;
        return quaternion(at, all.number("qw")?, numbers(&all, ["qx", "qy", "qz"])?);
    }
    if let Some(all) = root.find("transform") {
        let at = numbers(&all.get("translation", "x, y and z")?, ["x", "y", "z"])?;
        let turn = all.get("rotation", "w, x, y and z")?;
        return quaternion(at, turn.number("w")?, numbers(&turn, ["x", "y", "z"])?);
    }
    let matrix = |key: &str, count: usize| -> Result<Vec<f64>, FileError> {
        let allowed = format!("a matrix of {count} numbers");
        let matrix = root.get(key, &allowed)?;
        let numbers = matrix.numbers("data")?;
        match numbers.len() == count {
            true => Ok(numbers),
            false => Err(matrix.refuse(&allowed)),
        }
    };
    if root.find("R_cam2gripper").is_some() {
        let rows = matrix("R_cam2gripper", 9)?;
        let at = matrix("t_cam2gripper", 3)?;
        let turn = Matrix3::from_row_slice(&rows);
        let miss = (turn.transpose() * turn - Matrix3::identity()).amax();
        if miss > ORTHONORMAL || turn.determinant() < 0.0 {
            let found = format!("a matrix that misses a rotation by {miss:.4}");
            return Err(FileError::value(name, "R_cam2gripper", found, "a rotation"));
        }
        let turn = Rotation3::from_matrix_unchecked(turn);
        let at = Translation3::from(Vector3::from_column_slice(&at));
        return Ok(Pose::from_parts(at, turn));
    }
    Err(FileError::Syntax {
        path: name.to_owned(),
        message: "no hand-eye calibration that is known; allowed: transformation or transform (easy_handeye), R_cam2gripper and t_cam2gripper (OpenCV)"
            .to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_as(name: &str, text: &str) -> Result<HandEye, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        read(&path, Frame::Flange).map_err(|error| error.to_string())
    }

    const TOML: &str = "translation = [0.05, -0.05, 0.04]\nrotation_deg = [0, 0, 90]";
    const EASY: &str = "parameters:\n  eye_on_hand: true\n  robot_effector_frame: panda_link8\n\
        transformation:\n  x: 0.05\n  y: -0.05\n  z: 0.04\n  qx: 0\n  qy: 0.0\n  qz: 0.70710678\n  qw: 0.70710678\n";
    const EASY_2: &str = "parameters:\n  name: cam\n  calibration_type: eye_in_hand\n\
        transform:\n  translation:\n    x: 0.05\n    y: -0.05\n    z: 0.04\n  rotation:\n    x: 0.0\n    y: 0.0\n    z: 0.70710678\n    w: 0.70710678\n";
    const OPENCV: &str = "%YAML:1.0\n---\nR_cam2gripper: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n\
        \x20  data: [ 0., -1., 0., 1., 0., 0., 0., 0., 1. ]\nt_cam2gripper: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0.05, -5.0e-02, 0.04 ]\n";

    #[test]
    fn every_tool_gives_the_same_camera() {
        let toml = read_as("a.toml", TOML).unwrap().camera;
        assert!((toml.translation.vector - Vector3::new(0.05, -0.05, 0.04)).norm() < 1e-12);
        for text in [EASY, EASY_2, OPENCV] {
            let camera = read_as("a.yaml", text).unwrap().camera;
            let apart = (camera.rotation.matrix() - toml.rotation.matrix()).amax();
            assert!(
                apart < 1e-7 && camera.translation == toml.translation,
                "{text}"
            );
        }
    }

    #[test]
    fn an_end_effector_calibration_is_carried_to_the_flange() {
        let turn = Rotation3::new(Vector3::z() * -std::f64::consts::FRAC_PI_4);
        let hand = Pose::from_parts(Translation3::new(0.0, 0.0, 0.1034), turn);
        let camera = Pose::translation(0.0, 0.0, 0.1);
        let frame = Frame::Ee;
        let mount = HandEye { frame, camera }.mount(&hand);
        assert_eq!(mount.flange_from_camera, hand * camera);
    }

    #[test]
    fn what_is_no_camera_on_a_wrist_is_refused_by_name() {
        for (name, text, said) in [
            (
                "a.toml",
                "translation = [50, -50, 40]\nrotation_deg = [0, 0, 0]",
                "are the units metres",
            ),
            (
                "a.toml",
                "translation = [0, 0]\nrotation_deg = [0, 0, 0]",
                "3 numbers each",
            ),
            (
                "a.toml",
                "translation = [0, 0, nan]\nrotation_deg = [0, 0, 0]",
                "translation = NaN",
            ),
            (
                "a.yaml",
                &EASY.replace("eye_on_hand: true", "eye_on_hand: false"),
                "parameters.eye_on_hand = false",
            ),
            (
                "a.yaml",
                &EASY_2.replace("eye_in_hand", "eye_on_base"),
                "parameters.calibration_type = ",
            ),
            (
                "a.yaml",
                &EASY.replace("qw: 0.70710678", "qw: 0.2"),
                "of length 1",
            ),
            (
                "a.yaml",
                &EASY.replace("  x: 0.05\n", ""),
                "transformation.x is missing",
            ),
            ("a.yaml", &OPENCV.replace("1. ]", "2. ]"), "a rotation"),
            (
                "a.yaml",
                &OPENCV.replace(", 1. ]", " ]"),
                "a matrix of 9 numbers",
            ),
            ("a.yaml", "camera: 3\n", "no hand-eye calibration"),
            ("a.yaml", "", "empty"),
            ("a.yaml", "a: [", "a.yaml"),
        ] {
            let error = read_as(name, text).unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
        assert!(read(Path::new("/nowhere.toml"), Frame::Flange).is_err());
    }
}
