//! Files of calibrations.
//!
//! | format | keys |
//! |---|---|
//! | TOML, ours | `fx` `fy` `cx` `cy` `width` `height`, `distortion` |
//! | YAML of ROS, a file of `camera_info_manager` | `camera_matrix`, `distortion_model`, `distortion_coefficients`, `image_width`, `image_height` |
//! | YAML of ROS, what `ros2 topic echo --once .../camera_info` prints | `k` `d` (`K` `D`), `distortion_model`, `width`, `height` |
//! | YAML of OpenCV's `FileStorage` | `camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`, `fisheye_model` |
//! | YAML of Kalibr, a camera chain | `cam0` |
//!
//! All of them have the centre of the first pixel at (0, 0).

use std::path::Path;

use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError, YamlFile, YamlNode, read_text};

use super::{Distortion, Lens};

/// Focal lengths, px: those of a scene's camera.
const FOCAL: std::ops::RangeInclusive<f64> = 10.0..=1e5;
/// Most pixels in a row, and most rows: those of `vpc/image`.
const MOST_SIDE: f64 = 8192.0;
/// Coefficients that OpenCV's perspective model may have.
const PERSPECTIVE: &str = "4, 5 or 8 numbers: k1, k2, p1, p2, k3, k4, k5, k6 (12 or 14 if the others are 0: no thin prism, no tilt)";
const FISHEYE: &str = "4 numbers: k1, k2, k3, k4";

/// Reads a file of any of the formats.
///
/// # Errors
/// The file cannot be read, has none of the formats, or is no calibration: names the key, its value
/// and what is allowed.
pub fn read(path: &Path) -> Result<Lens, FileError> {
    let name = path.display().to_string();
    let text = read_text(path)?;
    let is_yaml = matches!(path.extension(), Some(end) if end == "yaml" || end == "yml");
    let numbers = match is_yaml {
        true => of_yaml(&name, &text)?,
        false => of_toml(&name, &text)?,
    };
    numbers.check(name)
}

/// A calibration as it stands in a file.
struct Numbers {
    focal: [f64; 2],
    centre: [f64; 2],
    size: [f64; 2],
    distortion: Distortion,
}

impl Numbers {
    fn check(self, file: String) -> Result<Lens, FileError> {
        let refuse = |key: &str, found: f64, allowed: String| {
            Err(FileError::value(&file, key, found, allowed))
        };
        for (key, side) in ["width", "height"].into_iter().zip(self.size) {
            if !(1.0..=MOST_SIDE).contains(&side) || side.fract() != 0.0 {
                return refuse(key, side, format!("whole numbers of 1 to {MOST_SIDE} px"));
            }
        }
        for (key, focal) in ["fx", "fy"].into_iter().zip(self.focal) {
            if !FOCAL.contains(&focal) {
                let allowed = format!("{} to {} px", FOCAL.start(), FOCAL.end());
                return refuse(key, focal, allowed);
            }
        }
        for axis in 0..2 {
            let (key, centre, side) = (["cx", "cy"][axis], self.centre[axis], self.size[axis]);
            if !(0.0..=side).contains(&centre) {
                return refuse(key, centre, format!("0 to {side} px: in the image"));
            }
        }
        Ok(Lens {
            focal: self.focal,
            centre: self.centre,
            // Checked above.
            size: self.size.map(|side| side as u32),
            distortion: self.distortion,
            file,
        })
    }
}

/// Calibration of a camera, as `vpc-calib` writes it.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Toml {
    /// Focal length along u.
    #[schemars(range(min = 10, max = 1e5), extend("x-unit" = "px"))]
    fx: f64,
    /// Focal length along v.
    #[schemars(range(min = 10, max = 1e5), extend("x-unit" = "px"))]
    fy: f64,
    /// Principal point, u.
    cx: f64,
    /// Principal point, v.
    cy: f64,
    /// Width of the images.
    #[schemars(range(min = 1, max = 8192), extend("x-unit" = "px"))]
    width: u32,
    /// Height of the images.
    #[schemars(range(min = 1, max = 8192), extend("x-unit" = "px"))]
    height: u32,
    /// k1, k2, p1, p2, k3, as OpenCV has them.
    #[serde(default)]
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    distortion: Vec<f64>,
}

