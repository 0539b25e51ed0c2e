//! Files of calibrations:
//!
//! - YAML of ROS: what `camera_calibration` writes, and `ros2 topic echo --once .../camera_info`.
//! - YAML of OpenCV's `FileStorage` with the keys of its calibration sample.
//! - YAML of Kalibr, a camchain of one camera.
//! - TOML: `fx`, `fy`, `cx`, `cy` and `distortion`, as `opencv_camera.py` reads it; also `width`,
//!   `height` and `model`.
//!
//! All of them have the centre of the upper left pixel at (0, 0).

use std::path::Path;

use saphyr::{LoadableYamlNode, Yaml};
use schemars::JsonSchema;
use serde::Deserialize;
use toml_schema::{Document, FileError, read_text};

use super::{Distortion, Lens};

/// What a model is called: by ROS, by Kalibr, by us.
const RATIONAL: [&str; 4] = ["plumb_bob", "rational_polynomial", "radtan", "none"];
const EQUIDISTANT: [&str; 3] = ["equidistant", "fisheye", "equi"];
/// Coefficients of OpenCV's model; those after the eighth, of thin prisms and tilt, must be 0.
const COUNTS: [usize; 6] = [0, 4, 5, 8, 12, 14];

/// Reads a calibration, by its end: `.yaml` or `.yml`, else TOML.
///
/// # Errors
/// [`FileError`] names the key, its value and what is allowed.
pub fn read(path: &Path) -> Result<Lens, FileError> {
    let name = path.display().to_string();
    let text = read_text(path)?;
    let lens = match path.extension() {
        Some(end) if end == "yaml" || end == "yml" => Reader { name: &name }.yaml(&text)?,
        _ => of_toml(&name, &text)?,
    };
    for (key, value, allowed) in [
        ("fx", lens.focal[0], 10.0..1e5),
        ("fy", lens.focal[1], 10.0..1e5),
        ("cx", lens.centre[0], 0.0..16384.0),
        ("cy", lens.centre[1], 0.0..16384.0),
    ] {
        if !allowed.contains(&value) {
            let words = format!("{} to {} px", allowed.start, allowed.end);
            return Err(FileError::value(&name, key, value, words));
        }
    }
    Ok(lens)
}

/// Intrinsics of a camera.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Toml {
    /// Size of the image that it is about.
    #[schemars(range(min = 16, max = 16384), extend("x-unit" = "px"))]
    width: Option<u32>,
    #[schemars(range(min = 16, max = 16384), extend("x-unit" = "px"))]
    height: Option<u32>,
    #[schemars(range(min = 10, max = 1e5), extend("x-unit" = "px"))]
    fx: f64,
    #[schemars(range(min = 10, max = 1e5), extend("x-unit" = "px"))]
    fy: f64,
    #[schemars(range(min = 0, max = 16384), extend("x-unit" = "px"))]
    cx: f64,
    #[schemars(range(min = 0, max = 16384), extend("x-unit" = "px"))]
    cy: f64,
    #[serde(default)]
    #[schemars(inner(range(min = -1000, max = 1000)))]
    distortion: Vec<f64>,
    model: Option<String>,
}

fn of_toml(name: &str, text: &str) -> Result<Lens, FileError> {
    let toml: Toml = Document::parse(text, name)?.check()?;
    let reader = Reader { name };
    let model = toml.model.as_deref().unwrap_or("plumb_bob");
    let size = toml.width.zip(toml.height);
    Ok(Lens {
        size: size.map(|(width, height)| [width.into(), height.into()]),
        focal: [toml.fx, toml.fy],
        centre: [toml.cx, toml.cy],
        distortion: reader.distortion("model", model, "distortion", &toml.distortion)?,
    })
}

/// Reads YAML; errors name the file.
struct Reader<'a> {
    name: &'a str,
}