fn of_toml(name: &str, text: &str) -> Result<Numbers, FileError> {
    let document = Document::parse(text, name)?;
    let file: Toml = document.check()?;
    let distortion = match file.distortion.as_slice() {
        [] => Distortion::perspective([0.0; 8]),
        numbers => perspective(numbers).ok_or_else(|| {
            let found = format!("a list of {}", numbers.len());
            document.refuse("distortion", found, PERSPECTIVE)
        })?,
    };
    Ok(Numbers {
        focal: [file.fx, file.fy],
        centre: [file.cx, file.cy],
        size: [file.width, file.height].map(f64::from),
        distortion,
    })
}

fn of_yaml(name: &str, text: &str) -> Result<Numbers, FileError> {
    let file = YamlFile::parse(text, name)?;
    let root = file.root();
    if let Some(camera) = root.find("cam0") {
        return of_kalibr(&camera);
    }
    if let Some(matrix) = root.find("camera_matrix") {
        return Ok(Numbers {
            size: [root.number("image_width")?, root.number("image_height")?],
            distortion: of_opencv(&root)?,
            ..of_matrix(&matrix, &matrix.numbers("data")?)?
        });
    }
    for (k, d) in [("k", "d"), ("K", "D")] {
        if let Some(matrix) = root.find(k) {
            let model = root.get("distortion_model", MODELS)?;
            let coefficients = root.get(d, PERSPECTIVE)?;
            return Ok(Numbers {
                size: [root.number("width")?, root.number("height")?],
                distortion: of_model(&model, &coefficients, &root.numbers(d)?)?,
                ..of_matrix(&matrix, &root.numbers(k)?)?
            });
        }
    }
    Err(FileError::Syntax {
        path: name.to_owned(),
        message: "no calibration of a camera that is known; allowed: camera_matrix (ROS, OpenCV), k and d (a message of ROS), cam0 (Kalibr); or a file .toml"
            .to_owned(),
    })
}

/// Focal lengths and principal point.
fn of_matrix(node: &YamlNode, numbers: &[f64]) -> Result<Numbers, FileError> {
    match *numbers {
        [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0] => Ok(Numbers {
            focal: [fx, fy],
            centre: [cx, cy],
            size: [0.0; 2],
            distortion: Distortion::perspective([0.0; 8]),
        }),
        _ => {
            let allowed = "9 numbers: fx, 0, cx, 0, fy, cy, 0, 0, 1";
            Err(node.refuse_as(format!("{numbers:?}"), allowed))
        }
    }
}

/// The distortion in a file of ROS, which names the model, or of OpenCV, which does not.
fn of_opencv(root: &YamlNode) -> Result<Distortion, FileError> {
    let coefficients = root.get("distortion_coefficients", "a matrix")?;
    let numbers = coefficients.numbers("data")?;
    if let Some(model) = root.find("distortion_model") {
        return of_model(&model, &coefficients, &numbers);
    }
    let is_fisheye = match root.find("fisheye_model") {
        Some(_) => root.number("fisheye_model")? != 0.0,
        None => false,
    };
    let (distortion, allowed) = match is_fisheye {
        true => (fisheye(&numbers), FISHEYE),
        false => (perspective(&numbers), PERSPECTIVE),
    };
    distortion.ok_or_else(|| wrong_count(&coefficients, &numbers, allowed))
}

const MODELS: &str = "plumb_bob, rational_polynomial, equidistant";
const MODELS_OF_KALIBR: &str = "radtan, equi, none";