impl Reader<'_> {
    fn yaml(&self, text: &str) -> Result<Lens, FileError> {
        // OpenCV writes a directive that is not YAML's.
        let text = text.strip_prefix("%YAML:1.0").unwrap_or(text);
        let documents = Yaml::load_from_str(text);
        let documents = documents.map_err(|error| self.syntax(error.to_string()))?;
        let root = documents.first();
        let root = root.ok_or_else(|| self.syntax("the file is empty".to_owned()))?;
        if root.as_mapping_get("cam0").is_some() {
            return self.kalibr(root);
        }
        let first = |keys: [&'static str; 3]| {
            let found = keys.iter().find_map(|key| Some((*key, root.as_mapping_get(key)?)));
            found.ok_or_else(|| self.missing(keys[0]))
        };
        if let (None, None) = (
            first(["camera_matrix", "k", "K"]).ok(),
            first(["distortion_coefficients", "d", "D"]).ok(),
        ) {
            return Err(self.syntax(
                "no calibration that is known; allowed: camera_matrix and distortion_coefficients (ROS, OpenCV), k and d \
                 (camera_info), cam0 (Kalibr)"
                    .to_owned(),
            ));
        }
        let size = [
            first(["image_width", "width", "Image_Width"])?,
            first(["image_height", "height", "Image_Height"])?,
        ];
        let size = size.map(|(key, value)| self.number(key, value));
        let [width, height] = size;
        let (key, value) = first(["camera_matrix", "k", "K"])?;
        let matrix = self.numbers(key, value)?;
        let [fx, skew, cx, b, fy, cy, c, d, one] = matrix[..] else {
            let found = format!("{} numbers", matrix.len());
            return Err(self.refuse(key, found, "a matrix of 9 numbers"));
        };
        if [skew, b, c, d, one - 1.0] != [0.0; 5] {
            let allowed = "[fx, 0, cx, 0, fy, cy, 0, 0, 1]: a camera without skew";
            return Err(self.refuse(key, format!("{matrix:?}"), allowed));
        }
        let (key, value) = first(["distortion_coefficients", "d", "D"])?;
        let coefficients = self.numbers(key, value)?;
        let is_fisheye = root.as_mapping_get("fisheye_model").and_then(float);
        let model = root.as_mapping_get("distortion_model");
        let model = match (model, is_fisheye) {
            (Some(model), _) => {
                let words = model.as_str();
                words.ok_or_else(|| self.refuse("distortion_model", "no word", known()))?
            }
            (None, Some(1.0)) => "fisheye",
            (None, _) => "rational_polynomial",
        };
        Ok(Lens {
            size: Some([width?, height?]),
            focal: [fx, fy],
            centre: [cx, cy],
            distortion: self.distortion("distortion_model", model, key, &coefficients)?,
        })
    }

    fn kalibr(&self, root: &Yaml) -> Result<Lens, FileError> {
        if root.as_mapping_get("cam1").is_some() {
            let allowed = "one camera: leave the others out of the file";
            return Err(self.refuse("cam1", "a second camera", allowed));
        }
        let camera = root.as_mapping_get("cam0");
        let get = |key: &str| {
            let value = camera.and_then(|camera| camera.as_mapping_get(key));
            value.ok_or_else(|| self.missing(&format!("cam0.{key}")))
        };
        let word = |key: &str| Ok::<_, FileError>(get(key)?.as_str().unwrap_or("no word"));
        let model = word("camera_model")?;
        if model != "pinhole" {
            return Err(self.refuse("cam0.camera_model", model, "pinhole"));
        }
        let numbers = |key: &str| self.numbers(&format!("cam0.{key}"), get(key)?);
        let (intrinsics, resolution) = (numbers("intrinsics")?, numbers("resolution")?);
        let ([fx, fy, cx, cy], [width, height]) = (&intrinsics[..], &resolution[..]) else {
            let found = format!("{intrinsics:?} and {resolution:?}");
            return Err(self.refuse("cam0.intrinsics", found, "4 numbers, and 2 of resolution"));
        };
        Ok(Lens {
            size: Some([*width, *height]),
            focal: [*fx, *fy],
            centre: [*cx, *cy],
            distortion: self.distortion(
                "cam0.distortion_model",
                word("distortion_model")?,
                "cam0.distortion_coeffs",
                &numbers("distortion_coeffs")?,
            )?,
        })
    }

    /// The distortion of a model by its name, of coefficients in OpenCV's order.
    fn distortion(
        &self,
        key_of_model: &str,
        model: &str,
        key: &str,
        k: &[f64],
    ) -> Result<Distortion, FileError> {
        let count = |allowed: &str| {
            let found = format!("{} coefficients", k.len());
            Err(self.refuse(key, found, format!("{allowed} of them for {model}")))
        };
        if EQUIDISTANT.contains(&model) {
            return match *k {
                [a, b, c, d] => Ok(Distortion::Equidistant([a, b, c, d])),
                _ => count("4"),
            };
        }
        if !RATIONAL.contains(&model) {
            return Err(self.refuse(key_of_model, model, known()));
        }
        let most = match model {
            "none" => 0,
            "plumb_bob" => 5,
            "radtan" => 4,
            _ => 14,
        };
        // A plumb_bob of all zeros may have any count: drivers write it for a camera without
        // distortion.
        let is_known = COUNTS.contains(&k.len()) && k.len() <= most;
        if !is_known && k.iter().any(|k| *k != 0.0) {
            return count(match model {
                "none" => "0",
                "plumb_bob" => "4 or 5",
                "radtan" => "4",
                _ => "4, 5, 8, 12 or 14",
            });
        }
        if let Some(k) = k.iter().skip(8).find(|k| **k != 0.0) {
            let allowed = "0 from the 9th coefficient on: thin prisms and tilt are not known";
            return Err(self.refuse(key, k, allowed));
        }
        let mut eight = [0.0; 8];
        eight.iter_mut().zip(k).for_each(|(out, k)| *out = *k);
        Ok(Distortion::Rational(eight))
    }

    /// A list of numbers, or the `data` of a matrix.
    fn numbers(&self, key: &str, value: &Yaml) -> Result<Vec<f64>, FileError> {
        let data = value.as_mapping_get("data").unwrap_or(value);
        let list = data.as_sequence();
        let list = list.ok_or_else(|| self.refuse(key, "no list", "a list of numbers"))?;
        list.iter().map(|value| self.number(key, value)).collect()
    }

    fn number(&self, key: &str, value: &Yaml) -> Result<f64, FileError> {
        let number = float(value).filter(|number| number.is_finite());
        number.ok_or_else(|| self.refuse(key, format!("{value:?}"), "finite numbers"))
    }

    fn refuse(&self, key: &str, found: impl ToString, allowed: impl Into<String>) -> FileError {
        FileError::value(self.name, key, found, allowed)
    }

    fn missing(&self, key: &str) -> FileError {
        self.syntax(format!("{key} is missing"))
    }

    fn syntax(&self, message: String) -> FileError {
        FileError::Syntax {
            path: self.name.to_owned(),
            message,
        }
    }
}

/// The models, for messages.
fn known() -> String {
    [&RATIONAL[..], &EQUIDISTANT[..]].concat().join(", ")
}

/// A number, also one without a fraction.
fn float(value: &Yaml) -> Option<f64> {
    let whole = value.as_integer().map(|whole| whole as f64);
    value.as_floating_point().or(whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_as(name: &str, text: &str) -> Result<Lens, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|error| error.to_string())
    }

    const ROS: &str = "image_width: 640\nimage_height: 480\ncamera_name: wrist\n\
        camera_matrix:\n  rows: 3\n  cols: 3\n  data: [600, 0, 325.5, 0, 605.0, 236, 0, 0, 1]\n\
        distortion_model: plumb_bob\n\
        distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.31, 0.12, 0.0012, -0.0008, 0]\n\
        projection_matrix:\n  rows: 3\n  cols: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]\n";
    const ECHO: &str = "header:\n  frame_id: wrist\nheight: 480\nwidth: 640\ndistortion_model: rational_polynomial\n\
        d:\n- -0.31\n- 0.12\n- 0.0012\n- -0.0008\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n\
        k: [600.0, 0.0, 325.5, 0.0, 605.0, 236.0, 0.0, 0.0, 1.0]\n---\n";
    const OPENCV: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n\
        \x20  cols: 3\n   dt: d\n   data: [ 600., 0., 3.255e+02, 0., 605., 236., 0., 0., 1. ]\n\
        distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -3.1e-01, 0.12, 0.0012, -0.0008, 0. ]\n";
    const KALIBR: &str = "cam0:\n  camera_model: pinhole\n  intrinsics: [600, 605, 325.5, 236]\n  distortion_model: radtan\n\
        \x20 distortion_coeffs: [-0.31, 0.12, 0.0012, -0.0008]\n  resolution: [640, 480]\n  rostopic: /image\n";
    const TOML: &str = "width = 640\nheight = 480\nfx = 600\nfy = 605.0\ncx = 325.5\ncy = 236\n\
        distortion = [-0.31, 0.12, 0.0012, -0.0008, 0.0]\n";

    #[test]
    fn every_tool_gives_the_same_lens() {
        let toml = read_as("a.toml", TOML).unwrap();
        assert_eq!((toml.focal, toml.centre), ([600.0, 605.0], [325.5, 236.0]));
        assert_eq!(toml.size, Some([640.0, 480.0]));
        for text in [ROS, ECHO, OPENCV, KALIBR] {
            assert_eq!(read_as("a.yaml", text), Ok(toml), "{text}");
        }
        let short = TOML.replace("width = 640\nheight = 480\n", "");
        assert_eq!(read_as("a.toml", &short).unwrap().size, None);
    }

    #[test]
    fn every_fisheye_is_one() {
        let expected = Distortion::Equidistant([0.03, -0.01, 0.004, -0.001]);
        let four = "[0.03, -0.01, 0.004, -0.001]";
        let ros = ROS.replace("[-0.31, 0.12, 0.0012, -0.0008, 0]", four);
        let ros = ros.replace("plumb_bob", "equidistant");
        let kalibr = KALIBR.replace("[-0.31, 0.12, 0.0012, -0.0008]", four);
        let kalibr = kalibr.replace("radtan", "equidistant");
        let opencv = OPENCV.replace("[ -3.1e-01, 0.12, 0.0012, -0.0008, 0. ]", four);
        let opencv = opencv.replace("image_width", "fisheye_model: 1\nimage_width");
        for text in [ros, kalibr, opencv] {
            assert_eq!(read_as("a.yml", &text).unwrap().distortion, expected, "{text}");
        }
        let toml = TOML.replace("[-0.31, 0.12, 0.0012, -0.0008, 0.0]", four) + "model = \"equidistant\"";
        assert_eq!(read_as("a.toml", &toml).unwrap().distortion, expected);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let with = |text: &str, from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        };
        for (text, said) in [
            (with(ROS, "plumb_bob", "ftheta"), "distortion_model = ftheta; allowed: plumb_bob, "),
            (with(ROS, "-0.31", ".nan"), "distortion_coefficients"),
            (with(ROS, "-0.31, 0.12, ", ""), "3 coefficients; allowed: 4 or 5 of them for plumb_bob"),
            (with(ROS, "plumb_bob", "equidistant"), "5 coefficients; allowed: 4 of them for equidistant"),
            (with(ROS, "image_width: 640\n", ""), "image_width is missing"),
            (with(ROS, ", 0, 0, 1]", ", 0, 0]"), "camera_matrix = 8 numbers; allowed: a matrix of 9"),
            (with(ROS, "[600, 0, ", "[600, 2, "), "a camera without skew"),
            (with(ROS, "[600,", "[-600,"), "fx = -600; allowed: 10 to 100000 px"),
            (with(ROS, "325.5", "many"), "camera_matrix"),
            (with(KALIBR, "pinhole", "omni"), "cam0.camera_model = omni; allowed: pinhole"),
            (with(KALIBR, "radtan", "fov"), "cam0.distortion_model = fov"),
            (format!("{KALIBR}cam1:\n  camera_model: pinhole\n"), "cam1 = a second camera"),
            (with(KALIBR, "  resolution: [640, 480]\n", ""), "cam0.resolution is missing"),
            ("camera: 3\n".to_owned(), "no calibration that is known"),
            (String::new(), "empty"),
            ("a: [".to_owned(), "a.yaml"),
        ] {
            let error = read_as("a.yaml", &text).unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
        let tilted = with(OPENCV, "-0.0008, 0. ]", "-0.0008, 0., 0., 0., 0., 0., 0., 0.1, 0. ]");
        let error = read_as("a.yaml", &tilted).unwrap_err();
        assert!(error.contains("= 0.1; allowed: 0 from the 9th"), "{error}");
        for (from, to, said) in [
            ("fx = 600", "fx = nan", "fx = NaN; allowed: 10 to 1e5 px"),
            ("fx = 600\n", "", "fx is missing"),
            ("cy = 236", "cy = 236\nskew = 1", "skew"),
            ("[-0.31, 0.12,", "[inf, 0.12,", "distortion[0] = inf"),
        ] {
            let error = read_as("a.toml", &with(TOML, from, to)).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
        assert!(read(Path::new("/nowhere.toml")).is_err());
    }
}