/// The distortion of a model that ROS or Kalibr names.
fn of_model(
    model: &YamlNode,
    coefficients: &YamlNode,
    numbers: &[f64],
) -> Result<Distortion, FileError> {
    let (distortion, allowed) = match model.as_str() {
        Some("plumb_bob") => (
            perspective(numbers).filter(|_| numbers.len() <= 5),
            "5 numbers: k1, k2, p1, p2, k3",
        ),
        Some("rational_polynomial") => (
            perspective(numbers).filter(|_| numbers.len() >= 8),
            "8 numbers: k1, k2, p1, p2, k3, k4, k5, k6 (12 or 14 if the others are 0)",
        ),
        Some("equidistant") => (fisheye(numbers), FISHEYE),
        _ => return Err(model.refuse(MODELS)),
    };
    distortion.ok_or_else(|| wrong_count(coefficients, numbers, allowed))
}

fn of_kalibr(camera: &YamlNode) -> Result<Numbers, FileError> {
    let model = camera.get("camera_model", "pinhole")?;
    if model.as_str() != Some("pinhole") {
        return Err(model.refuse("pinhole"));
    }
    let intrinsics = camera.numbers("intrinsics")?;
    let [fx, fy, cx, cy] = *intrinsics else {
        let node = camera.get("intrinsics", "")?;
        return Err(node.refuse("4 numbers: fx, fy, cx, cy"));
    };
    let size = camera.numbers("resolution")?;
    let [width, height] = *size else {
        let node = camera.get("resolution", "")?;
        return Err(node.refuse("2 numbers: width, height"));
    };
    let model = camera.get("distortion_model", MODELS_OF_KALIBR)?;
    let numbers = camera.numbers("distortion_coeffs")?;
    let (distortion, allowed) = match model.as_str() {
        Some("radtan") => (
            perspective(&numbers).filter(|_| numbers.len() == 4),
            "4 numbers: k1, k2, p1, p2",
        ),
        Some("equi") => (fisheye(&numbers), FISHEYE),
        Some("none") => (
            (numbers.is_empty()).then(|| Distortion::perspective([0.0; 8])),
            "no numbers",
        ),
        _ => return Err(model.refuse(MODELS_OF_KALIBR)),
    };
    let coefficients = camera.get("distortion_coeffs", allowed)?;
    Ok(Numbers {
        focal: [fx, fy],
        centre: [cx, cy],
        size: [width, height],
        distortion: distortion.ok_or_else(|| wrong_count(&coefficients, &numbers, allowed))?,
    })
}

fn wrong_count(node: &YamlNode, numbers: &[f64], allowed: &str) -> FileError {
    node.refuse_as(format!("{numbers:?}"), allowed)
}

/// OpenCV's perspective model; `None` for another number of coefficients, or a thin prism or a tilt
/// that is not 0.
fn perspective(numbers: &[f64]) -> Option<Distortion> {
    let is_known = matches!(numbers.len(), 4 | 5 | 8 | 12 | 14);
    let (model, others) = numbers.split_at(numbers.len().min(8));
    let mut all = [0.0; 8];
    all[..model.len()].copy_from_slice(model);
    (is_known && others.iter().all(|x| *x == 0.0)).then(|| Distortion::perspective(all))
}

fn fisheye(numbers: &[f64]) -> Option<Distortion> {
    Some(Distortion::fisheye(numbers.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOML: &str = "fx = 600\nfy = 601.5\ncx = 320.25\ncy = 239\nwidth = 640\nheight = 480\n\
        distortion = [-0.25, 0.08, 1e-3, -2e-3, 0]\n";
    const ROS: &str = "image_width: 640\nimage_height: 480\ncamera_name: wrist\n\
        camera_matrix:\n  rows: 3\n  cols: 3\n  data: [600, 0, 320.25, 0, 601.5, 239, 0, 0, 1]\n\
        distortion_model: plumb_bob\n\
        distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.25, 0.08, 0.001, -0.002, 0]\n\
        projection_matrix:\n  rows: 3\n  cols: 4\n  data: [1, 0, 2, 0, 0, 3, 4, 0, 0, 0, 1, 0]\n";
    const MESSAGE: &str = "header:\n  frame_id: camera_link\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\n\
        d:\n- -0.25\n- 0.08\n- 0.001\n- -0.002\n- 0.0\nk:\n- 600.0\n- 0.0\n- 320.25\n- 0.0\n- 601.5\n- 239.0\n- 0.0\n- 0.0\n- 1.0\n---\n";
    const OPENCV: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n\
        \x20  rows: 3\n   cols: 3\n   dt: d\n   data: [ 600., 0., 320.25, 0., 601.5,\n       239., 0., 0., 1. ]\n\
        distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.25, 8.0e-02, 1.0e-03, -2.0e-03, 0. ]\n";
    const KALIBR: &str = "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n\
        \x20 distortion_coeffs: [-0.25, 0.08, 0.001, -0.002]\n  distortion_model: radtan\n\
        \x20 intrinsics: [600, 601.5, 320.25, 239]\n  resolution: [640, 480]\n  rostopic: /image\n";

    fn read_as(name: &str, text: &str) -> Result<Lens, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        let mut lens = read(&path).map_err(|error| error.to_string())?;
        lens.file = String::new();
        Ok(lens)
    }

    #[test]
    fn every_tool_gives_the_same_lens() {
        let toml = read_as("a.toml", TOML).unwrap();
        assert_eq!(toml.size, [640, 480]);
        assert_eq!(toml.focal, [600.0, 601.5]);
        assert_eq!(toml.centre, [320.25, 239.0]);
        let model = [-0.25, 0.08, 1e-3, -2e-3, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(toml.distortion, Distortion::perspective(model));
        let upper = MESSAGE.replace("\nd:", "\nD:").replace("\nk:", "\nK:");
        for text in [ROS, MESSAGE, &upper, OPENCV, KALIBR] {
            assert_eq!(read_as("a.yaml", text).unwrap(), toml, "{text}");
        }
    }

    #[test]
    fn each_model_is_read() {
        let eight = [0.1, 0.2, 0.01, 0.02, 0.3, 0.4, 0.5, 0.6];
        let four = [0.1, 0.2, 0.3, 0.4];
        let (rational, fisheye) = (Distortion::perspective(eight), Distortion::fisheye(four));
        let with = |file: &str, model: &str, numbers: &[f64]| {
            let file = file.replace("plumb_bob", model).replace("radtan", model);
            let old = [
                "-0.25, 0.08, 0.001, -0.002, 0]",
                "-0.25, 0.08, 0.001, -0.002]",
            ];
            let new = format!("{numbers:?}").replacen('[', "", 1);
            let file = file.replace(old[0], &new).replace(old[1], &new);
            read_as("a.yml", &file).unwrap().distortion
        };
        assert_eq!(with(ROS, "rational_polynomial", &eight), rational);
        let mut fourteen = eight.to_vec();
        fourteen.resize(14, 0.0);
        assert_eq!(with(ROS, "rational_polynomial", &fourteen), rational);
        assert_eq!(with(ROS, "equidistant", &four), fisheye);
        assert_eq!(with(KALIBR, "equi", &four), fisheye);
        assert_eq!(with(KALIBR, "none", &[]), Distortion::perspective([0.0; 8]));
        let opencv = OPENCV.replace(
            "-0.25, 8.0e-02, 1.0e-03, -2.0e-03, 0.",
            "0.1, 0.2, 0.3, 0.4",
        );
        let opencv = |flag: u32| read_as("a.yaml", &format!("{opencv}fisheye_model: {flag}\n"));
        assert_eq!(opencv(1).unwrap().distortion, fisheye);
        let perspective = [0.1, 0.2, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(
            opencv(0).unwrap().distortion,
            Distortion::perspective(perspective)
        );
    }

    #[test]
    fn what_is_no_calibration_is_refused_by_name() {
        let toml = |from: &str, to: &str| ("a.toml", TOML.replace(from, to));
        let yaml = |text: &str, from: &str, to: &str| ("a.yaml", text.replace(from, to));
        for ((name, text), said) in [
            (
                toml("fx = 600", "fx = nan"),
                "fx = NaN; allowed: 10 to 1e5 px",
            ),
            (
                toml("fx = 600\n", ""),
                "fx is missing; allowed: 10 to 1e5 px",
            ),
            (toml("fx = 600", "fz = 600"), "unknown field `fz`"),
            (
                toml("fx = 600", "fx = 0.6"),
                "fx = 0.6; allowed: 10 to 1e5 px",
            ),
            (toml("width = 640\n", ""), "width is missing"),
            (
                toml("cx = 320.25", "cx = 641"),
                "cx = 641; allowed: 0 to 640 px: in the image",
            ),
            (
                toml("cy = 239", "cy = inf"),
                "cy = inf; allowed: 0 to 480 px",
            ),
            (toml(", 0]", ", nan]"), "distortion[4] = NaN"),
            (toml(", 0]", "]"), ""),
            (
                toml(", -2e-3, 0]", "]"),
                "distortion = a list of 3; allowed: 4, 5 or 8 numbers",
            ),
            (
                yaml(ROS, "plumb_bob", "plumb_box"),
                "distortion_model = \"plumb_box\"; allowed: plumb_bob, rational_polynomial, equidistant",
            ),
            (
                yaml(ROS, "-0.002, 0]", "-0.002, 0, 1]"),
                "distortion_coefficients = [-0.25, 0.08, 0.001, -0.002, 0.0, 1.0]; allowed: 5 numbers: k1, k2, p1, p2, k3",
            ),
            (
                yaml(ROS, "plumb_bob", "equidistant"),
                "allowed: 4 numbers: k1, k2, k3, k4",
            ),
            (
                yaml(ROS, "plumb_bob", "rational_polynomial"),
                "allowed: 8 numbers",
            ),
            (
                yaml(ROS, "image_width: 640\n", ""),
                "image_width is missing",
            ),
            (
                yaml(ROS, "image_width: 640", "image_width: 640.5"),
                "width = 640.5; allowed: whole numbers",
            ),
            (
                yaml(ROS, "[600, 0,", "[600, 0.1,"),
                "camera_matrix = [600.0, 0.1,",
            ),
            (
                yaml(ROS, "[600, 0,", "[.nan, 0,"),
                "camera_matrix.data[0] = NaN; allowed: a number",
            ),
            (
                yaml(ROS, "[600, 0,", "[0, 0,"),
                "fx = 0; allowed: 10 to 100000 px",
            ),
            (
                yaml(MESSAGE, "distortion_model: plumb_bob\n", ""),
                "distortion_model is missing; allowed: plumb_bob",
            ),
            (
                yaml(OPENCV, "distortion_coefficients", "dist"),
                "distortion_coefficients is missing",
            ),
            (
                yaml(OPENCV, "-2.0e-03, 0. ]", "-2.0e-03, 0., .Nan ]"),
                "distortion_coefficients.data[5]",
            ),
            (
                yaml(KALIBR, "camera_model: pinhole", "camera_model: omni"),
                "cam0.camera_model = \"omni\"; allowed: pinhole",
            ),
            (
                yaml(KALIBR, "radtan", "fov"),
                "cam0.distortion_model = \"fov\"; allowed: radtan, equi, none",
            ),
            (yaml(KALIBR, "radtan", "none"), "allowed: no numbers"),
            (
                yaml(KALIBR, "[640, 480]", "[640]"),
                "cam0.resolution = a list of 1; allowed: 2 numbers",
            ),
            (
                yaml(KALIBR, "[600, 601.5,", "["),
                "cam0.intrinsics = a list of 2; allowed: 4 numbers",
            ),
            (yaml(KALIBR, "cam0", "cam"), "no calibration of a camera"),
        ] {
            match read_as(name, &text) {
                Err(error) => assert!(!said.is_empty() && error.contains(said), "{error}"),
                Ok(_) => assert!(said.is_empty(), "accepted: {said}"),
            }
        }
        let error = read(Path::new("/nowhere.toml")).unwrap_err();
        assert!(error.to_string().contains("/nowhere.toml"));
    }
}
